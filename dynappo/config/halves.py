"""`Static` and `Hyper`: which field is in which half of the config, for type checkers and editors.

`make format` writes this file (tests/write_halves.py) from configs/default.py, which has the fields'
units and sources. Nothing imports it at run time: `splitting.split` makes the same classes from the
config itself, so a new field works before it is here.

Why written out: a type checker runs no code, and no type in Python selects fields by their types. Two
classes for each group, written by hand, would separate fields that belong together, like `desired_kl` and
`adaptive`.
"""

from typing import NamedTuple


class StaticModel(NamedTuple):
    activation: str
    clean: bool
    epochs: int
    falls: bool
    hidden: tuple[int, ...]
    known_reward: bool
    late_epochs: int | None
    late_from: int
    memory: int
    minibatches: int
    normalize: bool
    precision: str
    predict_change: bool
    remembered: int
    symmetry: bool


class StaticPhysics(NamedTuple):
    contacts: str
    impl: str
    iterations: int
    ls_iterations: int
    substeps: int
    threads: int


class StaticPpo(NamedTuple):
    activation: str
    adaptive: bool
    clip_value: bool
    critic: str
    critic_hidden: tuple[int, ...] | None
    epochs: int
    hidden: tuple[int, ...]
    minibatches: int
    normalize: bool
    precision: str
    scale_inputs: bool
    shuffle_blocks: int
    squashed: bool
    symmetry: bool
    value_first: int


class StaticRollout(NamedTuple):
    horizon: int
    imagined: int
    num_envs: int


class StaticRun(NamedTuple):
    checkpoint_every: int
    device: str
    eval_envs: int
    eval_every: int
    eval_steps: int
    log_every: int
    logs: str
    logs_hash: str
    mesh_env: int
    mesh_seed: int
    num_iterations: int
    num_seeds: int
    seed: int
    tensorboard: bool
    walks: str
    wandb: str


class StaticSchedule(NamedTuple):
    anchors: int
    end_iteration: int
    end_steps: int
    last_iteration: int | None
    late_from: int | None
    new_commands: bool
    rounds: int
    start_iteration: int
    start_steps: int


class StaticTiles(NamedTuple):
    border: float
    box_width: float
    boxes: tuple[float, float]
    cell: float
    climb: int
    columns: int
    height_step: float
    map: str
    map_hash: str
    map_level: float
    margin: float
    platform: float
    random: tuple[float, float]
    random_step: float
    rows: int
    seed: int
    shares: tuple[float, float, float, float, float, float]
    size: float
    slope: tuple[float, float]
    stairs: tuple[float, float]
    stairs_border: float
    stairs_platform: float
    start_rows: int
    tread: float


class StaticTask(NamedTuple):
    actuator: str
    air_time: str
    armature: float | tuple[float, ...] | None
    carry_on: bool
    episode_length: int
    formulation: str
    ground_in_tail: str
    heading: bool
    history: int
    observation: str
    random_clock: bool
    remember_ground: bool
    resample_steps: int
    scan: str
    termination: str
    terms: str
    terms_about: str
    terms_hash: str
    terrain: str
    tiles: StaticTiles
    undesired: str


class Static(NamedTuple):
    code: str
    env: str
    model: StaticModel
    physics: StaticPhysics
    ppo: StaticPpo
    robot: str
    rollout: StaticRollout
    run: StaticRun
    schedule: StaticSchedule
    task: StaticTask


class HyperModel(NamedTuple):
    bound: float | None
    huber_delta: float
    learning_rate: float
    stats_decay: float


class HyperPhysics(NamedTuple):
    timestep: float


class HyperPpo(NamedTuple):
    clip_epsilon: float
    desired_kl: float
    entropy_coef: float
    gamma: float
    init_std: float
    lambda_: float
    late_kl: float
    learning_rate: float
    max_grad_norm: float
    max_learning_rate: float
    min_learning_rate: float
    min_std: float
    value_coef: float


class HyperRun(NamedTuple):
    video_seconds: float


class HyperNoise(NamedTuple):
    angular_velocity: float
    gravity: float
    joint_pos: float
    joint_vel: float
    linear_velocity: float
    scan: float
    scan_dropout: float
    scan_lift: float
    scan_shift: float


class HyperPush(NamedTuple):
    interval: tuple[float, float]
    velocity: float


class HyperRandomize(NamedTuple):
    armature: tuple[float, float]
    base_com: tuple[float, float, float]
    base_mass: tuple[float, float]
    delay: tuple[float, float]
    encoder_bias: float
    friction: tuple[float, float]
    imu_tilt: float
    joint_friction: tuple[float, float]
    kd_scale: tuple[float, float]
    kp_scale: tuple[float, float]
    lag: tuple[float, float]
    strength: tuple[float, float]


class HyperReset(NamedTuple):
    foot_clearance: float
    joint_scale: tuple[float, float]
    position: float
    soft_limit: float
    spawn_height: float
    velocity: float
    yaw: float


class HyperWeights(NamedTuple):
    action_acceleration: float
    action_rate: float
    energy: float
    feet_air_time: float
    feet_distance: float | None
    feet_phase: float | None
    flat_orientation: float
    foot_clearance: float
    foot_slip: float | None
    joint_accelerations: float
    joint_limits: float
    joint_torques: float
    posture: float | None
    roll_pitch_rate: float
    stand_still: float
    track_linear_velocity: float
    track_yaw_rate: float
    undesired_contacts: float
    upright: float | None
    vertical_velocity: float


class HyperTask(NamedTuple):
    action_scale: float | tuple[float, ...]
    clearance_height: float
    clearance_ramp: float | None
    clearance_start: float
    command_x: tuple[float, float]
    command_y: tuple[float, float]
    command_yaw: tuple[float, float]
    effort_limit: float | tuple[float, ...]
    fall_reward: float | None
    feet_apart: float
    gait_foot_height: float
    gait_frequency: tuple[float, float] | None
    heading_gain: float
    joint_friction: float | tuple[float, ...]
    kd: float | tuple[float, ...]
    keep_command: float
    kp: float | tuple[float, ...]
    max_tilt: float | None
    noise: HyperNoise
    posture_std: float | tuple[float, ...] | None
    posture_std_standing: float | tuple[float, ...] | None
    push: HyperPush
    randomize: HyperRandomize
    reset: HyperReset
    saturation_effort: float | tuple[float, ...]
    slow_commands: float | None
    standing: float
    start_anew: float
    tracking_std: float
    velocity_limit: float | tuple[float, ...]
    weights: HyperWeights


class Hyper(NamedTuple):
    model: HyperModel
    physics: HyperPhysics
    ppo: HyperPpo
    run: HyperRun
    task: HyperTask
