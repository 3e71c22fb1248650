"""Robustness tests: latency, friction, payload, weak motors, pushes, noise, other physics.

Eight commands of ten seconds for each disturbance, in C MuJoCo and NumPy, with every contact and a solver
that converges. Commands and random numbers are the same for each, so rows of the table differ by the
disturbance alone.

- a delay is of the actions, of the observations, or of both, where the two add up (physics/randomize.py).
  `jitter` adds to each action a delay of its own, uniform from 0; none overtakes another
- friction is that of every contact with the ground; mass is added to the base, its inertia scaled with it
- `motors` is the share of the torque that arrives
- a push adds a horizontal velocity of the given size to the base's, in a random direction, every 2 s
- noise is that of training (Isaac Lab's, `configs/default.py`)
- `velocity` is the share of the true linear velocity that the policy reads. A policy that does not see it has
  no such row
"""

from __future__ import annotations

import copy
import itertools
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from dynappo.evaluate.spread import spread
from dynappo.physics import actuators
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.policy.episode import Player
from dynappo.policy.policy_file import Policy
from dynappo.policy.walks import SETTLE
from dynappo.tasks.velocity import observe

SECONDS = 10.0  # of an episode
PUSH_EVERY = 2.0  # s
COMMANDS = (  # shares of the ranges that were trained: ahead, sideways, turning
    (0.0, 0.0, 0.0),
    (0.5, 0.0, 0.0),
    (1.0, 0.0, 0.0),
    (-0.8, 0.0, 0.0),
    (0.0, 0.6, 0.0),
    (0.0, -0.6, 0.0),
    (0.5, 0.0, 0.8),
    (0.0, 0.0, -1.0),
)
# half widths on the parts of an observation; IL, as the group `task.noise` has them
NOISE = dict(
    joint_position=0.01,
    joint_velocity=1.5,
    gravity=0.05,
    linear_velocity=0.1,
    angular_velocity=0.2,
)


class Stress(NamedTuple):
    """A disturbance; with its defaults it changes nothing."""

    name: str
    action_delay: float = 0.0  # s
    jitter: float = 0.0  # s
    sensor_delay: float = 0.0  # s
    friction: float | None = None
    mass: float = 0.0  # kg
    motors: float = 1.0
    push: float = 0.0  # m/s
    noise: float = 0.0  # times that of training
    velocity: float = 1.0
    scan_shift: tuple[float, float, float] = (0.0, 0.0, 0.0)  # m, ahead, left, up


TABLE = (
    Stress("none"),
    Stress("actions 20 ms late", action_delay=0.02),
    Stress("actions 40 ms late", action_delay=0.04),
    Stress("actions 0 to 40 ms late", jitter=0.04),
    Stress("sensors 20 ms late", sensor_delay=0.02),
    Stress("both 20 ms late", action_delay=0.02, sensor_delay=0.02),
    Stress("friction 0.15", friction=0.15),
    Stress("friction 0.3", friction=0.3),
    Stress("friction 1.2", friction=1.2),
    Stress("5 kg more", mass=5.0),
    Stress("5 kg less", mass=-5.0),
    Stress("motors at 80 %", motors=0.8),
    Stress("motors at 120 %", motors=1.2),
    Stress("pushes of 0.5 m/s", push=0.5),
    Stress("pushes of 1 m/s", push=1.0),
    Stress("noise of training", noise=1.0),
    Stress("velocity read as zero", velocity=0.0),
    Stress("velocity read as half", velocity=0.5),
    Stress(
        "all together",
        action_delay=0.02,
        friction=0.6,
        mass=3.0,
        motors=0.9,
        push=0.5,
        noise=1.0,
    ),
)


def table(policy: Policy) -> list[Stress]:
    """The disturbances that can disturb `policy`."""
    sees = "linear_velocity" in observe.shown(policy.observation, policy.own)
    return [stress for stress in TABLE if sees or stress.velocity == 1.0]


def other_physics(player: Player) -> list[tuple[str, Player]]:
    """The same robot in other physics: steps, cones and solvers that the policy did not train with."""
    cone, solver = mujoco.mjtCone, mujoco.mjtSolver
    period = episode_lib.period(player)
    out = []
    for name, substeps, options in (
        ("steps of 2 ms", round(period / 0.002), {}),
        ("steps of 10 ms", round(period / 0.01), {}),
        ("elliptic cone", player.substeps, {"cone": int(cone.mjCONE_ELLIPTIC)}),
        ("pyramidal cone", player.substeps, {"cone": int(cone.mjCONE_PYRAMIDAL)}),
        ("solver CG", player.substeps, {"solver": int(solver.mjSOL_CG)}),
        ("solver PGS", player.substeps, {"solver": int(solver.mjSOL_PGS)}),
    ):
        model = copy.copy(player.model)
        for option, value in options.items():
            setattr(model.opt, option, value)
        model.opt.timestep = period / substeps
        out.append((name, player._replace(model=model, substeps=substeps)))
    return out


def run(
    policy: Policy, player: Player, tell: Callable[[int, int], None] = lambda done, total: None
):
    """The rows of all disturbances, and of the other physics; `tell(done, total)` at first and after each."""
    cases = [(stress, player) for stress in table(policy)]
    cases += [(Stress(name), other) for name, other in other_physics(player)]
    return spread(lambda case: measure(case[1], case[0]), cases, tell)


def commands(policy: Policy) -> np.ndarray:
    """The eight commands [8, 3], in the ranges of training; m/s, m/s, rad/s."""
    ranges = np.array([policy.command_x, policy.command_y, policy.command_yaw])
    low, high = ranges.T
    share = np.array(COMMANDS)
    return np.where(share >= 0, share * high, -share * low)


def disturbed(player: Player, stress: Stress) -> Player:
    """The player with its own load and floor."""
    model, base = copy.copy(player.model), player.base_body
    added = (model.body_mass[base] + stress.mass) / model.body_mass[base]
    if added <= 0.05:  # kg less than there is
        added = 0.05
    model.body_mass[base] *= added
    model.body_inertia[base] *= added
    if stress.friction is not None:
        model.geom_friction[:, 0] = stress.friction
        model.pair_friction[:, :2] = stress.friction
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return player._replace(model=model)


def play(player: Player, act: Callable, command, stress: Stress, seed: int = 0, seconds=SECONDS):
    """One episode: `(velocity [T, 3], fall)`; `fall` is the time (s) of a fall, or None.

    As `trials.record`, with the disturbance. A blow-up of the physics is a fall.
    """
    rows = disturbed_rows(player, act, lambda t: command, mujoco.MjData(player.model), stress, seed)
    velocity, fall, dt = [], None, episode_lib.period(player)
    try:
        for row in itertools.islice(rows, round(seconds / dt)):
            if row["fell"]:
                fall = (len(velocity) + 1) * dt
                break
            velocity.append(row["velocity"])
    except FloatingPointError:
        fall = (len(velocity) + 1) * dt
    return np.reshape(velocity, (-1, 3)), fall


def disturbed_rows(
    player: Player, act: Callable, command: Callable, data, stress: Stress, seed: int = 0
):
    """The rows of an episode (`episode.rows`) of the robot in `data`, with the disturbance; `command(t)`."""
    p, model = player.policy, player.model
    # not the stream of the pose at the start (`episode.reset`), which is that of seed 0
    rng = np.random.default_rng((seed, 1))
    dt, step = episode_lib.period(player), model.opt.timestep
    parts = observe.slices(len(p.joint_names), observe.has_clock(p.observation, p.own), p.own)
    trained = p.config.get("task", {}).get("noise", {})
    half = NOISE | {each.name: trained.get(each.quantity.noise, 0.0) for each in p.own}
    scale = stress.noise * np.concatenate(
        [np.full(part.stop - part.start, half.get(name, 0.0)) for name, part in parts.items()]
    )
    late = round(stress.sensor_delay / step)  # physics steps
    states = deque(maxlen=late + 1)  # on their way to the policy, the oldest first
    waiting = deque([(0, p.default_pose)])  # (arrival, target), on their way to the motors

    def observed(k, command, last_action, kept):
        """Push the robot if it is time, and observe it."""
        if not k:
            states.extend([_snapshot(data)] * (late + 1))
        elif stress.push and k % round(PUSH_EVERY / dt) == 0:
            angle = rng.uniform(-np.pi, np.pi)
            data.qvel[player.root[1] : player.root[1] + 2] += stress.push * np.array(
                [np.cos(angle), np.sin(angle)]
            )
            states[-1] = _snapshot(data)
        now = command, last_action, k * dt, kept  # no clock is late
        obs = episode_lib.look(player, states[0], *now)
        obs[parts["linear_velocity"]] *= stress.velocity
        return obs + rng.uniform(-1, 1, len(obs)) * scale

    def targets(k, action):
        """What the motors follow in each physics step: the last target that has arrived."""
        delay = stress.action_delay
        if stress.jitter:
            delay += rng.uniform(0, stress.jitter)
        first = k * player.substeps
        arrival = max(waiting[-1][0], first + round(delay / step))  # none overtakes another
        waiting.append((arrival, actuators.target(action, p.default_pose, p.action_scale)))
        for now in range(first, first + player.substeps):
            while len(waiting) > 1 and waiting[1][0] <= now:
                waiting.popleft()
            yield waiting[0][1]

    return episode_lib.rows(
        player,
        data,
        act,
        command,
        observed,
        targets,
        stress.motors,
        lambda torque, speed: states.append(_snapshot(data)),
        stress.scan_shift,
    )


def _snapshot(data) -> SimpleNamespace:
    """A copy of the numbers that an observation is made of."""
    contact = SimpleNamespace(geom=data.contact.geom.copy(), dist=data.contact.dist.copy())
    return SimpleNamespace(qpos=data.qpos.copy(), qvel=data.qvel.copy(), contact=contact)


def measure(player: Player, stress: Stress, seconds: float = SECONDS) -> dict[str, Any]:
    """A row of the table: falls of the eight commands, tracking and yaw error of what stood.

    Root mean squares after the first second and before a fall; None if no robot stood that long.
    """
    policy, changed = player.policy, disturbed(player, stress)
    act = policy_file.actor(policy.params, policy.activation)
    first = round(SETTLE / episode_lib.period(player))
    errors, falls = [], 0
    for i, command in enumerate(commands(policy)):
        velocity, fall = play(changed, act, command, stress, i, seconds)
        falls += fall is not None
        errors.append((velocity - command)[first:])
    error = np.concatenate(errors)
    row: dict[str, Any] = {"stress": stress.name, "falls": falls, "episodes": len(errors)}
    if len(error):
        row["tracking_error"] = float(np.sqrt((error[:, :2] ** 2).sum(-1).mean()))
        row["yaw_error"] = float(np.sqrt((error[:, 2] ** 2).mean()))
    return {"tracking_error": None, "yaw_error": None} | row
