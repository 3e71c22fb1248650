"""The state of one robot of the velocity task."""

from __future__ import annotations

from typing import Any

from flax import struct
from jaxtyping import Array, Float, Int


class Goal(struct.PyTreeNode):
    """The rest of a robot's command, kept until the next draw (commands.py)."""

    heading: Float[Array, "..."]  # rad in the world; used with `task.heading` only
    standing: Float[Array, "..."]  # 1: asked to stand
    steps_left: Int[Array, "..."]  # control steps until the next draw


class Gait(struct.PyTreeNode):
    """A robot's gait clock (gait.py)."""

    angle: Float[Array, "..."]  # rad, the phase of the first foot while it is told to move
    turn: Float[Array, "..."]  # rad, its advance in a control step


class State(struct.PyTreeNode):
    """The integration state of physics and all memory of the task.

    `env.step` reads nothing else. So a reset costs no physics call, and a checkpoint holds the same
    fields with every engine (`physics.impl`). Timers count physics substeps. Of A joints, F feet.
    """

    qpos: Float[Array, "... nq"]
    qvel: Float[Array, "... nv"]
    qacc_warmstart: Float[Array, "... nv"]
    obs: Float[Array, "... O"]
    prop: Float[Array, "... P"]  # the observation's predicted part, before its noise
    command: Float[Array, "... 3"]  # m/s, m/s, rad/s in the base frame
    goal: Goal
    gait: Any  # Gait; None without task.gait_frequency
    last_action: Float[Array, "... A"]
    older_action: Float[Array, "... A"]  # the one before
    torque: Any  # [..., A] N m, as the motors give it; None unless it lags
    air_steps: Int[Array, "... F"]  # since the foot left the ground; 0 while it is down
    contact_steps: Int[Array, "... F"]  # since the foot came down; 0 while it is in the air
    last_air_steps: Int[Array, "... F"]  # length of the last finished air phase
    peak: Float[Array, "... F"]  # m, highest that a foot's lowest point was in this air phase
    last_peak: Float[Array, "... F"]  # in the last finished one
    clock: Int[Array, "..."]  # age of the episode in control steps; the first may start above 0
    episode_steps: Int[Array, "..."]  # control steps since the reset
    push_in: Int[Array, "..."]  # control steps until the next push
    episode_return: Float[Array, "..."]
    tile: Any = None  # curriculum.Tile; None on flat ground
    scan_shift: Any = None  # [..., 3] m, by how much the robot's map is off; None without a scan
    clearance: Any = None  # share of foot_clearance's weight that it pays; None without the ramp
    own: Any = None  # known quantities of terms of one's own (own.py), by name; None without
