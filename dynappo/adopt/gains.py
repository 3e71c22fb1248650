"""Gains, limits and action scale of a robot: from its file where that fits, else by rule.

The rules, for joint j of a robot of mass m whose feet hang l below the base:

    effort     of the file, if it is below 2 m g l, which no motor of the robot has; else 0.45 m g l
    kp         effort / 1 rad; for all joints higher, up to effort / 0.45 rad, where the robot sinks by more
               than 15 % of its height when it stands on three feet or more (`sag`)
    kd         kp x 0.025 s, but no more than takes 0.4 of a joint's speed in a physics step
    armature   0.0006 kg m^2 for each N m of effort, where the file has none
    scale      0.25 rad of exploration, but at most a third of the effort: effort / (3 kp)

They are what Go1, Go2, the ANYmals and Spot have in common here (kp / effort 0.9 to 1.6 /rad, kd / kp 0.02
to 0.06 s) and what others choose: mjlab's action scale is effort / (4 kp), its kd / kp 0.064 s; Unitree's and
Booster's own controllers have 0.02 to 0.03 s. A servo's gains from the file are kept if they are of that
kind:
stable, and between the effort in 0.45 rad and in 3 rad. MuJoCo Menagerie's kp of 100 for a Go1 is not: a
policy that explores by 0.25 rad would be at the motors' limit all the time.
"""

from __future__ import annotations

import copy
from typing import NamedTuple

import mujoco
import numpy as np

from dynappo.adopt.source import Published
from dynappo.physics import robot as robot_lib

TIMESTEP = 0.005  # s, of physics
STRENGTH, STRONGEST = 0.45, 2.0  # of m g l: what is assumed, and what is believed
SAG, STANDS = 0.15, 2.0  # of its height, that it may sink by in so many s
RATIO = 0.025  # s, kd / kp
DAMPS, BEST_DAMPS = (
    0.5,
    0.4,
)  # the share of a joint's speed that kd takes in a step: at most; by rule
SOFT, STIFF = 3.0, 0.45  # rad, effort / kp of a servo that is kept
STEPS = 1.0, 1.2, 1.5, 1.8, 1 / STIFF  # 1/rad, kp / effort that is tried
EXPLORES = 0.25  # rad, standard deviation of the joint targets at the start
SHARE = 1 / 3  # of the effort, that exploration may ask for
SPEED, FASTEST = 30.0, 100.0  # rad/s: where the file says nothing; faster is no motor
ROTOR = 6e-4  # kg m^2 for each N m


class Motors(NamedTuple):
    """Numbers of `A` joints, as the config's group `task` has them."""

    kp: np.ndarray  # [A] N m/rad
    kd: np.ndarray  # [A] N m s/rad
    effort_limit: np.ndarray  # [A] N m
    velocity_limit: np.ndarray  # [A] rad/s
    action_scale: np.ndarray  # [A] rad


def reach(robot: robot_lib.Robot) -> float:
    """How far the feet are below the base in the default pose (m)."""
    return float(robot.home_qpos[2])


def efforts(robot: robot_lib.Robot, published: Published) -> tuple[np.ndarray, list[str]]:
    """`(limits [A] in N m, lines)`; the lines say what was assumed."""
    each = weight(robot) * reach(robot)
    most, ruled = STRONGEST * each, round(STRENGTH * each, 1)
    out = published.effort
    if np.isnan(out).all():
        told = [f"effort: no limit in the file; {STRENGTH:g} m g l = {ruled:g} N m"]
    elif (odd := out > most).any():
        told = [
            f"effort: the file's {out[odd].max():g} N m is more than {STRONGEST:g} m g l = {most:.0f} N m, "
            f"which no motor has; {STRENGTH:g} m g l = {ruled:g} N m"
        ]
    else:
        told = [f"effort: {span(out)} N m, of the file"]
    bad = np.isnan(out) | (out > most)
    return np.where(bad, ruled, out), told


def weight(robot: robot_lib.Robot) -> float:
    """m g (N)."""
    model = robot.mj_model
    return float(model.body_mass.sum() * np.linalg.norm(model.opt.gravity))


def sag(robot: robot_lib.Robot, kp, kd, effort) -> float:
    """By what share of its height the base sinks while the PD holds the default pose for `STANDS`.

    0 for robots on one or two feet, which need more than a PD to stand.
    """
    if len(robot.foot_names) < 3:
        return 0.0
    model = copy.copy(robot.mj_model)
    model.opt.timestep = TIMESTEP
    data, home = mujoco.MjData(model), robot.home_qpos
    data.qpos[:] = home
    for _ in range(round(STANDS / TIMESTEP)):
        torque = kp * (home[7:] - data.qpos[7:]) - kd * data.qvel[6:]
        data.ctrl[:] = np.clip(torque, -effort, effort)
        mujoco.mj_step(model, data)
    return float(1 - data.qpos[2] / home[2])


def choose(
    robot: robot_lib.Robot, published: Published, init_std: float
) -> tuple[Motors, list[str]]:
    """The motors of a robot, and a line on where each number is from."""
    effort, told = efforts(robot, published)
    kp, kd, more = of_pd(robot, published, effort)
    told += more
    velocity = np.where(published.velocity > FASTEST, np.nan, published.velocity)
    unknown = np.isnan(velocity)
    told.append(
        f"speed: no limit in the file; {SPEED:g} rad/s"
        if unknown.all()
        else f"speed: {span(velocity[~unknown])} rad/s, of the file"
    )
    scale = np.minimum(EXPLORES, SHARE * effort / kp) / init_std
    told.append(
        f"action scale: {span(_two(scale))} rad; with ppo.init_std {init_std:g} exploration asks for "
        f"{(kp * scale * init_std / effort).max():.0%} of the effort at most"
    )
    return Motors(kp, kd, effort, np.where(unknown, SPEED, velocity), _two(scale)), told


def of_pd(robot, published: Published, effort) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """`(kp [A], kd [A], lines)`: the file's if they fit, else by the rules."""
    told = []
    if published.servo.all():
        kp, kd = published.kp, np.maximum(published.kd, 0.0)
        wrong = _misfit(robot, kp, kd, effort)
        if not wrong:
            return kp, kd, [f"kp, kd: {span(kp)} N m/rad and {span(kd)} N m s/rad, of the file"]
        told = [f"kp, kd: not the file's {span(kp)} and {span(_two(kd))}, for {wrong}"]
    for more in STEPS:
        kp = _two(effort * more)
        kd = kp * RATIO
        kd = _two(kd * _less(robot, kd))
        sinks = sag(robot, kp, kd, effort)
        if sinks < SAG:
            break
    why = f", with which it sinks by {sinks:.0%} of its height" * bool(sinks)
    told.append(f"kp: effort / {1 / more:.2g} rad = {span(kp)} N m/rad{why}")
    told.append(f"kd: kp x {RATIO:g} s, where stable: {span(kd)} N m s/rad")
    return kp, kd, told


def _misfit(robot, kp, kd, effort) -> str:
    """What is wrong with a servo's gains for a policy with an explicit PD; "" if nothing is."""
    if (share := robot_lib.damping_rate(robot, kd, TIMESTEP)) > DAMPS:
        return f"kd takes {share:.2g} of a joint's speed in a step of {TIMESTEP * 1e3:g} ms"
    if (angle := (effort / kp).min()) < STIFF:
        return f"{angle:.2g} rad of error are a motor's whole effort"
    if (effort / kp).max() > SOFT or sag(robot, kp, kd, effort) > SAG:
        return "they do not hold the robot up"
    return ""


def _less(robot, kd) -> np.ndarray:
    """Factors [A] up to 1 with which `kd` is stable: of each joint alone, then of all together."""
    alone = TIMESTEP * np.diag(robot_lib.joint_mobility(robot)) * kd
    factors = np.minimum(1.0, BEST_DAMPS / alone)
    return factors * min(1.0, BEST_DAMPS / robot_lib.damping_rate(robot, kd * factors, TIMESTEP))


def _two(values: np.ndarray) -> np.ndarray:
    """Values to two digits, or to whole numbers above 100."""
    return np.array([float(f"{v:.2g}") if v < 100 else float(round(v)) for v in values])


def span(values: np.ndarray) -> str:
    """`3` or `3 to 5`."""
    low, high = f"{np.nanmin(values):g}", f"{np.nanmax(values):g}"
    return low if low == high else f"{low} to {high}"
