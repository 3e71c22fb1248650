"""Which terms of a task's reward, and whether its end, follow from what the model predicts. Found by probing.

A step computes them from data after physics. Many of these are numbers that the model predicts: joints, the
base's velocity in a sensor, an upright vector. So in a tail such data are filled in (`filled`), and the
task's own step computes from them. A term is known if it is then the same in all of many random states, whose
data C MuJoCo computes, and so is the end. The others read what is not predicted, or contacts, at which the
model can only guess.

    reward = factor x (sum of known terms + rest), at least 0 where the task clips

The rest, the sum of the terms that are not known, is one more number that the model predicts (`parts.Raw`).
Why not what is left of the reward, as elsewhere (`model.known_reward`): where a reward is clipped, that would
be a number of the known terms themselves, and these are large where a robot does badly.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Array, Float

from dynappo.tasks.playground import parts
from dynappo.tasks.playground.parts import Layout, Probed

FALL = "reward/termination"
CLOSE = 1e-3  # share of a number and its spread that rounding may take
FEWEST = 10  # probes that end, and that do not


class Known(NamedTuple):
    """Constants of the program."""

    # of a field of data: flat places, the numbers of prop that belong there, their sign and what is added
    places: dict[str, tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]
    terms: tuple[str, ...]  # names in the task's metrics
    rest: tuple[str, ...]
    factor: float  # reward for a sum of terms
    end: bool


def find(task: Any, layout: Layout, probed: Probed, fall_paid: bool) -> Known | None:
    """What is known of a task, or None if it is no term. With `fall_paid` a fall's own term is in neither
    part: `Env.fall_reward` pays it."""
    draw = np.random.default_rng(2)
    before, after = (_states(task.mj_model, layout.home, draw) for _ in range(2))
    home = {name: np.repeat(x[None], parts.PROBES, 0) for name, x in layout.home.items()}
    action = draw.uniform(-1, 1, (parts.PROBES, task.action_size)).astype(np.float32)

    def ask(raw, action, before, after):
        return jax.device_get(probed.ask(raw, action, before, after, before, after))

    typed, (exact, *_), paid, terms, ended = ask(probed.raw, action, before, after)
    prop = exact[:, layout.source[: layout.prop_size]]
    places = _places(prop, after)
    guessed = {name: x.copy() for name, x in home.items()}
    for name, (flat, numbers, sign, shift) in places.items():
        values = sign * prop[:, numbers] + shift
        guessed[name].reshape(parts.PROBES, -1)[:, flat] = values
    *_, again, _ = ask(probed.raw, action, home, guessed)
    names = sorted(name for name in terms if not (fall_paid and name == FALL))
    same = {name: _same(terms[name], again[name]) for name in names}
    total = np.sum([*terms.values()], axis=0)
    factor = _factor(total, paid, layout.clipped)
    if factor is None or not any(same.values()):
        return None
    # the end is asked for in the state after a row: whether it follows from that alone
    *_, ends = ask(typed, np.zeros_like(action), home, guessed)
    several = FEWEST <= ended.sum() <= parts.PROBES - FEWEST
    return Known(
        places=places,
        terms=tuple(name for name in names if same[name]),
        rest=tuple(name for name in names if not same[name]),
        factor=factor,
        end=bool(several and (ends == ended).all()),
    )


def _states(model: mujoco.MjModel, home, draw) -> dict[str, np.ndarray]:
    """Data of random states about the first pose, some of them far from it."""
    states = []
    for size in 10 ** draw.uniform(-1.5, 0.3, parts.PROBES):
        turn, qpos = np.zeros(4), home["qpos"].astype(float)
        mujoco.mju_euler2Quat(turn, draw.normal(0, [size, size, 1.0]), "xyz")
        mujoco.mju_mulQuat(qpos[3:7], turn, home["qpos"][3:7].astype(float))
        qpos[:3] += draw.normal(0, [1.0, 1.0, 0.03])
        qpos[7:] += draw.normal(0, min(size, 0.5), len(qpos) - 7)
        ctrl = home["ctrl"] + draw.normal(0, 0.3, model.nu)
        states.append((qpos, draw.normal(0, size, model.nv), ctrl))
    return parts.data_of_states(model, states)


def _same(x: np.ndarray, y: np.ndarray) -> bool:
    return bool((np.abs(x - y) <= CLOSE * (np.abs(x) + np.ptp(x))).all())


def _places(prop: np.ndarray, after: dict[str, np.ndarray]):
    """Where in data the numbers of `prop` [K, P] are, up to a sign and a constant."""
    found = {}
    measured = [i for i, x in enumerate(prop.T) if len(np.unique(x)) > 2]  # not a contact
    for name in parts.FIELDS:
        data = after[name].reshape(len(prop), -1).astype(float)
        room = 1e-5 * (1 + np.abs(data).max(0))
        places: dict[int, tuple[int, float, float]] = {}
        for i in measured:
            for sign in (1.0, -1.0):
                off = data - sign * prop[:, i, None]
                for at in np.flatnonzero(np.ptp(off, axis=0) <= room).tolist():
                    places.setdefault(at, (i, sign, float(np.median(off[:, at]))))
        if places:
            numbers, sign, shift = map(np.array, zip(*places.values(), strict=True))
            found[name] = (
                np.array(list(places)),
                numbers,
                sign.astype(np.float32),
                shift.astype(np.float32),
            )
    return found


def _factor(total: np.ndarray, reward: np.ndarray, clipped: bool) -> float | None:
    """`reward / total`, where it is one number; None where it is not."""
    paid = (reward > 0) & (total > 0) if clipped else np.abs(total) > 1e-6
    if not paid.any():
        return None
    factor = float(np.median(reward[paid] / total[paid]))
    expected = np.maximum(factor * total, 0) if clipped else factor * total
    close = np.abs(reward - expected) <= CLOSE * (np.abs(factor * total) + 1e-3)
    return factor if close.all() else None


def filled(layout: Layout, known: Known, data: Any, prop: Float[Array, " P"]) -> Any:
    """`data` of the first pose with the numbers of `prop` in their places."""
    fields = {}
    for name, x in layout.home.items():
        if name in known.places:
            flat, numbers, sign, shift = known.places[name]
            x = jnp.asarray(x).ravel().at[flat].set(sign * prop[numbers] + shift)
        fields[name] = x
    return parts.with_fields(data, fields)


def reward(layout: Layout, known: Known, metrics: dict[str, Any], prop: Float[Array, " P"]):
    """The reward of a step in filled data, whose terms are in `metrics`, into a state `prop`."""
    total = known.factor * (sum(metrics[name] for name in known.terms) + prop[layout.prop_size - 1])
    return jnp.maximum(total, 0.0) if layout.clipped else total
