"""The gait clock of a biped, `task.gait_frequency`: a phase of each foot, which says how high it should be.

    angle(t + 1) = angle(t) + turn,    turn = 2 pi frequency dt
    phases = angle + (0, pi)

The first foot is highest at angle 0 and down at pi, the second the other way round (`target`). The frequency
(Hz) and the first angle are drawn where a robot starts anew. A policy sees sine and cosine of the angle, or
two zeros where it is told to stand; not the frequency. Sine and cosine are what unitree_rl_lab's controllers
compute on a robot, in that order (deploy/include/isaaclab/envs/mdp/observations.h).

It follows MuJoCo Playground's G1JoystickFlatTerrain. There the phases of both feet are kept, and are pi while
the robot stands; after that both feet go on together. Here the angle goes on meanwhile, and the feet stay
opposite. The code works with NumPy and jax.numpy.
"""

from __future__ import annotations

import math

from dynappo.config import ConfigError

FEET = 2
STILL = 0.1  # size of the smallest command to move; m/s and rad/s


def check(frequency, robot: str, feet: int) -> None:
    """ConfigError for a clock on a robot that does not have two feet."""
    if frequency is not None and feet != FEET:
        raise ConfigError(
            f"task.gait_frequency is {tuple(frequency)}, expected None: {robot} has {feet} feet, the gait "
            "clock is for robots of two"
        )


def moves(command):
    """Whether commands [..., 3] are to move: more than 0.1 in size."""
    return (command**2).sum(-1) > STILL**2


def turn(frequency, dt):
    """rad that the angle advances in a control step of `dt` s, of a frequency in Hz."""
    return 2 * math.pi * frequency * dt


def start(frequency, dt, draws):
    """`(angle, turn)` of a robot that starts anew, of the range `frequency` and `draws` [2] from 0 to 1."""
    low, high = frequency
    return 2 * math.pi * draws[0] - math.pi, turn(low + (high - low) * draws[1], dt)


def advance(angle, turn):
    """The angle one control step later, from -pi to pi."""
    return (angle + turn + math.pi) % (2 * math.pi) - math.pi


def shown(angle, command):
    """[2] sine and cosine of the angle under `command` [3]; zeros where it is to stand."""
    xp = command.__array_namespace__()
    angle = xp.asarray(angle)
    return xp.stack([xp.sin(angle), xp.cos(angle)]) * moves(command)


def shown_later(phase, turn):
    """`shown` [..., 2] a control step after it was `phase`, under the same command; `turn` [..., 1]."""
    xp = phase.__array_namespace__()
    (sin, cos), (s, c) = (phase[..., :1], phase[..., 1:]), (xp.sin(turn), xp.cos(turn))
    return xp.concat([sin * c + cos * s, cos * c - sin * s], axis=-1)


def target(phase, height):
    """[2] m: how high each foot should be above the lower one, for what is `shown` [2].

    h(phi) - min over feet of h, with h(phi) = `height` b(1 - |phi| / pi), b(x) = 3 x^2 - 2 x^3, phi from -pi
    to pi: the cubic Bezier curves of MuJoCo Playground's gait.get_rz, up before phase 0 and down after it.
    There they are heights above the ground, so between two steps both feet should be in the air, half as
    high. Zeros, to stand: both feet down.
    """
    xp = phase.__array_namespace__()
    signs = xp.asarray([1.0, -1.0])  # the second foot is half a turn ahead
    x = 1 - abs(xp.atan2(phase[0] * signs, phase[1] * signs)) / math.pi
    curve = height * x**2 * (3 - 2 * x)
    return (curve - curve.min()) * ((phase**2).sum() > 0)
