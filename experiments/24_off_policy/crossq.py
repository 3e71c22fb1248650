"""CrossQ on our task: SAC without target networks, with batch renormalisation in its networks.

    python experiments/24_off_policy/crossq.py OUT.csv [--config go1:few] [--seed 100] [--num-seeds 1]
        [--robots 64]

The method is that of Bhatt et al. (CrossQ, ICLR 2024), written anew: two critics of width `--width`, one pass
of (s, a) and (s', a') together through them, Adam with b1 = 0.5, an actor and a temperature that learn every
third update. The task, its resets and the evaluations are those of sac.py, and OUT.csv has the same columns.
A control step adds a transition of each robot, and is followed by `--updates` gradient steps of `--batch`
transitions: `--updates` = `--robots` is one for each transition.

`--mirror`: half of a batch is mirrored, left for right. `--symmetric`: actor and critics treat left and right
alike, as the policy of `best` does: each gives the mean of what it says of its input and, mirrored back, of
the mirror image, which go through it as one batch, so an update costs nearly twice as much.

Everything between two evaluations is one compiled program, of `--num-seeds` seeds at once, `[S]`. A gradient
step is many small kernels, so a second seed should cost little (not measured). Seconds are of all seeds.
"""

import argparse
import functools
import importlib
import time
from pathlib import Path
from typing import Any, NamedTuple

import flax.linen as nn
import jax
import jax.numpy as jnp
import optax
from flax import struct

from dynappo.learner import symmetry
from dynappo.program import devices
from dynappo.run import log
from experiments import paper

sac = importlib.import_module("experiments.24_off_policy.sac")

RATE, DELAY = 1e-3, 3  # of Adam; updates of the critics for one of the actor
LOW, HIGH = -5.0, 2.0  # of the logarithm of an action's standard deviation
KEEP, WARM = 0.99, 10_000  # of running moments; updates until they are used in training
MOST_R, MOST_D = 3.0, 5.0  # of the correction of a batch's moments


class Renorm(nn.Module):
    """Batch renormalisation (Ioffe 2017): in training a batch's own moments, corrected towards the running
    ones after `WARM` updates; else the running ones. A class because flax's modules are."""

    @nn.compact
    def __call__(self, x, train: bool):
        size = x.shape[-1]
        zeros, ones = functools.partial(jnp.zeros, size), functools.partial(jnp.ones, size)
        mean, var = self.variable("stats", "mean", zeros), self.variable("stats", "var", ones)
        steps = self.variable("stats", "steps", jnp.zeros, ())
        scale = self.param("scale", nn.initializers.ones, (size,))
        bias = self.param("bias", nn.initializers.zeros, (size,))
        if not train:
            return scale * (x - mean.value) / jnp.sqrt(var.value + 1e-3) + bias
        now_mean, now_var = x.mean(0), x.var(0)
        std, old_std = jnp.sqrt(now_var + 1e-3), jnp.sqrt(var.value + 1e-3)
        r = jax.lax.stop_gradient(jnp.clip(std / old_std, 1 / MOST_R, MOST_R))
        d = jax.lax.stop_gradient(jnp.clip((now_mean - mean.value) / old_std, -MOST_D, MOST_D))
        warm = steps.value >= WARM
        r, d = jnp.where(warm, r, 1.0), jnp.where(warm, d, 0.0)
        if not self.is_initializing():
            mean.value = KEEP * mean.value + (1 - KEEP) * jax.lax.stop_gradient(now_mean)
            var.value = KEEP * var.value + (1 - KEEP) * jax.lax.stop_gradient(now_var)
            steps.value += 1
        return scale * ((x - now_mean) / std * r + d) + bias


class Network(nn.Module):
    """Layers of `widths`, each input renormalised, ReLU between them."""

    widths: tuple[int, ...]
    size: int

    @nn.compact
    def __call__(self, x, train: bool):
        for width in self.widths:
            x = nn.relu(nn.Dense(width)(Renorm()(x, train)))
        return nn.Dense(self.size)(Renorm()(x, train))


class Transitions(NamedTuple):
    """A ring of `[K, R, ...]`."""

    obs: Any
    action: Any
    reward: Any
    lives: Any  # 0 where the robot fell
    next_obs: Any


class Learner(struct.PyTreeNode):
    actor: Any  # flax variables
    critics: Any  # the same of both, in front [2]
    log_alpha: Any
    opt_actor: Any
    opt_critics: Any
    opt_alpha: Any
    updates: Any


class Method(NamedTuple):
    """What the functions here need; constants of the program."""

    robots: Any  # sac.Robots
    actor: Network
    critic: Network
    gamma: float
    reward_scaling: float
    batch: int
    updates: int
    mirrors: Any  # of obs and action, for half of a batch, or None
    alike: Any  # of obs and action, for the networks, or None


ADAM = optax.adam(RATE, b1=0.5)


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", default="go1:few")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--seed", type=int, default=100)
    parser.add_argument("--num-seeds", type=int, default=1)
    parser.add_argument("--steps", type=int, default=100_000, help="of the simulator")
    parser.add_argument("--evaluations", type=int, default=20)
    parser.add_argument("--robots", type=int, default=64)
    parser.add_argument("--updates", type=int, default=64, help="gradient steps a control step")
    parser.add_argument("--batch", type=int, default=256)
    parser.add_argument("--first", type=int, default=5000, help="transitions with random actions")
    parser.add_argument("--gamma", type=float, default=0.98)
    parser.add_argument("--reward-scaling", type=float, default=40.0)
    parser.add_argument("--gain", type=float, default=1.5)
    parser.add_argument("--width", type=int, default=1024, help="of the critics' two layers")
    sides = parser.add_mutually_exclusive_group()
    sides.add_argument("--mirror", action="store_true")
    sides.add_argument("--symmetric", action="store_true")
    args = parser.parse_args()
    devices.own_process()
    args.out.parent.mkdir(parents=True, exist_ok=True)
    train(args)


def train(args: argparse.Namespace) -> None:
    """A row of OUT.csv an evaluation and seed, as soon as it is there."""
    robots, evaluated = sac.robots(args)
    size, chunks = args.steps // args.robots, args.evaluations
    method = Method(
        robots=robots,
        actor=Network((256, 256), 2 * robots.action_size),
        critic=Network((args.width, args.width), 1),
        gamma=args.gamma,
        reward_scaling=args.reward_scaling,
        batch=args.batch,
        updates=args.updates,
        mirrors=robots.mirror if args.mirror else None,
        alike=robots.mirror if args.symmetric else None,
    )
    seeds = range(args.seed, args.seed + args.num_seeds)
    keys = split(jnp.stack([jax.random.PRNGKey(seed) for seed in seeds]), 4)
    start_keys, reset_keys, run_keys, look_keys = keys
    state = robots.reset(jnp.concatenate(split(reset_keys, args.robots, axis=0)))
    learners = jax.vmap(lambda key: start(method, key))(start_keys)
    one = of(state, state, jnp.zeros((len(state.obs), robots.action_size)))
    shape = len(seeds), size, args.robots
    ring = Transitions(*(jnp.zeros((*shape, *x.shape[1:])) for x in one))

    def chunk(carry, steps):
        return jax.lax.scan(functools.partial(control_step, method, args.first), carry, steps)[0]

    compiled, look = jax.jit(chunk), jax.jit(functools.partial(evaluate, evaluated, method))
    ends = [size * (k + 1) // chunks for k in range(chunks)]
    carry, seconds, begin = (learners, state, ring, run_keys), 0.0, 0
    for end in ends:
        began = time.perf_counter()
        carry = jax.block_until_ready(compiled(carry, jnp.arange(begin, end)))
        seconds, begin = seconds + time.perf_counter() - began, end
        sums = jnp.stack(look(carry[0], look_keys)).T.tolist()
        for seed, mine, log_alpha in zip(seeds, sums, carry[0].log_alpha, strict=True):
            who = argparse.Namespace(**vars(args) | {"seed": seed})
            found = sac.row("crossq", who, end * args.robots, seconds, mine)
            log.append_csv(args.out, [found])
            print(*found.values(), f"alpha {float(jnp.exp(log_alpha)):.3g}", flush=True)


def split(keys, num: int, axis: int = 1):
    """Each seed's key `[S]` split: arrays `[S]`, or, along axis 0, one `[num]` a seed."""
    return list(jnp.moveaxis(jax.vmap(lambda key: jax.random.split(key, num))(keys), axis, 0))


def of(state, after, action) -> Transitions:
    """The transition of each robot; `next_obs` is that before a reset."""
    lives = 1 - after.metrics["falls"]
    return Transitions(state.obs, action, after.reward, lives, after.info["next_obs"])


def start(method: Method, key) -> Learner:
    actor_key, critic_key = jax.random.split(key)
    obs = jnp.zeros((2, method.robots.observation_size))
    both = jnp.zeros((2, method.robots.observation_size + method.robots.action_size))
    actor = method.actor.init(actor_key, obs, False)
    critics = jax.vmap(lambda k: method.critic.init(k, both, False))(jax.random.split(critic_key))
    return Learner(
        actor=actor,
        critics=critics,
        log_alpha=jnp.zeros(()),
        opt_actor=ADAM.init(actor["params"]),
        opt_critics=ADAM.init(critics["params"]),
        opt_alpha=ADAM.init(jnp.zeros(())),
        updates=jnp.int32(0),
    )


def control_step(method: Method, first, carry, t):
    """Each robot acts once; then `method.updates` gradient steps."""
    learners, state, ring, keys = carry
    seeds, _, count = ring.reward.shape
    keys, act_keys, random_keys, learn_keys = split(keys, 4)
    obs = state.obs.reshape(seeds, count, -1)
    acts = jax.vmap(functools.partial(act, method, train=False))
    (action, _), _ = acts(learners.actor, obs, act_keys)
    anything = functools.partial(jax.random.uniform, shape=action.shape[1:], minval=-1, maxval=1)
    action = jnp.where(t * count < first, jax.vmap(anything)(random_keys), action)
    action = action.reshape(seeds * count, -1)
    after = method.robots.step(state, action)
    new = of(state, after, action)
    ring = jax.tree.map(
        lambda every, one: every.at[:, t].set(one.reshape(every[:, 0].shape)), ring, new
    )

    def update(i, learners):
        some = jax.vmap(jax.random.fold_in, (0, None))(learn_keys, i)
        batch_keys, update_keys = split(some, 2)
        draw = jax.vmap(functools.partial(sample, method), (0, None, 0))
        return learn(method, learners, draw(ring, t + 1, batch_keys), update_keys)

    steps = jnp.where((t + 1) * count < first, 0, method.updates)
    learners = jax.lax.fori_loop(0, steps, update, learners)
    return (learners, after, ring, keys), None


def sample(method: Method, ring: Transitions, filled, key) -> Transitions:
    """`method.batch` transitions of those before `filled`, the second half of them mirrored."""
    time_key, robot_key = jax.random.split(key)
    t = jax.random.randint(time_key, (method.batch,), 0, filled)
    r = jax.random.randint(robot_key, (method.batch,), 0, ring.reward.shape[1])
    batch = jax.tree.map(lambda x: x[t, r], ring)
    if method.mirrors is None:
        return batch
    flip = jnp.arange(method.batch) >= method.batch // 2
    obs, action = method.mirrors

    def image(x, mirror):
        return jnp.where(flip[:, None], symmetry.vector(mirror, x), x)

    return batch._replace(
        obs=image(batch.obs, obs),
        next_obs=image(batch.next_obs, obs),
        action=image(batch.action, action),
    )


def act(method: Method, actor, obs, key, train: bool):
    """`((action, log_prob), statistics)`: a Gaussian's sample through a tanh."""
    out, stats = policy(method, actor, obs, train)
    mean, log_std = jnp.split(out, 2, -1)
    log_std = LOW + 0.5 * (HIGH - LOW) * (jnp.tanh(log_std) + 1)
    noise = jax.random.normal(key, mean.shape)
    raw = mean + jnp.exp(log_std) * noise
    log_prob = -0.5 * noise**2 - log_std - 0.5 * jnp.log(2 * jnp.pi)
    log_prob -= 2 * (jnp.log(2.0) - raw - jax.nn.softplus(-2 * raw))  # of the tanh
    return (jnp.tanh(raw), log_prob.sum(-1)), stats


def policy(method: Method, actor, obs, train: bool):
    """`(mean and spread [B, 2 A], statistics)` before the tanh."""
    if method.alike is None:
        return method.actor.apply(actor, obs, train, mutable=["stats"])
    of_obs, of_action = method.alike
    return said(method.actor, actor, obs, (of_obs, sac.mirror_of_logits(of_action)), train)


def values(method: Method, critics, obs, action, train: bool):
    """`(q [2, B], statistics)` of both critics."""
    x = jnp.concatenate([obs, action], -1)

    def one(critic):
        if method.alike is None:
            return method.critic.apply(critic, x, train, mutable=["stats"])
        mirrors = symmetry.beside(*method.alike), symmetry.unchanged(1)
        return said(method.critic, critic, x, mirrors, train)

    q, stats = jax.vmap(one)(critics)
    return q[..., 0], stats


def said(network: Network, variables, x, mirrors, train: bool):
    """`(outputs, statistics)`: the mean of what a network says of `x` and, mirrored back, of its image."""
    inputs, outputs = mirrors
    both = jnp.concatenate([x, symmetry.vector(inputs, x)])
    out, stats = network.apply(variables, both, train, mutable=["stats"])
    one, image = jnp.split(out, 2)
    return (one + symmetry.vector(outputs, image)) / 2, stats


def learn(method: Method, learners: Learner, batches: Transitions, keys) -> Learner:
    """One update of the critics of all seeds `[S]`; of actor and temperature every `DELAY`th."""
    next_keys, actor_keys = split(keys, 2)
    learners = jax.vmap(functools.partial(learn_critics, method))(learners, batches, next_keys)

    def act_too(learners):
        return jax.vmap(functools.partial(learn_actor, method))(learners, batches, actor_keys)

    # all seeds have made as many updates; a cond inside vmap would compute the actor every time
    return jax.lax.cond(learners.updates[0] % DELAY == 0, act_too, lambda x: x, learners)


def learn_critics(method: Method, learner: Learner, batch: Transitions, key) -> Learner:
    alpha = jnp.exp(learner.log_alpha)
    (next_action, next_log), _ = act(method, learner.actor, batch.next_obs, key, train=False)

    def critic_loss(params):
        critics = {**learner.critics, "params": params}
        obs = jnp.concatenate(
            [batch.obs, batch.next_obs]
        )  # one pass, so both have the same moments
        q, stats = values(method, critics, obs, jnp.concatenate([batch.action, next_action]), True)
        now, after = jnp.split(q, 2, -1)
        after = after.min(0) - alpha * next_log
        target = method.reward_scaling * batch.reward + method.gamma * batch.lives * after
        return ((now - jax.lax.stop_gradient(target)) ** 2).sum(0).mean(), stats

    (_, stats), grads = jax.value_and_grad(critic_loss, has_aux=True)(learner.critics["params"])
    change, opt_critics = ADAM.update(grads, learner.opt_critics)
    params = optax.apply_updates(learner.critics["params"], change)
    return learner.replace(
        critics={"params": params, **stats}, opt_critics=opt_critics, updates=learner.updates + 1
    )


def learn_actor(method: Method, learner: Learner, batch: Transitions, key) -> Learner:
    def actor_loss(params):
        (action, log_prob), stats = act(
            method, {**learner.actor, "params": params}, batch.obs, key, train=True
        )
        q, _ = values(method, learner.critics, batch.obs, action, False)
        return (jnp.exp(learner.log_alpha) * log_prob - q.min(0)).mean(), (log_prob.mean(), stats)

    (_, (log_prob, stats)), grads = jax.value_and_grad(actor_loss, has_aux=True)(
        learner.actor["params"]
    )
    change, opt_actor = ADAM.update(grads, learner.opt_actor)
    params = optax.apply_updates(learner.actor["params"], change)
    entropy = -0.5 * batch.action.shape[-1]  # what is asked for, as brax's SAC
    grad = -jnp.exp(learner.log_alpha) * (log_prob + entropy)
    move, opt_alpha = ADAM.update(grad, learner.opt_alpha)
    return learner.replace(
        actor={"params": params, **stats},
        opt_actor=opt_actor,
        log_alpha=learner.log_alpha + move,
        opt_alpha=opt_alpha,
    )


def evaluate(robots, method: Method, learners: Learner, keys):
    """Means `[S]` over episodes of reward, `sac.MEASURED` and steps, with the mean action."""
    state = robots.reset(jnp.concatenate(split(keys, sac.EPISODES, axis=0)))
    ones = jnp.ones(len(state.obs))

    def mean_action(actor, obs):
        out, _ = policy(method, actor, obs, False)
        return jnp.tanh(jnp.split(out, 2, -1)[0])

    def step(carry, _):
        state, alive, sums = carry
        obs = state.obs.reshape(len(keys), sac.EPISODES, -1)
        action = jax.vmap(mean_action)(learners.actor, obs)
        after = robots.step(state, action.reshape(len(ones), -1))
        found = [after.reward, *(after.metrics[name] for name in sac.MEASURED), ones]
        sums = [s + alive * x for s, x in zip(sums, found, strict=True)]
        return (after, alive * (1 - after.done), sums), None

    (_, _, sums), _ = jax.lax.scan(
        step, (state, ones, [0 * ones] * (len(sac.MEASURED) + 2)), length=sac.LENGTH
    )
    return [x.reshape(len(keys), -1).mean(1) for x in sums]


if __name__ == "__main__":
    main()
