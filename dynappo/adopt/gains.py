"""Gains, limits and action scale of a robot: from its file where that fits, else by rule.

The rules, for joint j of a robot of mass m whose feet hang l below the base:

    effort     the file's, if it is below 2 m g l (no real motor reaches that); else of m g l 0.45 at hips
               and knees, 0.3 at the waist, 0.15 at ankles, elsewhere 0.08
    kp         effort / 1 rad; higher for all joints, up to effort / 0.45 rad, if a robot on three feet or
               more sinks by more than 15 % of its height (`sag`)
    kd         kp x 0.025 s, but it takes at most 0.4 of a joint's speed in a physics step
    armature   0.0006 kg m^2 for each N m of effort, where the file has none
    scale      0.25 rad of exploration, but at most a third of the effort: effort / (3 kp)

Limits of 14 published files, in m g l: waists 0.15 to 0.5, ankles 0.06 to 0.25, arms and heads 0.01 to 0.14.
Of ten quadrupeds hips have 0.2 to 1, in the median 0.42, and knees 0.24 to 1.1, in the median 0.5. A knee
has as much as a hip or up to twice, Isaac Lab's Spot 2.5 times (0.2 and 0.5): one number fits as well as two.

The configs of Go1, Go2, the ANYmals and Spot lie near these rules (kp / effort 0.9 to 1.6 /rad, kd / kp 0.02
to 0.06 s), and so do others: mjlab's action scale is effort / (4 kp), its kd / kp 0.064 s; Unitree's and
Booster's own controllers have 0.02 to 0.03 s. A kind of joint keeps its servo's kp from the file if that
lies between effort / 3 rad and effort / 0.45 rad, and as much of the servo's kd as is stable. MuJoCo
Menagerie's kp of 100 for a Go1 lies outside: a policy that explores by 0.25 rad would always be at the
motors' limit.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.adopt import joint_roles
from dynappo.adopt.source import Published
from dynappo.description import kinds as kinds_lib
from dynappo.description import robot as robot_lib

TIMESTEP = 0.005  # s, of physics
STRENGTH = {"hip": 0.45, "knee": 0.45, "waist": 0.3, "ankle": 0.15}  # of m g l: what is assumed
OTHER_STRENGTH = 0.08  # of m g l: what is assumed elsewhere
STRONGEST = 2.0  # of m g l: what is believed of a file
MOST_SAG = 0.15  # of its height, by which a robot may sink in `STANCE_SECONDS`
STANCE_SECONDS = 5.0  # s, as in `look`
KD_PER_KP = 0.025  # s, kd / kp
# shares of a joint's speed that kd takes in a step: of a file's kd at most, of one by rule
MOST_DAMPED, DAMPED_BY_RULE = 0.5, 0.4
SOFTEST_SERVO, STIFFEST_SERVO = 3.0, 0.45  # rad, effort / kp of a servo that is kept
KP_PER_EFFORT = 1.0, 1.2, 1.5, 1.8, 1 / STIFFEST_SERVO  # 1/rad, kp / effort that is tried
EXPLORED_ANGLE = 0.25  # rad, standard deviation of the joint targets at the start
EXPLORED_SHARE = 1 / 3  # of the effort, that exploration may ask for
USUAL_SPEED = 30.0  # rad/s, where the file says nothing
FASTEST_SPEED = 100.0  # rad/s; faster is no motor
ROTOR_INERTIA = 6e-4  # kg m^2 for each N m of effort


class Motors(NamedTuple):
    """Numbers of the motors of `A` joints, as in the config's group `task`."""

    kp: np.ndarray  # [A] N m/rad
    kd: np.ndarray  # [A] N m s/rad
    effort_limit: np.ndarray  # [A] N m
    velocity_limit: np.ndarray  # [A] rad/s
    action_scale: np.ndarray  # [A] rad


def reach(robot: robot_lib.Robot) -> float:
    """How far below the base the feet are in the default pose (m)."""
    return float(robot.home_qpos[2])


def efforts(robot: robot_lib.Robot, published: Published) -> tuple[np.ndarray, list[str]]:
    """`(limits [A] in N m, lines)`; the lines say what was assumed."""
    each, names, out = weight(robot) * reach(robot), robot.joint_names, published.effort
    most, roles = STRONGEST * each, joint_roles.roles(robot)[0]
    shares = np.array([STRENGTH.get(role, OTHER_STRENGTH) for role in roles])
    ruled = np.round(shares * each, 1 if each > 10 else 2)
    none, odd = np.isnan(out), out > most
    notes, good = [], ~(none | odd)
    if odd.any():
        notes.append(
            f"effort: the file's {out[odd].max():g} N m{at_joints(names, odd)} is more than "
            f"{STRONGEST:g} m g l = {most:.0f} N m, which no motor has; "
            + _rule_in_words(shares, ruled, roles, odd)
        )
    if none.any():
        rule = _rule_in_words(shares, ruled, roles, none)
        notes.append(f"effort: no limit in the file{at_joints(names, none)}; {rule}")
    if good.any():
        notes.append(f"effort: {span(out[good])} N m{at_joints(names, good)}, of the file")
    return np.where(good, out, ruled), notes


def _rule_in_words(shares, ruled, roles, asked) -> str:
    """`0.45 m g l = 36 N m`, with the roles where there are several, for the joints `asked` [A]."""
    said: dict[str, list[str]] = {}
    for share, most, role in zip(shares[asked], ruled[asked], roles[asked], strict=True):
        name = f"{role}s" if role in STRENGTH else "others"
        names = said.setdefault(f"{share:g} m g l = {most:g} N m", [])
        names += [name] * (name not in names)
    if len(said) == 1:
        return next(iter(said))
    return ", ".join(f"{' and '.join(names)} {limit}" for limit, names in said.items())


def at_joints(names: tuple[str, ...], where: np.ndarray) -> str:
    """` at A, B` for the joints `where` [A], by their kinds if these are whole; "" if it is all of them."""
    if where.all():
        return ""
    kinds = kinds_lib.kinds(names)
    whole = {k: ids for k, ids in kinds.items() if where[ids].all()}
    covered = {i for ids in whole.values() for i in ids}
    said = [*whole, *(names[i] for i in np.flatnonzero(where) if i not in covered)]
    return " at " + ", ".join(said[:6]) + f" and {len(said) - 6} more" * (len(said) > 6)


def weight(robot: robot_lib.Robot) -> float:
    """m g (N)."""
    model = robot.mj_model
    return float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))


def sag(robot: robot_lib.Robot, kp, kd, effort) -> float:
    """By what share of its height the base sinks while the PD holds the default pose for `STANCE_SECONDS`.

    0 for robots on one or two feet, which need more than a PD to stand.
    """
    if len(robot.foot_names) < 3:
        return 0.0
    return float(1 - stance(robot, kp, kd, effort)[-1, 2] / robot.home_qpos[2])


def stance(robot: robot_lib.Robot, kp, kd, effort) -> np.ndarray:
    """`qpos` [T, nq] of `STANCE_SECONDS` in which the PD holds the default pose, at every tenth step.

    On its feet alone: no other part touches the ground, even if it is below.
    """
    model = copy.copy(robot.mj_model)
    model.opt.timestep = TIMESTEP
    model.geom_contype[robot.parts] = model.geom_conaffinity[robot.parts] = 0
    data, home, poses = mujoco.MjData(model), robot.home_qpos, []
    data.qpos[:] = home
    for step in range(round(STANCE_SECONDS / TIMESTEP)):
        torque = kp * (home[7:] - data.qpos[7:]) - kd * data.qvel[6:]
        data.ctrl[:] = np.clip(torque, -effort, effort)
        mujoco.mj_step(model, data)
        if step % 10 == 9:
            poses.append(data.qpos.copy())
    return np.array(poses)


def choose(
    robot: robot_lib.Robot, published: Published, init_std: float
) -> tuple[Motors, list[str]]:
    """The motors of a robot, and a line on where each number is from."""
    effort, notes = efforts(robot, published)
    kp, kd, more = pd_gains(robot, published, effort)
    notes += more
    names, velocity = robot.joint_names, published.velocity
    fast, none = velocity > FASTEST_SPEED, np.isnan(velocity)
    known = ~(fast | none)
    if none.any():
        notes.append(f"speed: no limit in the file{at_joints(names, none)}; {USUAL_SPEED:g} rad/s")
    if fast.any():
        notes.append(
            f"speed: the file's {velocity[fast].max():g} rad/s{at_joints(names, fast)} has no motor; "
            f"{USUAL_SPEED:g} rad/s"
        )
    if known.any():
        notes.append(f"speed: {span(velocity[known])} rad/s{at_joints(names, known)}, of the file")
    scale = np.minimum(EXPLORED_ANGLE, EXPLORED_SHARE * effort / kp) / init_std
    notes.append(
        f"action scale: {span(two_digits(scale))} rad; with ppo.init_std {init_std:g} exploration asks for "
        f"{(kp * scale * init_std / effort).max():.0%} of the effort at most"
    )
    return Motors(kp, kd, effort, np.where(known, velocity, USUAL_SPEED), two_digits(scale)), notes


def pd_gains(robot, published: Published, effort) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """`(kp [A], kd [A], lines)`: the file's at the kinds of joints where they fit, else by the rules."""
    names, kept, notes = robot.joint_names, np.zeros(len(effort), bool), []
    for joints in kinds_lib.kinds(names).values():
        servo, angle = published.servo[joints], effort[joints] / published.kp[joints]
        kept[joints] = (
            servo.all() and (angle >= STIFFEST_SERVO).all() and (angle <= SOFTEST_SERVO).all()
        )
    servo = published.servo
    if (not_kept := servo & ~kept).any():
        angle = effort[not_kept] / published.kp[not_kept]
        notes.append(
            f"kp: not the file's {span(published.kp[not_kept])}{at_joints(names, not_kept)}, where "
            f"{span(two_digits(angle))} rad of error are a motor's whole effort; a kind of joint "
            f"keeps its servos if all have {STIFFEST_SERVO:g} to {SOFTEST_SERVO:g}"
        )
    if kept.any():
        kp, kd, gains, damping = _kept_or_ruled(robot, published, effort, kept, 1.0)
        if kept.all() and (sinks := sag(robot, kp, kd, effort)) > MOST_SAG:
            notes.append(
                f"kp: not the file's {span(kp)} N m/rad, which do not hold the robot up: it "
                f"{_sinking_in_words(sinks)}"
            )
            kept = np.zeros_like(kept)
        elif kept.all():
            return kp, kd, [*notes, *gains, *damping]
    for step in KP_PER_EFFORT:
        kp, kd, gains, damping = _kept_or_ruled(robot, published, effort, kept, step)
        sinks = sag(robot, kp, kd, effort)
        if sinks < MOST_SAG:
            gains[-1] += f", with which it {_sinking_in_words(sinks)}" * bool(sinks)
            break
    else:
        gains.append(
            f"EDIT NEEDED: kp {span(kp)} N m/rad is the stiffest that is tried, and the robot does not "
            f"stand: it {_sinking_in_words(sinks)}; look at the pose and the limits"
        )
    return kp, kd, [*notes, *gains, *damping]


def _kept_or_ruled(
    robot, published: Published, effort, kept, step: float
) -> tuple[np.ndarray, np.ndarray, list[str], list[str]]:
    """`(kp, kd, lines, lines)`: the file's at the joints `kept`, else kp = effort x `step`; kd as far as it
    is stable."""
    names, gains, damping, ruled = robot.joint_names, [], [], ~kept
    kp = np.where(kept, published.kp, two_digits(effort * step))
    wanted = np.where(kept, np.maximum(published.kd, 0), kp * KD_PER_KP)
    share = robot_lib.damping_rate(robot, wanted, TIMESTEP)
    theirs = kept.all() and share <= MOST_DAMPED
    kd = wanted if theirs else two_digits(wanted * _stable_factors(robot, wanted))
    lower = kept & (kd < 0.99 * wanted)
    same = kept & ~lower
    if kept.any():
        gains.append(f"kp: {span(kp[kept])} N m/rad{at_joints(names, kept)}, of the file")
    if ruled.any():
        gains.append(
            f"kp: effort / {1 / step:.2g} rad = {span(kp[ruled])} N m/rad{at_joints(names, ruled)}"
        )
    if same.any():
        damping.append(f"kd: {span(kd[same])} N m s/rad{at_joints(names, same)}, of the file")
    if lower.any():
        damping.append(
            f"kd: {span(kd[lower])} N m s/rad{at_joints(names, lower)}, not the file's "
            f"{span(two_digits(wanted[lower]))}, with which kd takes {share:.2g} of a joint's speed in a "
            f"step of {TIMESTEP * 1e3:g} ms"
        )
    if ruled.any():
        damping.append(
            f"kd: kp x {KD_PER_KP:g} s, where stable: {span(kd[ruled])} N m s/rad{at_joints(names, ruled)}"
        )
    return kp, kd, gains, damping


def _sinking_in_words(sinks: float) -> str:
    """By what share of its height a robot sinks, or rises if springs push it up."""
    return f"{'sinks' if sinks > 0 else 'rises'} by {abs(sinks):.0%} of its height"


def _stable_factors(robot, kd) -> np.ndarray:
    """Factors [A] up to 1 with which `kd` is stable: of each joint alone, then of all together.

    A kind of joint has one: links of published robots differ a little left and right, motors must not.
    """
    alone = TIMESTEP * np.diag(robot_lib.joint_mobility(robot)) * kd
    factors = np.minimum(1.0, DAMPED_BY_RULE / np.maximum(alone, 1e-12))
    for joints in kinds_lib.kinds(robot.joint_names).values():
        factors[joints] = factors[joints].min()
    together = robot_lib.damping_rate(robot, kd * factors, TIMESTEP)
    return factors * min(1.0, DAMPED_BY_RULE / max(together, 1e-12))


def two_digits(values: np.ndarray) -> np.ndarray:
    """Values to two digits, or to whole numbers above 100."""
    return np.array([float(f"{v:.2g}") if v < 100 else float(round(v)) for v in values])


def span(values: np.ndarray) -> str:
    """`3` or `3 to 5`."""
    low, high = f"{np.nanmin(values):g}", f"{np.nanmax(values):g}"
    return low if low == high else f"{low} to {high}"
