"""The reward terms of the velocity task: one public function each, with its weight in
`task.weights`.

Terms are those of the paper's appendix and of Isaac Lab's flat velocity tasks (isaaclab_tasks
.../velocity/mdp/rewards.py and isaaclab/envs/mdp/rewards.py, 2.2.1). Every term is one number per
robot and at least 0, except `feet_air_time`. The weight has the sign; reward_sum.py multiplies by the
weight and the control step, and sums. The code works with NumPy and jax.numpy.

A term's parameter names say what it needs. It may ask for:

- any quantity of the observation (observe.py), without noise: the predicted ones as they are at the end
  of the control step, before a push; the known ones, `command` and `previous_action`, as the policy saw
  them
- the fields of `Feet`, which follow from these
- `action`, the raw action of this step, any number of the config's group `task`, like
  `tracking_std`, and `dt`, the seconds of a control step
- the fields of `Measured`, which only physics knows

In synthetic rows, terms that need nothing of `Measured` can be computed (`model.known_reward`); the model
learns the sum of the others. A parameter with a default is the term's own constant.

On quadrupeds only `track_*` earns a positive return: an episode of T seconds that tracks perfectly earns
(w_lin + w_yaw) T, 45 on Go1. An untrained robot gets more penalty than reward, and a fall ends the
penalties, so early in training episodes get shorter before they get longer. A biped also earns
`upright`, `posture` and `feet_phase`, and `task.fall_reward` makes a fall itself cost something.

A biped's term whose weight is None is in no program. Their sources: Isaac Lab's flat G1 (2.2.1), mjlab 1.6
and MuJoCo Playground 0.2 (G1JoystickFlatTerrain).
"""

from typing import Any, NamedTuple

from dynappo.tasks.velocity import gait


class Feet(NamedTuple):
    """Where the feet are and go, from joints and velocities alone (kinematics.py); of F feet. On rough ground
    their heights are those of surroundings.py, which a tail knows too.

    The place of a foot is the middle of its shapes. Velocities take the base's centre of mass as the
    robot's file has it.
    """

    foot_position: Any  # [F, 3] m, from the base's origin, base frame
    foot_velocity: Any  # [F, 3] m/s, against the ground, base frame
    foot_side: Any  # [F] in the default pose: 1 left of the middle, -1 right, 0 on it
    # [F] m, up: on flat ground above the lowest foot, so that is 0; on rough ground above that under it
    foot_height: Any


class Measured(NamedTuple):
    """What a term may ask for beyond the observation; of A joints, F feet, K parts."""

    torque: Any  # [A] N m, of the motors in the last physics step, after all limits
    joint_velocity_before: Any  # [A] rad/s, before that step
    timestep: float  # s, of a physics step
    height: Any  # m, of the base's frame above the ground
    contact: Any  # [F] bool: the foot is on the ground
    touchdown: Any  # [F] bool: it came down in this control step
    last_air_time: Any  # [F] s, length of its last finished air phase
    swing_height: Any  # [F] m, highest that its lowest point was in that phase
    older_action: Any  # [A] the action before `previous_action`
    clearance_share: Any  # of foot_clearance's weight that the robot pays
    over_limit: Any  # [A] rad, beyond the middle `task.reset.soft_limit` of a joint's range
    lowest: Any  # [K] m, lowest point above the ground of what counts as an undesired contact
    # for terms of one's own
    qpos: Any  # [7 + A] base and joints, as in observe.py
    qvel: Any  # [6 + A]
    episode_steps: Any  # control steps from the reset to the start of this one


def track_linear_velocity(linear_velocity, command, tracking_std):
    """exp(-|v_xy - c_xy|^2 / tracking_std^2), base frame, m/s. Isaac Lab: std 0.5; as printed: std 1."""
    return _exp(-((linear_velocity[:2] - command[:2]) ** 2).sum() / tracking_std**2)


def track_yaw_rate(angular_velocity, command, tracking_std):
    """exp(-(w_z - c_yaw)^2 / tracking_std^2), base frame, rad/s."""
    return _exp(-((angular_velocity[2] - command[2]) ** 2) / tracking_std**2)


def vertical_velocity(linear_velocity):
    """v_z^2 in the base frame, (m/s)^2."""
    return linear_velocity[2] ** 2


def roll_pitch_rate(angular_velocity):
    """w_x^2 + w_y^2 in the base frame, (rad/s)^2."""
    return (angular_velocity[:2] ** 2).sum()


def flat_orientation(gravity):
    """g_x^2 + g_y^2 of the unit gravity direction in the base frame: sin^2 of the tilt."""
    return (gravity[:2] ** 2).sum()


def joint_torques(torque):
    """Sum of the motors' squared torques, (N m)^2, in the last physics step, after all limits."""
    return (torque**2).sum()


def joint_accelerations(joint_velocity, joint_velocity_before, timestep):
    """Sum of squared joint accelerations, (rad/s^2)^2, over the last physics step (s)."""
    return (((joint_velocity - joint_velocity_before) / timestep) ** 2).sum()


def action_rate(action, previous_action):
    """Sum of squared changes of the raw action."""
    return ((action - previous_action) ** 2).sum()


def action_acceleration(action, previous_action, older_action):
    """Sum of squared second differences of the raw action."""
    return ((action - 2 * previous_action + older_action) ** 2).sum()


def energy(torque, joint_velocity):
    """Sum of |motor's torque x joint velocity|, W, in the last physics step (Playground's Go1 has it)."""
    return abs(torque * joint_velocity).sum()


def joint_limits(over_limit):
    """Sum of the angles, rad, by which joints are beyond their soft limits."""
    return over_limit.sum()


def stand_still(joint_position, command):
    """Sum of |joint position - default|, rad, where the command is to stand (below 0.1 in size)."""
    return abs(joint_position).sum() * ((command**2).sum() < 0.1**2)


def foot_clearance(swing_height, touchdown, command, clearance_height, clearance_share):
    """Sum over feet that touch down of (1 - swing height / clearance_height)^2, where it was lower; times the
    robot's share (`task.clearance_ramp`).

    `task.clearance_height` is in m. Playground's Go1 has the same with 0.1 m, and for higher feet too. 0 for
    a slow command.
    """
    moving = _moving(command)
    short = 1 - swing_height / clearance_height
    return clearance_share * (short**2 * (short > 0) * touchdown).sum() * moving


def feet_air_time(last_air_time, touchdown, command, threshold=0.5):
    """Sum over feet of (last air time - threshold), s, at touch-down; 0 for a slow command.

    Negative for steps shorter than `threshold` (s); "slow" is a planar command of at most 0.1 m/s.
    """
    moving = (command[:2] ** 2).sum() > 0.1**2
    return ((last_air_time - threshold) * touchdown).sum() * moving


def feet_in_air(contact):
    """Number of feet in the air: `feet_air_time` as the paper prints it."""
    return (1.0 - contact).sum()


def undesired_contacts(lowest):
    """Number of non-foot parts at the ground, from their `lowest` points (m above the ground)."""
    return (lowest < 0).sum() * 1.0


def upright(gravity, std=0.45):
    """exp(-(g_x^2 + g_y^2) / `std`^2) of the gravity direction in the base frame. mjlab: upright."""
    return _exp(-(gravity[:2] ** 2).sum() / std**2)


def posture(joint_position, command, posture_std, posture_std_standing):
    """exp(-mean over joints of (angle from the default pose / std)^2). mjlab: variable_posture.

    The std (rad) of each joint is `task.posture_std`, or `posture_std_standing` where the command is to
    stand.
    """
    xp = joint_position.__array_namespace__()
    off = joint_position / xp.where(_moving(command), posture_std, posture_std_standing)
    return _exp(-(off**2).mean())


def foot_slip(foot_velocity, gravity, contact):
    """Sum over feet on the ground of the horizontal speed of their middle, m/s. Isaac Lab: feet_slide."""
    xp = foot_velocity.__array_namespace__()
    up = (foot_velocity * gravity).sum(-1, keepdims=True) * gravity
    return (xp.sqrt(((foot_velocity - up) ** 2).sum(-1)) * contact).sum()


def feet_phase(foot_height, gait_phase, gait_foot_height):
    """exp(-sum over feet of ((height - target) / width)^2), heights in m, above the lowest foot.

    On rough ground each height is above the ground under that foot, less the smaller of the two: on stairs a
    foot that stands is at 0 on any step, and one that swings is as high as the target above its own step.

    The target is that of the gait clock (gait.target), `task.gait_foot_height` in mid-swing, at the phase
    that the policy saw. Of the middles of feet. The width is 2/3 of that height, so that robots of other
    sizes earn the same with the same walk. Playground: feet_phase, 0.15 m and a width of 0.1 m, of heights
    above the ground; those above the lowest foot follow from joints.
    """
    off = foot_height - foot_height.min() - gait.target(gait_phase, gait_foot_height)
    return _exp(-((off / (gait_foot_height * 2 / 3)) ** 2).sum())


def feet_distance(foot_position, foot_side, feet_apart):
    """m by which left feet are less than feet_apart to the left of right ones, in the mean; base frame.

    `task.feet_apart` is in m. No contact keeps the feet apart in physics, so crossed feet have a distance
    below 0. Playground: feet_distance, there of the distance's size, and 0.1 at most.
    """
    missing = feet_apart - 2 * (foot_side * foot_position[:, 1]).mean()
    return missing * (missing > 0)


def _moving(command):
    """Whether the command is to move: more than 0.1 in size."""
    return gait.moves(command)


def _exp(x):
    return x.__array_namespace__().exp(x)
