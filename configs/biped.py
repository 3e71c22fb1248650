"""Robots on two feet: the task that `g1.py` and adopted bipeds have, and the sizes that learn it.

Rewards are put together from three published tasks of Unitree's G1: Isaac Lab 2.2.1 (IL), mjlab 1.6 and
MuJoCo Playground 0.2 (PG), whose gait clock makes the walk. experiments/25_humanoid has what was measured, of
`best` and `ppo`. These variants are this file's; those of the paper are `default.py`'s.

| variant          | robots | rows N | tail N_s | for                                                 |
|------------------|--------|--------|----------|-----------------------------------------------------|
| `best` (default) | 1024   | 24     | 20       | three rounds of imagination                         |
| `ppo`            | 256    | 24     | none     | to compare                                          |
| `deploy`         | 4096   | 24     | 16       | hardware: what the robot measures, varied, pushed   |
| `quick`          | 256    | 24     | 4        | the smallest run on MJX                             |
| `laptop`         | 512    | 24     | 16       | two CPU cores                                       |
| `rough`          | 2048   | 24     | 16       | stairs, boxes, slopes, with a height scan           |
| `rough_blind`    | 2048   | 24     | 16       | the same without a scan                             |
| `rough_deploy`   | 2048   | 24     | 16       | rough ground for hardware                           |

Rough ground: two seeds have been trained on it (experiments/28_rough); `_rough` says what is different there.

A robot's file starts from `defaults`, sets its motors, sizes and `task.posture_std`, and ends with
`apply_variant`. Metres and strides a second are for a base 0.76 m above the ground; `adopt` writes those of
other heights into its configs (dynappo/adopt/bipeds.py).
"""

import math
import pathlib
import runpy

default = runpy.run_path(str(pathlib.Path(__file__).with_name("default.py")))


def defaults():
    """Those of `default.py` with what every biped has."""
    config = default["defaults"]()
    # with 4 and 8 one step in ten is off by 0.2 rad/s or more in a joint
    config.physics.update(iterations=6, ls_iterations=10)
    config.run.walks = "tracking"
    # with noise of 0.5 and an entropy of 0.005 the error after 2.5 M steps is 0.13 m/s, with these 0.04
    config.ppo.update(init_std=1.0, entropy_coef=0.01)
    config.ppo.scale_inputs = True  # G1: 29 joint velocities with noise of 1.5 rad/s
    _task(config.task)
    return config


def apply_variant(config, variant):
    """As `default.py`'s, with a biped's `best`, `ppo`, `deploy`, `quick`, `laptop` and rough ground."""
    if variant in ("", "best", "ppo"):
        _best(config)
        if variant == "ppo":
            config.rollout.num_envs = 256
            config.run.num_iterations = 840
            config.schedule.update(end_iteration=0, end_steps=0, rounds=1, last_iteration=None)
            config.model.update(clean=False, known_reward=False, falls=False)
            config.ppo.update(desired_kl=0.04, gamma=0.96, minibatches=12)
        return config
    if variant in ("logs", "logs_deploy"):
        raise ValueError(
            f"variant {variant!r} is for robots without a gait clock, which no log tells"
        )
    low, high = config.task.randomize.base_mass
    config = default["apply_variant"](config, variant)
    task = config.task
    if variant in ("deploy", "rough_deploy"):
        _best(config)
        config.rollout.num_envs = 4096
        config.run.num_iterations = 450
        config.schedule.update(end_steps=16, last_iteration=400)
        task.randomize.base_mass = (low, 2 * high)  # a pelvis alone is light: G1's has 3.8 kg
        # With pushes of 1 m/s and 40 ms it stays on its feet and does not follow; with half of both it
        # shuffles, unless the gait clock is paid twice (experiments/25_humanoid/hardware.md)
        task.push.velocity = 0.5
        task.randomize.delay = (0.0, 0.02)
        task.weights.update(feet_phase=2.0, foot_clearance=-0.5, stand_still=0.0, joint_limits=-1.0)
        task.weights.update(action_rate=-0.03, action_acceleration=0.0, energy=0.0)
    elif variant in default["ROUGH"]:
        _best(config)
    elif variant == "quick":
        task.tracking_std = None
    elif variant == "laptop":
        task.tracking_std = None
        config.run.num_iterations = 540  # ten minutes
        config.model.hidden, config.ppo.hidden = (256, 256, 256), (256, 128)
        config.schedule.end_iteration, config.ppo.gamma = 5, 0.97
        config.ppo.critic = "state"
    if variant in default["ROUGH"]:
        default["rough"](config, variant)
        _rough(task)
    return config


def _task(task):
    """Commands, rewards and ends of episodes."""
    task.update(command_y=(-0.5, 0.5), standing=0.1)  # IL, PG; standing: mjlab
    task.update(max_tilt=math.radians(70))  # mjlab
    task.fall_reward = -2.0  # PG's -100 and IL's -200 are -2 and -4 in a row of 0.02 s
    task.posture_std_standing = 0.05  # mjlab
    task.gait_frequency = (1.25, 1.5)  # PG
    # rough ground: steps up to 0.10 m in mjlab, 0.23 m in IL; the rest half as high as IL's
    task.tiles.update(stairs=(0.0, 0.15), boxes=(0.025, 0.1), random=(0.01, 0.05), random_step=0.01)
    task.weights.update(
        track_linear_velocity=2.0,  # mjlab; IL, PG 1
        track_yaw_rate=2.0,  # mjlab, of a wider kernel; IL 1, PG 0.75
        upright=1.0,  # mjlab
        posture=1.0,  # mjlab
        flat_orientation=0.0,  # `upright` instead
        vertical_velocity=-0.2,  # IL
        roll_pitch_rate=-0.05,  # IL, mjlab
        feet_air_time=0.0,  # of quadrupeds
        feet_phase=1.0,  # PG
        foot_clearance=-0.5,  # mjlab -0.25 of 10 cm, here of task.clearance_height
        foot_slip=-0.5,  # PG -0.25, IL -0.1
        feet_distance=-1.0,  # PG, of task.feet_apart
        joint_limits=-1.0,  # mjlab, PG
        joint_torques=-2e-6,  # IL, of hips and knees
        joint_accelerations=-1e-7,  # IL, of hips and knees
        action_rate=-0.03,  # IL -0.005; mjlab -0.1
    )


def _rough(task):
    """Rough ground, where it is not `default.py`'s: commands and rewards as Isaac Lab's G1 has them there.

    - It walks ahead and turns, not aside. Going up is not punished, and torques are by less than a tenth.
    - `feet_phase` stays, which is not Isaac Lab's: heights are above the ground under each foot
      (rewards.py). So are those of `foot_clearance`, in any task. `foot_slip` stays horizontal: on the
      steepest slope a foot that slides pays 7 % less.
    - Feet touch with the ends of their capsules, four points a foot. A step's edge between them does not
      hold the foot: it tips there, as if it had stepped beside the step.
    """
    task.update(command_x=(0.0, 1.0), command_y=(0.0, 0.0))
    task.weights.update(vertical_velocity=0.0, joint_torques=-1.5e-7, joint_accelerations=-1.25e-7)


def _best(config):
    """Few robots, five of six rows and two of three updates imagined. What each setting is worth:
    experiments/25_humanoid/parts.md."""
    config.run.num_iterations = 240
    config.rollout.update(num_envs=1024, horizon=24)
    config.schedule.update(start_iteration=0, end_iteration=5, start_steps=0, end_steps=20)
    config.schedule.update(rounds=3, last_iteration=160, late_from=None)
    config.model.update(clean=True, known_reward=True, falls=True, minibatches=6)
    config.model.update(hidden=(512, 512, 512), activation="swish", precision="bfloat16")
    config.model.update(late_epochs=5, late_from=50)
    config.ppo.update(hidden=(512, 256, 128), activation="swish", precision="bfloat16")
    config.ppo.update(symmetry=True, critic="state", gamma=0.97, desired_kl=0.02, late_kl=1.0)
    config.task.update(episode_length=250, carry_on=True, start_anew=0.5, keep_command=0.0)
    config.run.eval_steps = 1000
