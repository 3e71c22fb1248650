"""Controls that isolate what the model is worth: an iteration in which one thing is another.

A job of run.py with `control=NAME` runs under `CONTROLS[NAME]`, which puts functions in the place of some of
the shipped ones; all else is the shipped code.

- `last`: every round's tails start from where physics left the robots, not from real rows drawn at random; so
  nothing reads `schedule.anchors` and `schedule.new_commands`
- `simulator`: as `last`, and the simulator writes the tails in the model's place. These rows are not counted
  as simulator steps, and the robots do not keep them: it is what a perfect model would give. What it is
  compared with is `last`

Ideas of other model-based methods (27_few):

- `ensemble`: `MEMBERS` models, fitted apart; each row of each robot is written by one drawn at random (MBPO)
- `ensemble-end`: and a tail ends, with the value as its bootstrap, where it is among the `DOUBTFUL` share of
  all robots in whose row the members disagree most
- `stopping`: a fit has `PARTS` parts, and ends with the weights that were best on the new rows of the robots
  that it did not see; with a memory not the remembered ones either
- `real-again`: PPO learns from the real rows in every round, not in the first alone

For a job without tails (`schedule.end_steps=0`):

- `thrice`: an iteration has three updates on its real rows, as many as `best`. In the second and third the
  rows are taken as the policy's of then: with its log_prob, mean and value, so the KL limit is new and
  advantages are estimated again

Two more gained nothing and have left this file (27_few/parts.md): `spread` (a robot's next command was not
drawn, but at an even distance from its last one) and `recent` (the fit drew a remembered row half as often as
one 100 rows newer), in commits up to 22eb9acd.

What the paper claims, and others may do (19_collapse/controls.py): `cold`, `unmasked`, `bootstrap-real`,
`unanchored`, `rebuilt`, `burn4`, `burn16`, `burn64`, `cut`, `branch`
"""

import importlib
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm, fast, rollout, schedule
from dynappo.learner import networks
from dynappo.model import dynamics, errors, memory

claims = importlib.import_module("experiments.19_collapse.controls")

MEMBERS, DOUBTFUL, PARTS, UNSEEN = 3, 0.02, 5, 8
MEMBER = 7  # of a robot's key in a row; `algorithm` and `dynamics` fold 0 to 3

_imagine, _estimate, _presence = algorithm.imagine, algorithm.estimate, algorithm.presence
_columns = schedule.columns
_init, _fit, _step, _errors = dynamics.init, fast.fit, fast.step, errors.errors


def put_in(name: str) -> None:
    """Put a control into `algorithm`, in a process of its own."""
    if name not in CONTROLS:
        raise SystemExit(f"control is {name!r}, expected one of {', '.join(CONTROLS)}")
    for module, function, other in CONTROLS[name]:
        setattr(module, function, other)


def from_last(env, hyper, state, *, start, static, **given):
    """`algorithm.imagine` from the robots' own states."""
    del start
    start = memory.branches(static, dynamics.tail(static, env, state.env_state), axis=0)
    return _imagine(env, hyper, state, start=start, static=static, **given)


def simulated(env, hyper, state, *, rows, n_real, start, key, static):
    """`algorithm.imagine` by physics, from the robots' own states."""
    del start
    robots, bodies = memory.branches(static, (state.env_state, state.params_physics), axis=0)
    rows, _, _ = fast.fill(
        rows,
        begin=n_real,
        end=jnp.int32(static.rollout.horizon),
        state=robots,
        keys=rollout.row_keys(key, memory.imagined_index(static, state.robot_index)),
        act=algorithm.policy(static, env, state.learner.params),
        step=algorithm.physics_step(env, hyper, bodies),
    )
    return rows


def inits(static, env, key):
    """`dynamics.init` of each member: every array has an axis `MEMBERS` in front."""
    return jax.vmap(partial(_init, static, env))(jax.random.split(key, MEMBERS))


def fits(static, hyper, model, rows, epochs, key, **given):
    """`fast.fit` of each member, in an order of its own; losses are their mean."""
    one = lambda model, key: _fit(static, hyper, model, rows, epochs, key, **given)  # noqa: E731
    model, metrics = jax.vmap(one)(model, jax.random.split(key, MEMBERS))
    return model, jax.tree.map(jnp.mean, metrics)


def errors_of_first(static, hyper, env, *, model, **given):
    """`errors.errors` of the first member."""
    return _errors(static, hyper, env, model=jax.tree.map(lambda x: x[0], model), **given)


def by_members(end, static, hyper, env, model):
    """`fast.step` by a member drawn for each robot and row; with `end`, the most doubtful tails end there."""

    def step(state, action, keys):
        each = jax.vmap(lambda one: _step(static, hyper, env, one)(state, action, keys))(model)
        member_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, MEMBER)
        which = jax.vmap(lambda k: jax.random.randint(k, (), 0, MEMBERS))(member_keys)
        state, outcome = jax.tree.map(lambda x: x[which, jnp.arange(len(which))], each)
        if end:
            _, (_, scale) = dynamics.scales(static, jax.tree.map(lambda x: x[0], model))
            doubt = (each[1].next_prop.std(0) / scale[: env.prop_size]).mean(-1)
            ends = doubt > jnp.quantile(doubt, 1 - DOUBTFUL)
            outcome = outcome.replace(truncation=1.0 * ends)
        return state, outcome

    return step


def presence_to_the_end(rows, real):
    """`algorithm.presence`, 0 in a tail after its end."""
    goes_on = jnp.cumprod(jnp.where(real, 1.0, 1 - rows.truncation), axis=0)
    return _presence(rows, real) * jnp.roll(goes_on, 1, axis=0).at[0].set(1.0)


def stopped(static, hyper, model, rows, epochs, key, **given):
    """`fast.fit` in parts; of their ends the one with the least loss on every `UNSEEN`th robot."""
    unseen = jnp.arange(rows.weight.shape[1]) % UNSEEN == 0
    hide = lambda rows: rows._replace(weight=rows.weight * ~unseen)  # noqa: E731
    shown, draw = hide(rows), given.pop("draw", None)
    if draw is not None:
        given["draw"] = lambda key, n: hide(draw(key, n))
    # the moments change once a fit: a part's decay is 1
    model = dynamics.with_moments_of(hyper, model, shown, epochs, given.get("mirrors"))
    kept = hyper._replace(model=hyper.model._replace(stats_decay=1.0))

    def part(carry, key):
        model, best, least = carry
        model, metrics = _fit(static, kept, model, shown, epochs // PARTS, key, **given)
        x, y = dynamics.scaled(static, model, rows)
        now = jnp.arange(len(x))[:, None] < rows.count
        loss = dynamics.loss(static, hyper, model.params, x, y, rows.weight * unseen * now)
        best = jax.tree.map(partial(jnp.where, loss < least), model, best)
        return (model, best, jnp.minimum(loss, least)), metrics

    start = model, model, jnp.float32(jnp.inf)
    (_, best, _), metrics = jax.lax.scan(part, start, jax.random.split(key, PARTS))
    return best, jax.tree.map(lambda x: x[-1], metrics)


def of_the_first_round(*args, rows, real, of_round=0, **given):
    """`algorithm.estimate`, with weight on real rows in every round.

    In later rounds a tail begins somewhere else, so the last real row is cut off: it is bootstrapped by
    V(next_obs), and no advantage comes to it from the tail.
    """
    last = real & ~jnp.roll(real, -1, axis=0).at[-1].set(False)
    cut = jnp.where(last & (of_round > 0), 1.0, rows.truncation)
    return _estimate(*args, rows=rows.replace(truncation=cut), real=real, of_round=0, **given)


def three_rounds(config):
    """`schedule.columns` with three updates in each iteration. SystemExit where there are tails."""
    if schedule.uses_model(config):
        raise SystemExit("control=thrice has tails, expected schedule.end_steps=0")
    columns = _columns(config)
    return columns | {"rounds": np.full_like(columns["iteration"], 3)}


def as_if_anew(static, hyper, env, params, rows, real, of_round=0):
    """`algorithm.estimate`; after the first round as if the policy of now had chosen the actions."""
    obs, critic_obs = networks.inputs(static, env, rows.obs, rows.prop)
    mean, value = jax.vmap(fast.actor_critic(static, params))(obs, critic_obs)
    now = rows.replace(
        action_mean=mean,
        log_prob=networks.log_prob(mean, params["std"], rows.action),
        value=value,
    )
    rows = jax.tree.map(partial(jnp.where, of_round > 0), now, rows)
    return _estimate(static, hyper, env, params=params, rows=rows, real=real)


def _ensemble(end: bool):
    return [
        (dynamics, "init", inits),
        (fast, "fit", fits),
        (fast, "step", partial(by_members, end)),
        (errors, "errors", errors_of_first),
    ]


CONTROLS = {  # name -> what is put where
    "last": [(algorithm, "imagine", from_last)],
    "simulator": [(algorithm, "imagine", simulated)],
    "ensemble": _ensemble(end=False),
    "ensemble-end": [*_ensemble(end=True), (algorithm, "presence", presence_to_the_end)],
    "stopping": [(fast, "fit", stopped)],
    "real-again": [(algorithm, "estimate", of_the_first_round)],
    "thrice": [(schedule, "columns", three_rounds), (algorithm, "estimate", as_if_anew)],
    **claims.CONTROLS,
}
