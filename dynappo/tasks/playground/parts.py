"""What each number of a task's observation is: predicted or known, noisy or exact. Found by probing the task.

A Playground task does not say which numbers of its observation are what. But its step can be asked
(swapped.py): with one and the same state and action, and other data after physics, a number that changes
depends on physics and must be predicted. All others are known, and the task's own step computes them in a
tail. With noise at its largest instead of 0, a number that changes is noisy, by that much. Two predicted
numbers that are always equal are one. So velocities, joints, contacts and air times are predicted; commands
and their timers, last actions, phases, histories and what a step shows of the step before are known.

The probes vary data around the task's first pose, and those that end an episode are left out: a tail goes on.

Noise is drawn once for numbers that show the same measurement: Spot's joints are sensed, and the same sensed
joints are the newest of its history. Numbers whose noise is equal in all probes are such (`Layout.draw`).

    raw  = [ every number of the observation | the task's own numbers (info) | ctrl | unseen ]
    obs  = [ prop | context ]: each predicted number once, then what is known
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float
from mujoco_playground._src import mjx_env  # pyright: ignore[reportMissingImports]

from dynappo.tasks.playground import swapped
from dynappo.types import Views

PROBES, ROUNDS = 256, 4
LARGE = 1e6  # in the place of a task's infinities
# of data, what a step computes observation, reward and termination from
FIELDS = (
    "qpos qvel qacc sensordata xpos xquat xmat xipos geom_xpos geom_xmat site_xpos site_xmat subtree_com "
    "cvel actuator_force qfrc_actuator"
).split()
ACTOR, CRITIC = "state", "privileged_state"  # Playground's names of the two observations


class Layout(NamedTuple):
    """Which number is where; constants of the program. E: raw numbers, O and P as in types.py."""

    names: tuple[str, ...]  # of the observations, "" where there is one
    column: np.ndarray  # [E] the number of obs that a raw number is
    noisy: np.ndarray  # [E] bool: it is that number as it is sensed
    source: np.ndarray  # [O] the raw number that a number of obs is
    prop_size: int
    noise: np.ndarray  # [P] half width of the uniform noise
    draw: np.ndarray  # [P] the first number that has the same draw of it
    views: Views
    home: dict[str, np.ndarray]  # data of the task's first pose
    reads_ctrl: bool  # whether a step reads the control before it
    clipped: bool  # whether no reward is below 0


class Raw(NamedTuple):
    """What a task has after a step or a reset, as it has it."""

    obs: Any
    info: dict[str, Any]
    ctrl: Float[Array, " A"]
    unseen: Float[Array, " U"]


class Probed(NamedTuple):
    """A task's step without physics, to be asked again (mirrored.py)."""

    # (raw, action, data before and after, and others) of PROBES -> as `_probe`
    ask: Any
    raw: Raw  # of PROBES: numbers of the task after some rows


def names_of(obs: Any) -> tuple[str, ...]:
    """The observations: the policy's first."""
    if not isinstance(obs, dict):
        return ("",)
    return tuple(name for name in (ACTOR, CRITIC) if name in obs)


def unseen(task: Any, names: tuple[str, ...], data: Any) -> Float[Array, " U"]:
    """What follows from the state and no observation tells: heights of the base and of the feet, m.

    And velocities of base (in its frame) and joints, of a task with one observation, which leaves them out.
    """
    feet = getattr(task, "_feet_site_id", np.zeros(0, int))
    heights = [data.qpos[2:3], data.site_xpos[feet, 2]]
    if len(names) > 1:
        return jnp.concatenate(heights)
    moves = [
        data.sensordata[start : start + size]
        for start, size in (_sensor(task.mj_model, name) for name in ("local_linvel", "gyro"))
    ]
    return jnp.concatenate([*heights, *moves, data.qvel[6:]])


def _sensor(model: mujoco.MjModel, name: str) -> tuple[int, int]:
    """Place and size of a sensor's numbers; size 0 where there is none."""
    i = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
    return (0, 0) if i < 0 else (int(model.sensor_adr[i]), int(model.sensor_dim[i]))


def vector(names: tuple[str, ...], raw: Raw) -> Float[Array, " E"]:
    """All raw numbers; keys of random numbers are none."""
    of_obs = [raw.obs] if names == ("",) else [raw.obs[name] for name in names]
    of_info = [x for key, x in sorted(raw.info.items()) if key != "rng"]
    leaves = [*of_obs, *jax.tree.leaves(of_info), raw.ctrl, raw.unseen]
    numbers = [jnp.ravel(jnp.asarray(x)).astype(jnp.float32) for x in leaves]
    return jnp.nan_to_num(jnp.concatenate(numbers), nan=jnp.nan, posinf=LARGE, neginf=-LARGE)


def unvector(names: tuple[str, ...], numbers: Float[Array, " E"], like: Raw) -> Raw:
    """The `Raw` of `vector`'s numbers, shaped and typed as `like`, whose key it keeps."""
    place = 0

    def take(x):
        nonlocal place
        shape, dtype = x.shape, x.dtype
        size = int(np.prod(shape))
        part, place = numbers[place : place + size].reshape(shape), place + size
        if jnp.issubdtype(dtype, jnp.bool_):
            return part > 0.5
        return jnp.round(part).astype(dtype) if jnp.issubdtype(dtype, jnp.integer) else part

    if names == ("",):
        obs = take(like.obs)
    else:
        obs = like.obs | {name: take(like.obs[name]) for name in names}
    info = {key: jax.tree.map(take, like.info[key]) for key in sorted(like.info) if key != "rng"}
    info |= {key: x for key, x in like.info.items() if key == "rng"}
    return Raw(obs, info, take(like.ctrl), take(like.unseen))


def after_step(task: Any, out: Any, rest: tuple[str, ...] | None = None) -> Raw:
    """The `Raw` of a Playground state; `rest` are terms of the reward, whose sum is the last of `unseen`."""
    hidden = unseen(task, names_of(out.obs), out.data)
    if rest is not None:
        left = sum((out.metrics[name] for name in rest), jnp.zeros(()))
        hidden = jnp.append(hidden, left)
    return Raw(out.obs, out.info, out.data.ctrl, hidden)


def with_rest(layout: Layout) -> Layout:
    """The layout with one more raw number, the last, as the last of `prop`. The model sees it, too."""
    size, last = layout.prop_size, len(layout.column)

    def moved(columns):
        return columns + (columns >= size)

    views = Views(*map(moved, layout.views))
    return layout._replace(
        column=np.append(moved(layout.column), size),
        noisy=np.append(layout.noisy, False),
        source=np.insert(layout.source, size, last),
        prop_size=size + 1,
        noise=np.append(layout.noise, np.float32(0)),
        draw=np.append(layout.draw, size),
        views=views._replace(model=np.sort(np.append(views.model, size))),
    )


def home(task: Any) -> dict[str, np.ndarray]:
    """Data of the task's first pose."""
    model = task.mj_model
    qpos = np.asarray(getattr(task, "_init_q", model.qpos0))
    states = data_of_states(model, [(qpos, np.zeros(model.nv), np.zeros(model.nu))])
    return {name: x[0] for name, x in states.items()}


def data_of_states(
    model: mujoco.MjModel, states: list[tuple[Any, Any, Any]]
) -> dict[str, np.ndarray]:
    """Data, [K] in front, of K states `(qpos, qvel, ctrl)` by C MuJoCo."""
    data, rows, names = mujoco.MjData(model), [], [*FIELDS, "ctrl"]
    for qpos, qvel, ctrl in states:
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
        mujoco.mj_forward(model, data)
        rows.append([np.array(getattr(data, name), np.float32) for name in names])
    columns = map(np.stack, zip(*rows, strict=True))
    return dict(zip(names, columns, strict=True))


def template(task: Any) -> Any:
    """Empty MJX data of the task's engine."""
    sizes = {"naconmax": task._config.naconmax, "njmax": task._config.njmax}
    return mjx_env.make_data(task.mj_model, impl=task.mjx_model.impl.value, **sizes)


def with_fields(data: Any, fields: dict[str, Any]) -> Any:
    """`data` with these arrays, in its own shapes."""
    arrays = {name: jnp.array(x).reshape(getattr(data, name).shape) for name, x in fields.items()}
    return data.replace(**arrays)


def layout(task: Any) -> tuple[Layout, Probed]:
    """The task's `Layout`, and what it was found by.

    Takes some seconds, most of them to compile the task's step without physics.
    """
    at_home = home(task)
    draw = np.random.default_rng(0)
    varied = partial(_varied, at_home, _contact_sensors(task.mj_model), draw)

    def arguments(raw):
        action = draw.uniform(-1, 1, (PROBES, task.action_size)).astype(np.float32)
        return raw, action, varied(), varied(), varied(), varied()

    with jax.default_device(jax.local_devices(backend="cpu")[0]):
        keys = jax.random.split(jax.random.PRNGKey(0), PROBES)
        raw, metrics = jax.device_get(_compiled(partial(_first, task, at_home), keys)(keys))
        metrics = jax.tree.map(lambda x: x[0], metrics)
        probe = _compiled(partial(_probe, task, metrics), *arguments(raw))
        out = probe(*arguments(raw))
        for _ in range(
            ROUNDS - 1
        ):  # actions, contacts and air times differ more from round to round
            out = probe(*arguments(jax.device_get(out[0])))
        raw, numbers, reward, _, ended = jax.device_get(out)
    exact, other, loudest, coasted, real = (x[~ended] for x in numbers)
    predicted = (np.abs(exact - other) > 1e-5 * (1 + np.abs(exact))).any(0)
    noise = np.where(predicted, np.abs(loudest - exact).min(0), 0.0)
    noise[noise < 1e-6] = 0.0
    drawn = (real - exact) / np.where(noise > 0, noise, 1.0)
    one, reads_ctrl = jax.tree.map(lambda x: x[0], raw), bool((exact != coasted).any())
    of_data = {"home": at_home, "reads_ctrl": reads_ctrl, "clipped": bool(reward.min() >= 0)}
    arranged = _arranged(names_of(raw.obs), one, exact, predicted, noise, drawn, of_data)
    return arranged, Probed(probe, raw)


def _varied(at_home: dict[str, np.ndarray], contacts, draw) -> dict[str, np.ndarray]:
    """`at_home` for each probe, with more or less noise; `contacts` are places of `_contact_sensors`."""
    size = 10 ** draw.uniform(-2.5, -0.5, PROBES)
    out = {}
    for name, x in at_home.items():
        spread = draw.normal(size=(PROBES, *x.shape)) * size.reshape(-1, *[1] * x.ndim)
        out[name] = (x + spread).astype(np.float32)
    # of contacts one changes, or none is left, or each changes by chance
    touches = np.repeat(at_home["sensordata"][None, contacts] > 0, PROBES, 0)
    one = np.arange(len(contacts)) == draw.integers(0, max(len(contacts), 1), (PROBES, 1))
    some = draw.uniform(size=touches.shape) < draw.uniform(size=(PROBES, 1))
    how = draw.integers(0, 3, (PROBES, 1))
    turned = np.select([how == 0, how == 1], [one, touches], some)
    out["sensordata"][:, contacts] = touches ^ turned
    return out


def _compiled(function: Any, *arguments: Any) -> Any:
    """`jax.vmap(function)` for these arguments; not optimised, for it runs a few times."""
    lowered = jax.jit(jax.vmap(function)).lower(*arguments)
    options: Any = {"xla_backend_optimization_level": 0}
    return lowered.compile(options)


def _contact_sensors(model: mujoco.MjModel) -> np.ndarray:
    """Places in sensordata that tell whether two geoms touch."""
    of = [
        i for i in range(model.nsensor) if model.sensor_type[i] == mujoco.mjtSensor.mjSENS_CONTACT
    ]
    return np.array([model.sensor_adr[i] for i in of], int)


def _first(task: Any, at_home: dict[str, np.ndarray], key) -> tuple[Raw, dict[str, Any]]:
    """A reset without physics, and its metrics."""
    with swapped.physics(lambda data, ctrl, n: data):
        out = task.reset(key)
    info = jax.tree.map(jnp.asarray, out.info)
    data = out.data.replace(ctrl=jnp.asarray(at_home["ctrl"]))
    return after_step(task, out.replace(data=data, info=info)), out.metrics


def _probe(task: Any, metrics, raw: Raw, action, before, after, other_before, other_after):
    """`(raw after the step, five vectors of its numbers, reward, its terms, done)`: without noise, with other
    data, with the largest noise, with another ctrl before, and with noise."""
    data, names = template(task), names_of(raw.obs)

    def run(before, after, ctrl=raw.ctrl):
        start = with_fields(data, before).replace(ctrl=ctrl)
        start = swapped.state(start, raw.obs, raw.info, metrics)
        return swapped.step(task, start, action, with_fields(data, after))

    def numbers(out):
        return vector(names, after_step(task, out))

    real = run(before, after)
    with swapped.uniform(0.5):
        exact, other = run(before, after), run(other_before, other_after)
        coasted = run(before, after, raw.ctrl + 0.1)
    with swapped.uniform(1.0):
        loudest = run(before, after)
    ended = (exact.done + other.done + loudest.done + real.done) > 0
    typed = jax.tree.map(lambda x, y: jnp.asarray(x, y.dtype), after_step(task, real), raw)
    vectors = tuple(map(numbers, (exact, other, loudest, coasted, real)))
    terms = {name: x for name, x in exact.metrics.items() if name.startswith("reward/")}
    return typed, vectors, exact.reward, terms, ended


def _arranged(names, one: Raw, exact, predicted, noise, drawn, of_data: dict[str, Any]) -> Layout:
    """Puts each predicted number once in front, and what is known behind; `one` is a probe's."""
    sizes = [np.size(one.obs)] if names == ("",) else [np.size(one.obs[name]) for name in names]
    seen, acts, noisy = sum(sizes), sizes[0], noise > 0
    # the model sees neither the task's counters nor what is far from all others
    useless = _places(names, one, _is_counter) | (np.abs(exact) > LARGE / 2).any(0)
    used = np.ones(len(predicted), bool)
    if not of_data["reads_ctrl"]:
        only = jax.tree.map(np.zeros_like, one)._replace(ctrl=np.ones_like(one.ctrl))
        used = ~_places(names, only, lambda x: x)
    column, source = np.zeros(len(predicted), int), []
    first: dict[tuple[bytes, bool], int] = {}

    def place(at: int, keys: list[tuple[bytes, bool]]) -> None:
        found = next((first[key] for key in keys if key in first), None)
        if found is None:
            found = first[keys[0]] = len(source)
            source.append(at)
        column[at] = found

    for at in np.flatnonzero(predicted & used).tolist():
        values = exact[:, at].tobytes()
        # the policy's own numbers are as it senses them; all others may be one of these, exactly
        keys = [(values, bool(noisy[at]))]
        place(at, keys if at < acts else [*keys, (values, not noisy[at])])
    prop_size = len(source)
    for at in np.flatnonzero(~predicted & used).tolist():
        # what is seen twice is known once; but what no probe changes, a step may, and the task's own numbers
        # may change after they are seen
        apart = at >= seen or np.ptp(exact[:, at]) == 0
        place(at, [(b"%d" % at, True) if apart else (exact[:, at].tobytes(), False)])
    of = np.array(source)
    loud, own = noise[of[:prop_size]], np.arange(prop_size)
    shares = drawn[:, of[:prop_size]]
    # of one draw, at the precision with which it was added
    same = np.abs(shares[:, :, None] - shares[:, None]).max(0) < 1e-2
    return Layout(
        names=names,
        column=column,
        noisy=noisy,
        source=of,
        prop_size=prop_size,
        noise=loud.astype(np.float32),
        draw=np.where(loud > 0, same.argmax(-1), own),
        views=Views(
            actor=column[:acts],
            critic=np.unique(column[acts:seen]) if len(names) > 1 else column[:acts],
            model=np.flatnonzero(~(useless[of] & (of >= seen))),
        ),
        **of_data,
    )


def _is_counter(x):
    return np.full(np.shape(x), np.issubdtype(np.asarray(x).dtype, np.integer), float)


def _places(names, one: Raw, flag) -> np.ndarray:
    """[E] where `flag` of a part of `one` is not 0."""
    return np.asarray(vector(names, jax.tree.map(flag, one))) > 0


def pack(layout: Layout, raw: Float[Array, " E"], exact: Float[Array, " E"]):
    """`(obs, prop)` of raw numbers, and of the same without noise; only those with noise are taken from
    `exact`."""
    obs, size = raw[layout.source], layout.prop_size
    return obs, jnp.where(layout.noise > 0, exact[layout.source[:size]], obs[:size])


def unpack(layout: Layout, obs: Float[Array, " O"], prop: Float[Array, " P"]) -> Float[Array, " E"]:
    """The raw numbers of an `obs` and its exact `prop`."""
    known = jnp.concatenate([prop, obs[layout.prop_size :]])
    return jnp.where(layout.noisy, obs[layout.column], known[layout.column])


def key_of(*numbers: Float[Array, " K"]) -> Array:
    """A raw random key from numbers: in a tail, where a task's own key is not known, its draws follow from
    the row. Equal rows draw the same."""
    bits = jax.lax.bitcast_convert_type(jnp.concatenate(numbers), jnp.uint32)
    odd = 2 * jnp.arange(bits.size, dtype=jnp.uint32) + 1
    mixed = (bits ^ (bits >> 15)) * jnp.uint32(0x9E3779B1)
    return jnp.stack([(mixed * odd).sum(dtype=jnp.uint32), (mixed ^ odd).sum(dtype=jnp.uint32)])
