"""The gait clock of a biped, `task.gait_frequency`: a phase of each foot, which says how high it should be.

    angle(t + 1) = angle(t) + turn,    turn = 2 pi frequency dt
    phases = angle + (0, pi);          both pi where the robot is told to stand

A foot is highest at phase 0 and down at pi (`target`). The frequency (Hz) and the first angle are drawn where
a robot starts anew. A policy sees cosine and sine of each phase, and not the frequency.

It follows MuJoCo Playground's G1JoystickFlatTerrain. There the phases themselves are kept, so after the robot
has stood both feet go on together. Here the angle goes on meanwhile, and the feet stay opposite. The code
works with NumPy and jax.numpy.
"""

from __future__ import annotations

import math

from dynappo.config import ConfigError

OFFSETS = (0.0, math.pi)  # rad, of the robot's first and second foot
STILL = 0.1  # size of the smallest command to move; m/s and rad/s


def check(frequency, robot: str, feet: int) -> None:
    """ConfigError for a clock on a robot that does not have two feet."""
    if frequency is not None and feet != len(OFFSETS):
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
    """[4] the cosine of each foot's phase, then the sines, under `command` [3]."""
    xp = command.__array_namespace__()
    phases = xp.where(moves(command), angle + xp.asarray(OFFSETS), math.pi)
    return xp.concat([xp.cos(phases), xp.sin(phases)])


def shown_later(phase, turn, command):
    """`shown` [..., 4] a control step after it was `phase`, under the same command; `turn` [..., 1]."""
    xp = phase.__array_namespace__()
    cos, sin = phase[..., :2], phase[..., 2:]
    c, s = xp.cos(turn), xp.sin(turn)
    turned = xp.concat([cos * c - sin * s, sin * c + cos * s], axis=-1)
    return xp.where(moves(command)[..., None], turned, phase)


def target(phase, height):
    """[2] m: how high each foot should be, `height` in the middle of its swing, for `shown` phases [4].

    h(phi) = `height` b(1 - |phi| / pi) with b(x) = 3 x^2 - 2 x^3, phi from -pi to pi: the cubic Bezier curves
    of MuJoCo Playground's gait.get_rz, up before phase 0 and down after it.
    """
    xp = phase.__array_namespace__()
    x = 1 - abs(xp.atan2(phase[2:], phase[:2])) / math.pi
    return height * x**2 * (3 - 2 * x)
