"""Plays a policy in C MuJoCo and NumPy, in its robot's own file or in another MJCF (sim-to-sim).

Another MJCF must have the policy's hinge joints by name, in any order and with other joints in between;
and above them the base, a body with a free joint, x ahead and z up. A file without a floor, as robots are
published, gets one. Masses, contacts and time step come from that file, and armature too, unless the policy
was trained with its own (task.armature).

Only the actuators change: the file's are off, and the policy's own motor model drives the joints, with PD
and limits (`physics/actuators.py`), joint damping and friction. Why the last two: in a file for position
servos (MuJoCo Menagerie's Go1: kp 100, damping 2) they are the servo's.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from dynappo.config import ConfigError
from dynappo.description import contacts, mjcf, motors
from dynappo.description import feet as feet_lib
from dynappo.physics import actuators, ground
from dynappo.policy.policy_file import Policy
from dynappo.policy.walks import SETTLE
from dynappo.tasks.velocity import observe
from dynappo.tasks.velocity import own as own_lib
from dynappo.terrain import height_map, scan
from dynappo.terrain.height_map import HeightMap

UNEVEN = 0.02  # rad, about a degree
STRIDE = 0.5  # s between points of the path walked, so that swaying adds no distance
WAY = 0.5  # m; on a shorter one starting decides what it costs
NEAR = 0.25  # of the base's height: a limb's end that is lower in the default pose is a foot
PLAIN = [0.62, 0.66, 0.70, 1.0]  # colour of rough ground
FILM_SECONDS = 12.0  # of the tour in a film
PAGE_SECONDS = 16.0  # of the tour on the live page, which begins it again
TOUR = (  # the commands if none is given: (share of the time, (vx, vy, yaw rate))
    (0.3, (0.8, 0.0, 0.0)),
    (0.2, (0.6, 0.0, 0.8)),
    (0.2, (0.0, 0.5, 0.0)),
    (0.3, (1.0, 0.0, 0.0)),
)


class Box(NamedTuple):
    """A box that stands in the world."""

    middle: tuple[float, float, float]  # m
    half: tuple[float, float, float]  # m, half of its sides


class Player(NamedTuple):
    """A robot in a compiled model, and the policy that plays it; arrays of `A` joints are in its order."""

    xml: Path
    text: str  # the MJCF, if `xml` is a file that contains it; else ""
    model: mujoco.MjModel
    policy: Policy
    base_body: int
    root: tuple[int, int]  # where the free joint starts in qpos and in qvel
    joint_q: np.ndarray  # [A] indices in qpos
    joint_v: np.ndarray  # [A] indices in qvel
    ground: np.ndarray  # [ngeom] bool: fixed to the world
    parts: np.ndarray  # [ngeom] bool: of the robot, and not a foot
    foot_of: np.ndarray  # [ngeom] the number of the foot that it is a shape of, else -1
    foot_names: tuple[str, ...]  # [F]
    substeps: int
    field: HeightMap | None = None  # the ground; None: as the file has it
    own: own_lib.Own = own_lib.NONE  # the policy's terms of one's own, and
    given: Mapping[str, float] = {}  # the numbers of its task, which these may ask for


def load(
    xml: Path,
    policy: Policy,
    timestep: float | None = None,
    keep_joints: bool = False,
    text: str = "",
    field: HeightMap | None = None,
    boxes: tuple[Box, ...] = (),
) -> Player:
    """The robot of `xml`, driven by `policy`; `timestep` (s) replaces that of the file, `field` its floor.

    With `boxes` the ground is the file's floor and these, and `field` is only the map that a policy sees.

    If `text` is given, it is the MJCF, and `xml` the file that contains it. Without `timestep`, the
    file's own is changed to the nearest that divides the time between two actions. `keep_joints`:
    keep the file's joint damping, friction and armature. ConfigError if the file breaks the rules above.
    """

    def expect(ok, text):
        if not ok:
            raise ConfigError(f"{xml}: expected {text}")

    model = compiled(xml, text, field, boxes)
    kinds = {model.joint(i).name: int(model.jnt_type[i]) for i in range(model.njnt)}
    hinge, free = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_FREE)
    lacks = [name for name in policy.joint_names if kinds.get(name) != hinge]
    found = ", ".join(name for name in kinds if name) or "none"
    expect(not lacks, f"hinge joints {', '.join(lacks)} of the policy; its joints are {found}")
    joints = np.array([model.joint(name).id for name in policy.joint_names])
    top = model.body_rootid[model.jnt_bodyid[joints]]
    roots = [
        i for i in range(model.njnt) if model.jnt_type[i] == free and model.jnt_bodyid[i] in top
    ]
    expect(len(roots) == 1 and (top == top[0]).all(), "one base with a free joint above all joints")
    touches, ground = mjcf.touches(model), model.body_weldid[model.geom_bodyid] == 0
    robot = model.body_rootid[model.geom_bodyid] == top[0]
    expect((robot & touches).any(), "geoms of the robot that can touch the floor")
    feet = _named_feet(model, robot & touches) or _lowest_limbs(
        model, joints, policy.default_pose, robot & touches
    )
    expect(feet, "feet: geoms named LEG_foot, or limbs whose last body can touch the floor")
    foot_of = np.full(model.ngeom, -1)
    for foot, shapes in enumerate(feet.values()):
        foot_of[shapes] = foot
    if not keep_joints and policy.joint_damping:
        model.dof_damping[model.jnt_dofadr[joints]] = policy.joint_damping
        model.dof_frictionloss[model.jnt_dofadr[joints]] = policy.joint_friction
    if keep_joints:
        policy = policy._replace(dry_friction=0.0)
    elif policy.armature is not None:
        motors.set_armature(model, model.jnt_dofadr[joints], policy.armature)
    between = policy.timestep * policy.substeps  # s, two actions
    own = own_lib.played(policy.config.get("task", {}), len(joints), between)
    substeps = max(1, round(between / (timestep or model.opt.timestep)))
    model.opt.timestep = between / substeps
    model.opt.iterations = max(model.opt.iterations, 100)  # solved until it has converged
    model.opt.ls_iterations = max(model.opt.ls_iterations, 50)
    # no actuators: ours act instead; no autoreset: a blow-up is reported, not hidden
    flags = mujoco.mjtDisableBit
    model.opt.disableflags |= int(flags.mjDSBL_ACTUATION) | int(flags.mjDSBL_AUTORESET)
    return Player(
        xml=xml,
        text=text,
        model=model,
        policy=policy,
        base_body=int(top[0]),
        root=(int(model.jnt_qposadr[roots[0]]), int(model.jnt_dofadr[roots[0]])),
        joint_q=model.jnt_qposadr[joints],
        joint_v=model.jnt_dofadr[joints],
        ground=ground,
        parts=robot & touches & (foot_of < 0),
        foot_of=foot_of,
        foot_names=tuple(feet),
        substeps=substeps,
        field=field,
        own=own,
        given=own_lib.numbers_in(policy.config.get("task", {})),
    )


def compiled(
    xml: Path,
    text: str = "",
    field: HeightMap | None = None,
    boxes: tuple[Box, ...] = (),
    drawn: bool = False,
) -> mujoco.MjModel:
    """The model of a file, or of the MJCF `text` in it, on a ground in the place of its geom `floor`; or on
    that floor, with boxes on it. `drawn`: for pictures alone, on a ground that nothing touches."""
    if field is None and not boxes:
        return mjcf.model(xml, text)
    with mjcf.one_line(xml):
        if text:
            mjcf.check_alone(text)
        spec = mujoco.MjSpec.from_string(text) if text else mujoco.MjSpec.from_file(str(xml))
        if spec.geom("floor") is None:
            raise ConfigError(
                f"{xml}: expected a geom named floor, which the rough ground replaces"
            )
        floor = spec.geom("floor")
        for box in boxes:
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=box.middle,
                size=box.half,
                friction=floor.friction,
                contype=floor.contype,
                conaffinity=floor.conaffinity,
                condim=floor.condim,
                priority=floor.priority,
            )
        if field is not None and not boxes:
            (ground.draw if drawn else ground.put)(spec, field)
            floor.material, floor.rgba = (
                "",
                PLAIN,
            )  # a pattern would be stretched on the walls of steps
        return mjcf.check_model(spec.compile())


def _named_feet(model, touches) -> dict[str, list[int]]:
    """The geoms of each foot by its name, of those geoms named `LEG_foot` that touch."""
    names = [model.geom(i).name if touches[i] else "" for i in range(model.ngeom)]
    shapes, foot_of, feet = feet_lib.named(names)
    return {name: shapes[foot_of == foot].tolist() for foot, name in enumerate(feet)}


def _lowest_limbs(model, joints, pose, touches) -> dict[str, list[int]]:
    """As `_named_feet`, in a file without such names: all geoms of the bodies that the last joints of the
    limbs move, by their names, but of a limb that ends well above the ground, as an arm does."""
    moved = set(model.jnt_bodyid[joints].tolist())
    last = sorted(moved - {b for body in moved for b in _above(model, body)})
    above = [{int(b), *_above(model, b)} for b in model.geom_bodyid]
    limbs = {b: [i for i in np.flatnonzero(touches).tolist() if b in above[i]] for b in last}
    data, base = mujoco.MjData(model), model.body_rootid[last[0]]
    root = model.jnt_qposadr[model.body_jntadr[base]]
    data.qpos[root + 3 : root + 7] = [1, 0, 0, 0]
    data.qpos[model.jnt_qposadr[joints]] = pose
    mujoco.mj_kinematics(model, data)
    heights = {b: _lowest(model, data, shapes).min() for b, shapes in limbs.items() if shapes}
    if not heights:
        return {}
    low = min(heights.values())
    top = low + NEAR * (data.xpos[base, 2] - low)
    feet = [b for b, height in heights.items() if height < top]
    return {model.body(b).name or f"number {b}": limbs[b] for b in feet}


def _above(model, body):
    """The ancestors of `body`, but the world."""
    while (body := int(model.body_parentid[body])) > 0:
        yield body


def coordinates(player: Player, data) -> tuple[np.ndarray, np.ndarray]:
    """`(qpos [7 + A], qvel [6 + A])` as in `tasks/velocity/observe.py`: base, then the policy's joints."""
    q, v = player.root
    qpos = np.concatenate([data.qpos[q : q + 7], data.qpos[player.joint_q]])
    return qpos, np.concatenate([data.qvel[v : v + 6], data.qvel[player.joint_v]])


def reset(player: Player, data) -> None:
    """Put the robot upright in the default pose, its lowest point on the floor (z = 0), or as high above the
    highest ground that is below the robot.

    Each joint is off by up to `UNEVEN`, always by the same amount: a policy that treats left and
    right alike cannot take a first step from an exactly symmetric pose. No real robot stands in
    one.
    """
    mujoco.mj_resetData(player.model, data)
    q = player.root[0]
    data.qpos[q + 3 : q + 7] = [1, 0, 0, 0]
    off = np.random.default_rng(0).uniform(-UNEVEN, UNEVEN, len(player.joint_q))
    off = off[np.argsort(np.argsort(player.policy.joint_names))]  # the same in any joint order
    data.qpos[player.joint_q] = player.policy.default_pose + off
    mujoco.mj_kinematics(player.model, data)
    robot = player.model.body_rootid[player.model.geom_bodyid] == player.base_body
    shapes = np.flatnonzero(robot & mjcf.touches(player.model))
    data.qpos[q + 2] -= _lowest(player.model, data, shapes).min()
    if player.field is not None:
        x, y = data.geom_xpos[shapes, :2].T
        data.qpos[q + 2] += height_map.height(*player.field, x, y).max()
    mujoco.mj_forward(player.model, data)


def _lowest(model, data, geoms) -> np.ndarray:
    """Heights (m) of the lowest points of `geoms`; of a mesh, of the box around it."""
    ids = np.asarray(geoms, int)
    return lowest(model, ids, data.geom_xpos[ids, 2], data.geom_xmat[ids, 6:])


def lowest(model, ids: np.ndarray, height: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Heights [..., G] (m) of the lowest points of geoms `ids` [G]; of a mesh, of the box around it.

    `height` [..., G] is that of their centres, `row` [..., G, 3] the third row of each rotation matrix.
    """
    exact = contacts.lowest(contacts.floor_distance(model, ids), height, row)
    centre, half = model.geom_aabb[ids, :3], model.geom_aabb[ids, 3:]
    around = height + (centre * row).sum(-1) - (half * np.abs(row)).sum(-1)
    return np.where(np.isin(model.geom_type[ids], [*contacts.MOST]), exact, around)


def foot_heights(player: Player, data) -> np.ndarray:
    """Heights [F] (m) of the feet's lowest points."""
    feet = [np.flatnonzero(player.foot_of == foot) for foot in range(len(player.foot_names))]
    return np.array([_lowest(player.model, data, shapes).min() for shapes in feet])


def look(
    player: Player, data, command, last_action, time: float | None = None, kept=None
) -> np.ndarray:
    """The observation of the robot in `data`, without noise.

    `time` (s) since the start is what a gait clock shows; None: that of `data`. `kept` are the known
    quantities of one's own (`own_lib.starts`); None: those of the start.
    """
    time = data.time if time is None else time
    com, clock = player.model.body_ipos[player.base_body], gait_clock(player, time)

    def of_own(values):
        facts = {**player.given, **values, **_placed(player, data)._asdict()}
        now = start(player) if kept is None else kept
        return own_lib.predicted(player.own, facts) | now

    told = player.policy.default_pose, command, last_action, clock, player.own.seen
    return observe.observe(*coordinates(player, data), com, *told, of_own=of_own)


def start(player: Player) -> dict[str, Any]:
    """The known quantities of one's own where an episode begins, with curricula as in an evaluation."""
    levels = {name: term.how.evaluated for name, term in player.own.terms.curricula.items()}
    return own_lib.starts(player.own, {**player.given, **levels}, np) or {}


def _placed(player: Player, data) -> own_lib.Placed:
    """What an observation of one's own may ask for."""
    qpos, qvel = coordinates(player, data)
    contact = np.zeros(len(player.foot_names), bool)
    one, other = data.contact.geom[data.contact.dist < 0].T
    for touching, touched in ((one, other), (other, one)):
        feet = player.foot_of[touching[player.ground[touched]]]
        contact[feet[feet >= 0]] = True
    height = qpos[2]
    if player.field is not None:
        height = height - _height(player, qpos[:1], qpos[1:2])[0]
    return own_lib.Placed(qpos=qpos, qvel=qvel, height=height, contact=contact)


def ends(player: Player) -> list[str]:
    """The terminations of one's own that end an episode here, as a fall or as the time."""
    return own_lib.ends_in_play(player.own, player.given)


def _own_step(
    player: Player, data, told: tuple[Any, Any], action, time: float, kept
) -> tuple[dict[str, Any], bool]:
    """`(kept, fell)` after a control step with `action`: known quantities of one's own, and its ends.

    `told` are command and action before it, `time` (s) and `kept` as they were then.
    """
    parts = observe.split(
        look(player, data, *told, time=time, kept=kept),
        len(player.joint_q),
        player.policy.gait_frequency is not None,
        player.own.seen,
    )
    facts = {**player.given, **parts, "action": action}
    after = own_lib.following(player.own, kept, facts)
    facts |= _placed(player, data)._asdict()
    down = own_lib.ends(player.own, facts, timeout=False, names=ends(player))
    return after, any(map(bool, down.values()))


def seen(player: Player, data, shift=(0.0, 0.0, 0.0)) -> np.ndarray:
    """The height scan [S] of the robot in `data`, without noise; empty for a policy that sees none.

    `shift` (m) is by how much its map is off: ahead, left, up. Without a ground of its own, that of a
    floor at height 0.
    """
    if player.policy.scan == "none":
        return np.zeros(0)
    qpos, _ = coordinates(player, data)
    pose = np.append(qpos[:3], observe.heading(qpos[3:7]))
    return scan.scan(lambda x, y: _height(player, x, y), pose, np.asarray(shift, float))


def _height(player: Player, x, y) -> np.ndarray:
    if player.field is None:
        return np.zeros_like(x)
    return height_map.height(*player.field, x, y)


def gait_clock(player: Player, time: float) -> tuple[float, float] | None:
    """Angle and turn (rad) of the policy's gait clock `time` (s) after the start; None if it has none.

    At the middle of the frequencies that it was trained with; at the start the first foot is in mid-swing.
    """
    if player.policy.gait_frequency is None:
        return None
    rate = 2 * np.pi * float(np.mean(player.policy.gait_frequency))  # rad/s
    return rate * time, rate * period(player)


def step(
    player: Player, data, action, targets=None, strength: float = 1.0, after: Callable | None = None
) -> tuple[float, bool]:
    """One control step with `action` in `data`; returns `(work, fell)`.

    `work` (J) is the time integral of the sum over joints of |torque x speed|; `fell`: a part other
    than a foot touched the ground, or the base tilted by more than `task.max_tilt`. `targets` [substeps, A]
    are the joint angles to hold in each physics step; None: those of `action` in all. `after(torque, speed)`
    is called after each; both, and `strength`, are as in `physics_step`.
    """
    p, work, fell = player.policy, 0.0, False
    if targets is None:
        targets = [actuators.target(action, p.default_pose, p.action_scale)] * player.substeps
    for target in targets:
        torque, speed, down = physics_step(player, data, target, strength)
        work += float(np.abs(torque * speed).sum()) * player.model.opt.timestep
        fell |= down
        if after is not None:
            after(torque, speed)
    return work, fell


def physics_step(player: Player, data, target, strength=1.0) -> tuple[np.ndarray, np.ndarray, bool]:
    """One physics step of motors that hold the joint angles `target`: `(torque, speed, fell)`.

    `torque` [A] (N m) is what the joints get, the share `strength` of what the motors should give;
    `speed` [A] (rad/s) is that of the joints when it is applied.
    """
    p = player.policy
    q, speed = data.qpos[player.joint_q], data.qvel[player.joint_v]
    torque = strength * actuators.clip_dc_motor(
        actuators.pd(target, q, speed, p.kp, p.kd),
        speed,
        effort_limit=p.effort_limit,
        saturation_effort=p.saturation_effort,
        velocity_limit=p.velocity_limit,
    )
    data.qfrc_applied[player.joint_v] = torque
    if np.any(p.dry_friction):
        data.qfrc_applied[player.joint_v] -= actuators.friction(speed, p.dry_friction)
    mujoco.mj_step(player.model, data)
    one, other = data.contact.geom[data.contact.dist < 0].T
    ground, parts = player.ground, player.parts
    fell = bool(((ground[one] & parts[other]) | (ground[other] & parts[one])).any())
    most = p.config.get("task", {}).get("max_tilt")  # rad, as in tasks/velocity/env.py
    if most is not None:
        x, y = data.qpos[player.root[0] + 4 : player.root[0] + 6]
        fell |= bool(1 - 2 * (x**2 + y**2) < np.cos(most))
    return torque, speed, fell


def rows(
    player: Player,
    data,
    act: Callable,
    command: Callable,
    observed: Callable | None = None,
    targets: Callable | None = None,
    strength: float = 1.0,
    after: Callable | None = None,
    shift=(0.0, 0.0, 0.0),
):
    """Reset the robot in `data` and yield a row after every control step, for ever.

    A row has `qpos [nq]` of the file's own model; `command` and `velocity [3]` (vx, vy, yaw rate in
    the base frame; m/s, rad/s); `work` (J) and `fell` as in `step`. `act(obs)` is the policy,
    `command(t)` its command. FloatingPointError if physics blows up, ConfigError if MuJoCo fails.

    What disturbs or measures an episode: `observed(k, command, last_action, kept)` is the observation of
    control step k instead of `look`, `targets(k, action)` the joint angles instead of the action's;
    `strength` and `after` are as in `step`, `shift` (m) is as in `seen`.
    """
    # MuJoCo would write warnings to a file in the working directory; what matters is raised
    mujoco.set_mju_user_warning(lambda message: None)
    with mjcf.one_line(player.xml):
        reset(player, data)
    dt, com = period(player), player.model.body_ipos[player.base_body]
    p = player.policy
    action, see = np.zeros(len(p.joint_names)), observe.memory(p.observation, p.history, p.own)
    kept, steps = start(player), bool(player.own.seen or ends(player))
    for k in itertools.count():
        told = np.asarray(command(k * dt), float), action
        wanted = told[0]
        if observed:
            obs = observed(k, *told, kept)
        else:
            obs = look(player, data, *told, kept=kept)
        action = act(np.concatenate([see(obs), seen(player, data, shift)]))
        follows = targets(k, action) if targets else None
        with mjcf.one_line(player.xml):  # MuJoCo may run out of memory
            work, fell = step(player, data, action, follows, strength, after)
        if not (np.isfinite(data.qpos).all() and np.isfinite(data.qvel).all()):
            raise FloatingPointError(
                f"{player.xml}: its physics has blown up after {k * dt:.2f} s (numbers that are not "
                "finite)"
            )
        if steps:
            kept, ended = _own_step(player, data, told, action, k * dt, kept)
            fell |= ended
        _, linear, angular = observe.base_motion(*coordinates(player, data), com)
        velocity = np.array([linear[0], linear[1], angular[2]])
        row = dict(command=wanted, velocity=velocity, work=work, fell=fell)
        yield dict(qpos=data.qpos.copy(), action=action, **row)


def period(player: Player) -> float:
    """Seconds between two actions."""
    return player.model.opt.timestep * player.substeps


def stack(player: Player, some: Iterable[dict]) -> dict[str, np.ndarray]:
    """An episode from `rows`: the same names, stacked to `[T, ...]`, and `dt` (s) between rows."""
    some = list(some)
    columns = {name: np.stack([row[name] for row in some]) for name in some[0]}
    if player.field is not None:
        columns |= {name: np.asarray(x) for name, x in player.field._asdict().items()}
    return columns | {"dt": np.array(period(player))}


def play(player: Player, act: Callable, command: Callable, seconds: float) -> dict[str, np.ndarray]:
    """An episode of `seconds`, of at least one row."""
    steps = max(1, round(seconds / period(player)))
    every = rows(player, mujoco.MjData(player.model), act, command)
    return stack(player, itertools.islice(every, steps))


def measures(player: Player, episode: dict[str, np.ndarray]) -> dict[str, float | None]:
    """Measures of an episode; None if one cannot be computed.

    `seconds`, that it was played; `fall`, the time (s) of a fall. What the robot does after a fall counts
    nowhere: `distance` (m), along points 0.5 s apart; `cost_of_transport`, work / (weight x distance);
    `tracking_error` (m/s) and `yaw_error` (rad/s), root mean squares after the first second.
    """
    dt, count = float(episode["dt"]), len(episode["qpos"])
    q = player.root[0]
    fallen = np.flatnonzero(episode["fell"])
    last = int(fallen[0]) if len(fallen) else count
    every = max(1, round(STRIDE / dt))
    stood = sorted({*range(0, last, every), max(last - 1, 0)})
    points = episode["qpos"][stood, q : q + 2]
    distance = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    error = (episode["velocity"] - episode["command"])[round(SETTLE / dt) : last]
    weight = player.model.body_subtreemass[player.base_body] * np.linalg.norm(
        player.model.opt.gravity
    )

    def root_mean_square(columns):
        return float(np.sqrt((error[:, columns] ** 2).sum(-1).mean())) if len(error) else None

    return {
        "seconds": count * dt,
        "distance": distance,
        "tracking_error": root_mean_square([0, 1]),
        "yaw_error": root_mean_square([2]),
        "fall": float((fallen[0] + 1) * dt) if len(fallen) else None,
        "cost_of_transport": float(episode["work"][:last].sum() / (weight * distance))
        if distance > WAY
        else None,
    }


def tour(seconds: float, ranges=None) -> Callable[[float], np.ndarray]:
    """`t -> command`: ahead, a turn, sideways, fast ahead; within `ranges` [3, 2], those of training."""
    ends = np.cumsum([share for share, _ in TOUR]) * seconds
    rows = np.array([row for _, row in TOUR])
    if ranges is not None:
        rows = np.clip(rows, *np.transpose(ranges))
    return lambda t: rows[min(int(np.searchsorted(ends, t, "right")), len(rows) - 1)]
