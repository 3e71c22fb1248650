"""The observation: what a policy of the velocity task sees, 48 numbers on a robot of 12 joints.

The code works with NumPy and jax.numpy, so that a policy can be played without JAX. It uses only
qpos and qvel, because after `mjx.step` every derived quantity is one substep old.

| quantity         | numbers, of 12 joints | content                                     | unit       |
|------------------|-------|----------------------------------------------------------|------------|
| predicted (prop) | 0-11  | joint positions minus the default pose                   | rad        |
|                  | 12-23 | joint velocities                                         | rad/s      |
|                  | 24-26 | direction of gravity in the base frame                   |            |
|                  | 27-29 | velocity of the base's centre of mass, base frame        | m/s        |
|                  | 30-32 | angular velocity, base frame                             | rad/s      |
| known (context)  | 33-35 | command vx, vy, yaw rate                                 | m/s, rad/s |
|                  | 36-47 | previous action                                          |            |

With `task.gait_frequency` two known quantities of a biped follow (gait.py): `gait_phase`, 2 numbers, and
`gait_turn`, one, which no policy sees.

Quantities of one's own (`task.terms`; own.py) follow these: predicted ones after the angular velocity, known
ones after the previous action. `own` in the functions below are these, () where there are none.

The order is the paper's, o = [q, qd, g, v, w] and [c, a]: the transition model predicts the first,
and `advance` computes the second. `PREDICTED` and `KNOWN` define the quantities; from them follow
sizes, noise, mirror image, the tables of ONNX files and what a reward term can ask for. To add one,
add an entry there and a value in `observe`, and for `KNOWN` also one in `advance` (docs/task.md).
"""

import json
import re
from collections.abc import Callable
from functools import cache
from itertools import accumulate, product
from typing import NamedTuple

import numpy as np

from dynappo.tasks.velocity import gait

# by `task.observation`, with the count of numbers behind it the name in policy files ("velocity-48"): a
# policy that sees other numbers is refused by its name, so change it with them
NAMES = {"full": "velocity", "onboard": "onboard"}
CLOCKED = "-phase"  # follows the name of one with a gait clock, as in "velocity-phase-101"
OWN = "-own"  # follows that of one with quantities of one's own, as in "velocity-own-51"
# quantities that no sensor tells, and the share of a gait clock that the policy is not to see
UNSEEN = {"full": ("gait_turn",), "onboard": ("linear_velocity", "gait_turn")}


class Quantity(NamedTuple):
    """One quantity of an observation: numbers that belong together."""

    size: int | None  # None: one number a joint
    unit: str
    content: str
    noise: str = ""  # the field of task.noise with its half width; "": none
    # of each number in the left-right mirror image; None: mirrored as the joints
    signs: tuple[int, ...] | None = None
    scale: float = 1.0  # of what networks learn from, with `ppo.scale_inputs`; as in legged_gym
    order: tuple[int, ...] | None = None  # which number each is in the mirror image; None: the same


class OwnQuantity(NamedTuple):
    """One of `task.terms`, as its file declares it (config/terms.py)."""

    name: str
    quantity: Quantity
    known: bool  # else predicted
    shown: bool  # to the policy


Own = tuple[OwnQuantity, ...]


# signs of vectors in the mirror image; rotations have the opposite sign
MOVES, TURNS = (1, -1, 1), (-1, 1, -1)
# the state at the end of a row: the transition model predicts it
PREDICTED = dict(
    joint_position=Quantity(None, "rad", "minus default_pose", "joint_pos"),
    joint_velocity=Quantity(None, "rad/s", "of each joint", "joint_vel", scale=0.05),
    gravity=Quantity(3, "1", "its direction, base frame (0 0 -1 upright)", "gravity", MOVES),
    linear_velocity=Quantity(
        3, "m/s", "of the base's centre of mass (base_com), base frame", "linear_velocity", MOVES
    ),
    angular_velocity=Quantity(3, "rad/s", "base frame", "angular_velocity", TURNS, 0.25),
)
# what follows from the row before: `advance` computes it
KNOWN = dict(
    command=Quantity(3, "m/s, m/s, rad/s", "vx, vy, yaw rate, base frame", signs=(1, -1, -1)),
    previous_action=Quantity(None, "1", "action of the step before; zero at first"),
)
# the same, with `task.gait_frequency`
GAIT = dict(
    gait_phase=Quantity(
        2,
        "1",
        "sine and cosine of the first foot's phase, 0 where it is highest; 0 0 to stand",
        signs=(-1, -1),
    ),
    gait_turn=Quantity(1, "rad", "advance of the phases in a control step", signs=(1,)),
)
QUANTITIES = PREDICTED | KNOWN | GAIT


@cache
def own(about: str) -> Own:
    """The quantities of one's own in `task.terms_about`; ValueError where `terms.use` did not write it."""
    if not about:
        return ()
    try:
        return tuple(_own(part) for part in json.loads(about)["observation"])
    except (KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"task.terms_about is damaged ({error})") from None


def _own(part) -> OwnQuantity:
    def expect(ok, name):
        if not ok:
            raise ValueError(
                f"task.terms_about has a quantity whose {name} is {str(part[name])[:80]!r}"
            )

    name, size, signs, order = (part[key] for key in ("name", "size", "signs", "order"))
    expect(isinstance(name, str) and name.isidentifier() and len(name) <= 100, "name")
    expect(size is None or (type(size) is int and 0 < size <= 10_000), "size")
    expect(signs is None or (len(signs) == size and set(signs) <= {1, -1}), "signs")
    expect(order is None or sorted(order) == [*range(size or 0)], "order")
    expect(type(part["scale"]) is float and abs(part["scale"]) < 1e9, "scale")
    for text in ("unit", "content"):
        expect(isinstance(part[text], str) and len(part[text]) <= 1000, text)
    quantity = Quantity(
        size=size,
        unit=part["unit"],
        content=part["content"],
        noise=name if part["noisy"] else "",
        signs=None if signs is None else tuple(signs),
        scale=part["scale"],
        order=None if order is None else tuple(order),
    )
    return OwnQuantity(name, quantity, bool(part["known"]), bool(part["shown"]))


@cache
def quantities(clock: bool = False, own: Own = ()) -> dict[str, Quantity]:
    """The quantities of an observation, with or without a gait clock, in their order."""
    known = {each.name: each.quantity for each in own if each.known}
    return predicted(own) | KNOWN | known | (GAIT if clock else {})


@cache
def predicted(own: Own = ()) -> dict[str, Quantity]:
    """Those that the transition model predicts, which come first."""
    return PREDICTED | {each.name: each.quantity for each in own if not each.known}


def _slices(names, joints: int, own: Own = ()) -> dict[str, slice]:
    sizes = [_size(name, joints, own) for name in names]
    ends = zip(names, sizes, accumulate(sizes), strict=True)
    return {name: slice(stop - size, stop) for name, size, stop in ends}


@cache
def slices(joints: int, clock: bool = False, own: Own = ()) -> dict[str, slice]:
    """Where each quantity is in the observation of a robot of so many joints."""
    return _slices([*quantities(clock, own)], joints, own)


def size(joints: int, clock: bool = False, own: Own = ()) -> int:
    """Numbers of an observation."""
    return [*slices(joints, clock, own).values()][-1].stop


def prop_size(joints: int, own: Own = ()) -> int:
    """Numbers of its predicted quantities, which come first."""
    return slices(joints, own=own)[[*predicted(own)][-1]].stop


def name(observation: str, joints: int, clock: bool = False, own: Own = ()) -> str:
    """The name, in policy files, of one step's reading with `task.observation`."""
    count = sum(_size(each, joints, own) for each in _seen(observation, clock, own))
    return f"{NAMES[observation]}{CLOCKED * clock}{OWN * bool(own)}-{count}"


def quantity(name: str, own: Own = ()) -> Quantity:
    """The quantity of a name."""
    return quantities(True, own)[name]


def _size(name: str, joints: int, own: Own = ()) -> int:
    count = quantity(name, own).size
    return joints if count is None else count


def _seen(observation: str, clock: bool, own: Own = ()) -> list[str]:
    unseen = {*UNSEEN[observation], *(each.name for each in own if not each.shown)}
    return [each for each in quantities(clock, own) if each not in unseen]


@cache
def _named(name: str, own: Own = ()) -> tuple[str, int, bool]:
    """`(task.observation, joints, clock)` of a name; ValueError if it is none."""
    for observation, clock in product(NAMES, (False, True)):
        text = NAMES[observation] + CLOCKED * clock + OWN * bool(own)
        found = re.fullmatch(rf"{re.escape(text)}-(\d{{1,4}})", name)
        sizes = [quantity(each, own).size for each in _seen(observation, clock, own)]
        joints, rest = divmod(
            int(found[1]) - sum(filter(None, sizes)) if found else -1, sizes.count(None)
        )
        if found and joints > 0 and not rest:
            return observation, joints, clock
    raise ValueError(f"no observation has the name {name!r}")


def has_clock(name: str, own: Own = ()) -> bool:
    """Whether a policy of observation `name` sees a gait clock."""
    return _named(name, own)[2]


def shown(name: str, own: Own = ()) -> tuple[str, ...]:
    """The quantities that a policy of observation `name` sees."""
    observation, _, clock = _named(name, own)
    return tuple(_seen(observation, clock, own))


def columns(name: str, own: Own = ()) -> np.ndarray:
    """The columns of an observation that a policy of observation `name` sees."""
    _, joints, clock = _named(name, own)
    where = slices(joints, clock, own)
    return np.concatenate([np.arange(where[q].start, where[q].stop) for q in shown(name, own)])


def reading(name: str, own: Own = ()) -> dict[str, slice]:
    """Where each quantity is in one step's reading of a policy of observation `name`."""
    return _slices(shown(name, own), _named(name, own)[1], own)


def memory(name: str, history: int, own: Own = ()) -> Callable[[np.ndarray], np.ndarray]:
    """`see(observation) -> what the policy sees`, step after step of one episode: its readings, newest first.

    Before the first there was nothing else: it stands for all before it.
    """
    seen, kept = columns(name, own), []

    def see(obs):
        now = obs[seen]
        kept.insert(0, now)
        kept[history:] = []
        kept.extend([now] * (history - len(kept)))
        return np.concatenate(kept)

    return see


def rotate_inverse(quat, vector):
    """World `vector` [3] in the frame of the unit quaternion `quat` (w, x, y, z)."""
    w, u = quat[0], quat[1:]
    # v' = v + 2 u x (u x v) - 2 w (u x v)
    uv = cross(u, vector)
    return vector + 2 * cross(u, uv) - 2 * w * uv


def cross(a, b):
    """The cross product of vectors [..., 3]."""
    (ax, ay, az), (bx, by, bz) = ([v[..., i] for i in range(3)] for v in (a, b))
    products = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return a.__array_namespace__().stack(products, axis=-1)


def heading(quat):
    """Direction of the base's x axis in the world's plane, rad from the world's x axis."""
    xp = quat.__array_namespace__()
    w, x, y, z = (quat[i] for i in range(4))
    return xp.atan2(2 * (x * y + w * z), 1 - 2 * (y**2 + z**2))


def base_motion(qpos, qvel, base_com):
    """`(gravity, linear, angular)`, each [3], in the base frame.

    `gravity` is the unit direction; `linear` (m/s) is the velocity of the base's centre of mass,
    `base_com` (m) in the base frame. A MuJoCo free joint has world linear velocity of the frame's
    origin in qvel[0:3] and local angular velocity in qvel[3:6].
    """
    xp = qpos.__array_namespace__()
    quat, angular = qpos[3:7], qvel[3:6]
    # the third row of the rotation matrix, negated: where "down" points in the base frame
    w, x, y, z = (quat[i] for i in range(4))
    gravity = -xp.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)))
    linear = rotate_inverse(quat, qvel[0:3]) + cross(angular, base_com)
    return gravity, linear, angular


def observe(
    qpos, qvel, base_com, default_pose, command, last_action, clock=None, own: Own = (), of_own=None
):
    """The observation [O] of one robot, without noise; see the module's table.

    `clock` is the angle and the turn (rad) of a gait clock; None where the robot has none. `of_own(values)`
    gives the quantities `own` by name, from the others.
    """
    xp = qpos.__array_namespace__()
    gravity, linear, angular = base_motion(qpos, qvel, base_com)
    values = dict(
        joint_position=qpos[7:] - default_pose,
        joint_velocity=qvel[6:],
        gravity=gravity,
        linear_velocity=linear,
        angular_velocity=angular,
        command=command,
        previous_action=last_action,
    )
    if clock is not None:
        angle, turn = clock
        values |= dict(gait_phase=gait.shown(angle, command), gait_turn=xp.asarray(turn)[None])
    if own:
        assert of_own is not None
        values |= of_own(values)
    return xp.concat([values[name] for name in quantities(clock is not None, own)])


def advance(context, action, clock: bool = False, own: Own = (), of_own=None):
    """The known quantities [..., C] of the observation after `action`, from those before.

    `of_own(before)` gives those of `own`, from all before.
    """
    xp = context.__array_namespace__()
    before = split_context(context, action.shape[-1], clock, own)
    values = dict(
        command=before["command"],
        previous_action=action,
    )
    if clock:
        phase, turn = before["gait_phase"], before["gait_turn"]
        values |= dict(gait_phase=gait.shown_later(phase, turn), gait_turn=turn)
    if own:
        assert of_own is not None
        values |= of_own(before)
    return xp.concat([values[name] for name in _known(clock, own)], axis=-1)


def _known(clock: bool, own: Own = ()) -> list[str]:
    return [name for name in quantities(clock, own) if name not in predicted(own)]


def split(obs, joints: int, clock: bool = False, own: Own = ()):
    """The quantities of observations [..., O] of a robot of so many joints, by name."""
    return {name: obs[..., where] for name, where in slices(joints, clock, own).items()}


def split_context(context, joints: int, clock: bool = False, own: Own = ()):
    """As `split`, of the known quantities [..., C] alone."""
    known = _slices(_known(clock, own), joints, own)
    return {name: context[..., where] for name, where in known.items()}


def split_prop(prop, joints: int, own: Own = ()):
    """As `split`, of the predicted quantities [..., P] alone."""
    return {name: prop[..., where] for name, where in _slices(predicted(own), joints, own).items()}


def noise_scale(noise, xp, joints: int, clock: bool = False, own: Own = ()):
    """Half widths [O] of the uniform observation noise; `noise` is the config's group."""
    every = quantities(clock, own)
    scales = [
        getattr(noise, every[name].noise) if every[name].noise else 0.0
        for name, where in slices(joints, clock, own).items()
        for _ in range(where.start, where.stop)
    ]
    return xp.stack([xp.asarray(v) for v in scales])
