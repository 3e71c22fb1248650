"""Every setting of dynappo, with its unit, its default and its source.

Robot files (`go1.py`, ...) start from this one and set differences only. A field that is a float
can be changed, or swept under `jax.vmap`, without compiling again; any other field is part of the
program. A field's type says which values it may have: `Share` is a float from 0 to 1, and
`Literal["feet", "full"]` is one of these texts. Upper bounds are far above what is of use.
Sources: "paper" is Learning to Walk With Less; "IL" is Isaac Lab 2.2.1, "RSL" rsl-rl-lib 3.0.1.

Variants, appended to the file name as in `configs/go1.py:ppo16`:

| variant            | rows N | tail N_s                    | source                     |
|--------------------|--------|-----------------------------|----------------------------|
| `ppo12`            | 12     | none                        | paper, Table III           |
| `ppo16`            | 16     | none                        | paper, Table III           |
| `dyna2`            | 16     | 2                           | paper, Table III           |
| `dyna4_noschedule` | 16     | 4                           | paper, Table III           |
| `dyna4`            | 16     | 0 to 4 over iterations 0-100| paper, Table III           |
| `fast`             | 16     | as dyna4                    | 5 epochs after 50, bfloat16|
| `best` (default)   | 20     | 0 to 16 over 0-5, until 150 | experiments/21_less        |
| `few`              | 26     | the same, to 24             | 64 robots, 44 k steps: experiments/27_few |
| `logs`             | 20     | 16                          | from recorded rows: robots/DEPLOY.md |
| `logs_deploy`      | 20     | 16                          | the same of a policy for hardware |
| `deploy`           | 20     | as best                     | for hardware: robots/DEPLOY.md |
| `laptop`           | 24     | 0 to 16 over 0-20, until 350| two CPU cores: it walks    |
| `quick`            | 24     | 0 to 4                      | the smallest run on MJX    |
| `rough`            | 24     | 0 to 16 over 0-20           | stairs, boxes, slopes: docs/terrain.md |
| `rough_blind`      | 24     | as rough                    | without a height scan      |
| `rough_deploy`     | 24     | as rough                    | for hardware               |
"""

from typing import Annotated, Any, Literal, NamedTuple, get_args, get_origin, get_type_hints

from ml_collections import config_dict


class Between(NamedTuple):
    """The least and the largest number that a field may hold."""

    low: float
    high: float


# What several fields may be
Few = Annotated[int, Between(1, 10_000)]
Count = Annotated[int, Between(1, 2**31 - 1)]
Whole = Annotated[int, Between(0, 2**31 - 1)]
Steps = Annotated[int, Between(0, 1_000_000)]
Positive = Annotated[float, Between(1e-12, 1e9)]
NotNegative = Annotated[float, Between(0, 1e9)]
Small = Annotated[float, Between(0, 100)]
Signed = Annotated[float, Between(-100, 100)]
Share = Annotated[float, Between(0, 1)]
Seconds = Annotated[float, Between(0, 1_000_000)]
Frequency = Annotated[float, Between(0.01, 10)]
Range = tuple[NotNegative, NotNegative]  # low, high
UpToTen = Annotated[float, Between(0, 10)]
Rise = tuple[UpToTen, UpToTen]  # low, high
Command = tuple[Signed, Signed]  # low, high
Layers = tuple[Few, ...]
PerJoint = float | dict[str, float] | tuple[float, ...]
Activation = Literal["elu", "relu", "tanh", "swish"]
Precision = Literal["highest", "tf32", "bfloat16"]

# variant -> horizon, (start_iteration, end_iteration, start_steps, end_steps)
PAPER = {
    "ppo12": (12, (0, 0, 0, 0)),
    "ppo16": (16, (0, 0, 0, 0)),
    "dyna2": (16, (0, 0, 2, 2)),
    "dyna4_noschedule": (16, (0, 0, 4, 4)),
    "dyna4": (16, (0, 100, 0, 4)),
}
OF_THE_PAPER = (*PAPER, "fast")
ROUGH = ("rough", "rough_blind", "rough_deploy")
OPEN = "weights", "noise", "own"  # groups of `task` with fields of terms of your own
VARIANTS = (
    *OF_THE_PAPER,
    "best",
    "few",
    "logs",
    "logs_deploy",
    "deploy",
    "quick",
    "laptop",
    *ROUGH,
)


class Run(NamedTuple):
    """How long, on what, and what is written."""

    seed: int = 0
    num_seeds: Few = 1  # seeds trained at once by jax.vmap
    mesh_seed: Count = 1  # devices over which the seeds are spread; they do not communicate
    mesh_env: Count = 1  # devices over which the robots of each seed are spread
    num_iterations: Annotated[int, Between(1, 1_000_000)] = 500  # paper
    log_every: Count = 10  # iterations in a call, and between two looks at the metrics
    checkpoint_every: Whole = 100  # iterations; a multiple of log_every; 0: only the last
    eval_every: Whole = 0  # iterations; a multiple of log_every; 0: only at the end
    eval_envs: Annotated[int, Between(0, 1_000_000)] = 1000  # robots, one episode each; 0: none
    eval_steps: Steps = 0  # control steps of such an episode; 0: task.episode_length
    video_seconds: Annotated[float, Between(0, 600)] = 12.0  # s of film after training; 0: none
    device: Literal["auto", "cpu", "gpu"] = "auto"
    tensorboard: bool = True  # write TensorBoard's events into the workdir
    # what tells that the robot walks (policy/walks.py): its return, in a task in which that was measured; or
    # its tracking errors, where other terms than tracking are rewards
    walks: Literal["return", "tracking"] = "return"
    wandb: str = ""  # project of Weights & Biases to log to; empty: none
    # --logs: a file of a robot's rows, from which it learns in place of simulated ones (robots/DEPLOY.md)
    logs: str = ""
    logs_hash: str = ""  # of the file; follows from it


class Rollout(NamedTuple):
    """How many robots and rows."""

    num_envs: Annotated[int, Between(1, 100_000_000)] = 4096  # R; paper
    horizon: Few = 16  # N = N_r + N_s; paper
    imagined: Few = 1  # robots that write tails, for each simulated one (model/memory.py); paper: 1


class Schedule(NamedTuple):
    """How many rows the model writes: the paper's eq. 5; all zero is plain PPO."""

    start_iteration: int = 0  # a
    end_iteration: int = 100  # b
    start_steps: Whole = 0  # x
    end_steps: Whole = 4  # y
    last_iteration: Whole | None = None  # of a tail; later all rows are real. None: every iteration
    rounds: Few = 1  # of imagination in an iteration (algorithm.py); paper: 1
    # rows of each robot, the newest in the memory, in which tails of later rounds begin; 0: the iteration's
    anchors: Whole = 0
    new_commands: bool = False  # such a tail begins under a new command (Env.retell)
    late_from: Whole | None = None  # the iteration after which ppo.late_kl holds; None: never


class Model(NamedTuple):
    """The transition model."""

    hidden: Layers = (256, 256, 256, 256)  # paper, Table II
    activation: Activation = "elu"
    learning_rate: Positive = 3e-3  # paper, Table II
    epochs: Few = 25  # paper, Table II
    late_epochs: Annotated[int, Between(0, 10_000)] | None = (
        None  # after iteration late_from; None: epochs
    )
    late_from: int = 50
    minibatches: Count = 2  # gradient steps of an epoch when all N rows are real; divides N
    huber_delta: Positive = 1.0  # in units of the (normalised) target
    predict_change: bool = True  # the target is the change of state; False: the next state
    normalize: bool = True  # scale inputs and targets by running moments; False: raw numbers
    stats_decay: Share = 0.95  # weight of the old moments, an iteration
    precision: Precision = "highest"  # float32
    # beyond the paper, each off in the paper's variants (model/dynamics.py)
    clean: bool = False  # carry the state without noise, and draw the policy's noise anew
    known_reward: bool = False  # compute the terms that need no model, and learn the rest
    falls: bool = False  # predict the probability of a fall; nothing in a tail ends by time
    # real rows of past iterations (model/memory.py)
    memory: Whole = 0  # rows of each robot that are kept; 0: none
    remembered: Annotated[int, Between(0, 100)] = 0  # of them, beside each new row of a minibatch
    symmetry: bool = False  # learn from mirrored rows, too (learner/symmetry.py)
    # a predicted prop stays within so many standard deviations of the model's inputs; None: no bound
    bound: Positive | None = None


class Ppo(NamedTuple):
    """PPO: RSL, IL agents/rsl_rl_ppo_cfg.py, and the paper's appendix."""

    hidden: Layers = (128, 128, 128)
    critic_hidden: Layers | None = None  # of the value function; None: as the policy's
    activation: Activation = "elu"
    init_std: Positive = 1.0  # of the Gaussian policy, in units of the action
    min_std: Positive = 0.01
    learning_rate: Positive = 1e-3
    adaptive: bool = True  # the KL adapts the learning rate, at every minibatch
    desired_kl: Positive = 0.01
    late_kl: Positive = 1.0  # times desired_kl, after iteration schedule.late_from
    min_learning_rate: NotNegative = 1e-5
    max_learning_rate: Positive = 1e-2
    epochs: Few = 5
    minibatches: Count = 4
    shuffle_blocks: Count = 8  # blocks of robots in which rows are permuted; see run.mesh_env
    clip_epsilon: Positive = 0.2
    clip_value: bool = True
    value_coef: NotNegative = 1.0
    entropy_coef: float = 0.01
    # the entropy is that of tanh(action): for an environment that squashes actions so
    squashed: bool = False
    gamma: Share = 0.99
    lambda_: Share = 0.95
    max_grad_norm: Positive = 1.0
    precision: Precision = "highest"
    # what the value function sees: "obs", as the policy; or "state", without noise and with
    # what no sensor tells (tasks/velocity/view.py)
    critic: Literal["obs", "state"] = "obs"
    # iterations in which only the value function learns: one of a restored policy that has none
    value_first: Whole = 0
    # learn as if joint velocities were 20 times smaller, angular velocities 4 times (learner/units.py)
    scale_inputs: bool = False
    # the networks see their inputs with mean 0 and variance 1, of all rows so far (learner/scaling.py)
    normalize: bool = False
    symmetry: bool = False  # what is learned of the left holds for the right (learner/symmetry.py)


class Weights(NamedTuple):
    """1/s: each term of the reward is multiplied by its weight and by 0.02 s."""

    track_linear_velocity: float = 1.5
    track_yaw_rate: float = 0.75
    vertical_velocity: float = -2.0
    roll_pitch_rate: float = -0.05
    flat_orientation: float = -2.5
    joint_torques: float = -2e-4
    joint_accelerations: float = -2.5e-7
    action_rate: float = -0.01
    feet_air_time: float = 0.25
    undesired_contacts: float = 0.0
    # for smooth and careful gaits; 0 in Isaac Lab's tasks. A robot's file has a weight of foot_clearance for
    # `best`, `few` and `laptop`, and a larger one for `deploy` (`lift_feet`)
    action_acceleration: float = 0.0
    energy: float = 0.0
    joint_limits: float = 0.0
    stand_still: float = 0.0
    foot_clearance: float = 0.0
    # of bipeds; None: the term is not in the program
    upright: float | None = None
    posture: float | None = None  # with task.posture_std
    foot_slip: float | None = None
    feet_phase: float | None = None  # with task.gait_frequency
    feet_distance: float | None = None


class Noise(NamedTuple):
    """Half width of the uniform noise on each part of the observation; IL."""

    joint_pos: NotNegative = 0.01  # rad
    joint_vel: NotNegative = 1.5  # rad/s
    gravity: NotNegative = 0.05
    linear_velocity: NotNegative = 0.1  # m/s
    angular_velocity: NotNegative = 0.2  # rad/s
    scan: NotNegative = 0.1  # m, on each point of the height scan
    # of a robot's own map, drawn for an episode: shifted along x and y, and up; m, half widths
    scan_shift: NotNegative = 0.0
    scan_lift: NotNegative = 0.0
    scan_dropout: Share = 0.0  # share of the points that are missing, which read 0


class Own(NamedTuple):
    """Numbers of terms of your own, by name (docs/task.md)."""


class Reset(NamedTuple):
    """How an episode starts; IL."""

    spawn_height: Signed = 0.4  # m
    foot_clearance: Small = 0.01  # m, at least this much air below the lowest foot
    position: NotNegative = 0.5  # m, half width in x and y
    yaw: Small = 3.14  # rad, half width
    velocity: Small = 0.0  # m/s and rad/s, half width on all six axes
    joint_scale: Command = (1.0, 1.0)  # default pose times uniform(...), per joint
    soft_limit: Share = 0.9  # share of each joint's range that a reset may use


class Push(NamedTuple):
    """A kick to the base's horizontal velocity; IL, ANYmal only."""

    velocity: Small = 0.0  # m/s, half width in world x and y; 0: none
    interval: tuple[Seconds, Seconds] = (10.0, 15.0)  # s


class Randomize(NamedTuple):
    """A robot's own body: ranges, drawn once."""

    base_mass: tuple[float, float] = (-1.0, 3.0)  # kg, added to the base; IL
    base_com: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)  # m, half widths
    friction: Range = (0.8, 0.8)  # of the feet
    kp_scale: Range = (1.0, 1.0)
    kd_scale: Range = (1.0, 1.0)
    # real robots (physics/randomize.py); nominal: not in the compiled program
    strength: Range = (1.0, 1.0)  # share of the motors' torque that arrives
    armature: Range = (1.0, 1.0)  # of the joints, times the nominal
    joint_friction: Range = (0.0, 0.0)  # N m, added to the nominal
    delay: Range = (0.0, 0.0)  # s, actions come late; at most two control steps
    lag: Range = (0.0, 0.0)  # s, time constant with task.actuator="lag"
    encoder_bias: NotNegative = 0.0  # rad, half width, a joint
    imu_tilt: NotNegative = 0.0  # rad, half width, about each axis


class Tiles(NamedTuple):
    """The ground with task.terrain="rough" (terrain/tiles.py), part of the program; IL's rough tasks."""

    # a ground of your own, FILE.npy or FILE.png (terrain/map_file.py), `cell` m between two points: tiles of
    # `size` are places on it, and all else here is not looked at. "": none
    map: str = ""
    map_level: Positive = 0.005  # m, a level of a picture's grey
    map_hash: str = ""  # of the file; follows from it, as rows and columns do
    seed: Whole = 0
    rows: Annotated[int, Between(1, 100)] = 10  # from easy to hard, along x
    columns: Annotated[int, Between(1, 100)] = 20  # along y, each of one kind
    start_rows: Few = 6  # robots begin in the easiest so many
    climb: Few = 1  # rows harder for a robot that has crossed its tile
    size: Annotated[float, Between(2, 100)] = 8.0  # m, side of a tile
    cell: Annotated[float, Between(0.01, 1)] = 0.1  # m, between two heights of the map
    border: Annotated[float, Between(0, 100)] = 2.0  # m, flat, around all; beyond it is flat too
    height_step: Annotated[float, Between(1e-4, 0.1)] = 0.005  # m, heights are multiples of this
    # columns of each kind: pyramid_stairs, pit_stairs, boxes, random, pyramid_slope, pit_slope
    shares: tuple[Share, Share, Share, Share, Share, Share] = (0.2, 0.2, 0.2, 0.2, 0.1, 0.1)
    stairs: Rise = (0.05, 0.23)  # m, height of a step in the easiest and in the hardest row
    tread: Annotated[float, Between(0.01, 100)] = 0.3  # m
    stairs_platform: NotNegative = 3.0  # m, in the middle
    stairs_border: NotNegative = 1.0  # m, before the first step
    boxes: Rise = (0.05, 0.20)  # m, up and down
    box_width: Annotated[float, Between(0.01, 100)] = 0.45  # m
    random: Rise = (0.02, 0.10)  # m, lowest and highest point, in every row; whole steps apart
    random_step: Annotated[float, Between(1e-4, 10)] = 0.02  # m, between two heights
    slope: Rise = (0.0, 0.4)  # rise over run
    platform: NotNegative = 2.0  # m, in the middle of boxes and slopes
    margin: NotNegative = 0.25  # m, flat, around boxes, random ground and slopes


class Task(NamedTuple):
    """What the robot is asked and paid for."""

    # "isaaclab", "paper_text" or "isaaclab_exact": decides the fields below that are None,
    # term by term in configs/README.md
    formulation: Literal["isaaclab", "paper_text", "isaaclab_exact"] = "isaaclab"
    tracking_std: Positive | None = None  # m/s, rad/s; 0.5 (isaaclab*) or 1.0
    air_time: Literal["touchdown", "indicator"] | None = None  # the latter: paper_text
    heading: bool | None = None  # the yaw rate turns the robot to a heading; exact only
    resample_steps: Steps | None = None  # control steps between two commands; 0: an episode
    standing: Share | None = None  # share of commands that are zero
    slow_commands: Share | None = None  # share of commands that are slow: times 0 to 0.5
    termination: Literal["parts", "base"] | None = None  # "base" (exact) needs contacts="full"
    undesired: Literal["parts", "thighs"] | None = None  # contacts; "thighs": exact
    # parts at the ground are seen in every physics step (exact) or in the last of a row. Seen
    # in every one, Go1 fell 39 and 58 % more often at iteration 50, and 5 of 17 runs stood
    # still at iteration 300, against none of 18 (experiments/01_four_robots)
    remember_ground: bool | None = None
    episode_length: Annotated[int, Between(1, 1_000_000)] = 1000  # control steps, 20 s; IL
    random_clock: bool = True  # episodes start at random ages, so that time-outs spread; IL
    # robots that time out stay where they are, with a new command; on a flat floor alone
    carry_on: bool = False
    start_anew: Share = 0.5  # with carry_on, the share of those that starts anew
    keep_command: Share = 0.0  # with carry_on, the share of those that stays with its old command
    # "rough": the ground of `tiles`, with a curriculum (dynappo/terrain). A robot that leaves its tile ends
    # its episode as the time does, and starts a row harder
    terrain: Literal["flat", "rough"] = "flat"
    # what is seen of it: nothing, or heights of a grid of 17 x 11 points around the base (terrain/scan.py)
    scan: Literal["none", "grid"] = "none"
    # controls, each without one thing: a tail does not end where a part is in the ground; feet and scan stay
    # as in its first row; the model does not see the ground
    ground_in_tail: Literal["known", "no_end", "frozen", "blind"] = "known"
    # rad, angle between the base's z axis and the vertical; more ends the episode as a fall does. None: any
    max_tilt: Annotated[float, Between(0.01, 3.15)] | None = None
    # paid once, in the row of a fall, not times 0.02 s as weights are; None: nothing
    fall_reward: float | None = None
    # rad, how far a joint may be from the default pose in the term `posture`; the second where the robot is
    # told to stand. None: not in the program
    posture_std: Annotated[PerJoint, Between(1e-3, 1e6)] | None = None
    posture_std_standing: Annotated[PerJoint, Between(1e-3, 1e6)] | None = None
    # Hz, strides of a biped's gait clock (tasks/velocity/gait.py): drawn where a robot starts anew; feet's
    # phases are part of the observation. Playground's G1: 1.25 to 1.5. None: not in the program
    gait_frequency: tuple[Frequency, Frequency] | None = None
    # m, in the middle of a swing, for feet_phase, whose width goes with it; Playground's G1
    gait_foot_height: Positive = 0.15
    clearance_height: Positive = 0.06  # m, that a foot must lift in foot_clearance
    # a curriculum of foot_clearance: a robot pays a share of its weight, `clearance_start` at first and
    # `clearance_ramp` more after each episode without a fall, as much less after a fall. A policy that cannot
    # walk yet touches down all the time. None: all of it at once; an evaluation has all, too
    clearance_ramp: Share | None = None
    clearance_start: Share = 0.2
    feet_apart: NotNegative = 0.2  # m, sideways, in feet_distance; Playground's G1
    # rad per unit of action; IL
    action_scale: Annotated[PerJoint, Between(1e-12, 100)] = 0.25
    # "full": the 48 numbers of tasks/velocity/observe.py; "onboard": the 45 that a robot measures, so
    # without linear velocity
    observation: Literal["full", "onboard"] = "full"
    history: Annotated[int, Between(1, 100)] = 1  # readings that the policy sees
    actuator: Literal["pd", "lag"] = "pd"  # "lag": the torque lags by task.randomize.lag
    kp: Annotated[PerJoint, Between(0, 100_000)] = 25.0  # N m/rad
    kd: Annotated[PerJoint, Between(0, 100_000)] = 0.5  # N m s/rad
    effort_limit: Annotated[PerJoint, Between(1e-12, 1e9)] = 23.7  # N m
    # N m, torque of the motor at standstill
    saturation_effort: Annotated[PerJoint, Between(1e-12, 1e9)] = 23.7
    # rad/s, speed of the motor without load
    velocity_limit: Annotated[PerJoint, Between(1e-12, 1e9)] = 30.0
    # kg m^2, inertia of the motors as the joints feel it; None: the file's. Part of the program
    armature: Annotated[PerJoint, Between(0, 1e4)] | None = None
    # N m, dry friction beside the file's (physics/actuators.py); `randomize` adds to it
    joint_friction: Annotated[PerJoint, Between(0, 1e4)] = 0.0
    command_x: Command = (-1.0, 1.0)  # m/s; paper and IL
    command_y: Command = (-1.0, 1.0)  # m/s
    command_yaw: Command = (-1.0, 1.0)  # rad/s
    heading_gain: Signed = 0.5  # 1/s, yaw rate for each rad that is left to turn; IL
    # a file with terms of your own: rewards, observations, ends, commands, curricula (docs/task.md). Their
    # weights and noises are fields of `weights` and `noise`, their other numbers of `own`. "": none
    terms: str = ""
    terms_hash: str = ""  # of the file; follows from it, as what it adds to an observation does
    terms_about: str = ""
    own: Own = Own()
    weights: Weights = Weights()
    noise: Noise = Noise()
    reset: Reset = Reset()
    push: Push = Push()
    randomize: Randomize = Randomize()
    tiles: Tiles = Tiles()


class Physics(NamedTuple):
    """The engine and its solver."""

    # "auto": "warp" on an NVIDIA GPU with warp-lang, else "jax"; "c" is C MuJoCo, on a CPU
    impl: Literal["auto", "jax", "warp", "c"] = "auto"
    threads: Annotated[int, Between(0, 1000)] = 0  # of C MuJoCo; 0: as many as cores
    # what meets the floor: "feet" where other parts end the episode first
    contacts: Literal["feet", "full"] = "feet"
    timestep: Annotated[float, Between(1e-4, 0.1)] = 0.005  # s; IL
    substeps: Few = 4  # physics steps in a control step; IL
    iterations: Few = 4  # of the constraint solver
    ls_iterations: Few = 8  # of its line search


class Config(NamedTuple):
    """Every field, as the paper's `dyna4` has it."""

    robot: str = "go1"  # a folder of robots/; "": of another environment
    env: str = ""  # playground:TASK or brax:NAME (docs/environment.md); "": the task of the robot
    code: str = ""  # of an environment of one's own, a hash of its file; follows from that
    run: Run = Run()
    rollout: Rollout = Rollout()
    schedule: Schedule = Schedule()
    model: Model = Model()
    ppo: Ppo = Ppo()
    task: Task = Task()
    physics: Physics = Physics()


def get_config(variant: str = "") -> config_dict.ConfigDict:
    """Go1's config; robot files call `defaults`, and `apply_variant` after their own differences."""
    return apply_variant(defaults(), variant)


def defaults() -> config_dict.ConfigDict:
    """`Config` as a config that can be changed: of every field the value may, the type may not.

    Groups in `OPEN` take the fields of terms of your own; a name that is none is found when it is loaded.
    """
    config = config_dict.ConfigDict(_nested(Config())).lock()
    for group in OPEN:
        config.task[group].unlock()
    return config


class _EachJoint(config_dict.FieldReference):
    """Holds a `PerJoint`; of a dict its pairs, for ml_collections takes a dict for a group of fields."""

    def __init__(self, value: Any):
        super().__init__(value, field_type=object)

    def set(self, value: Any, type_safe: bool = True) -> None:
        super().set(tuple(value.items()) if isinstance(value, dict) else value, type_safe)


def _nested(group: Any) -> dict[str, Any]:
    """A group as a dict; a field that is None until it is set keeps the type it will have."""
    out, types = {}, get_type_hints(type(group))
    for name, value in group._asdict().items():
        kinds = get_args(types[name])
        if set(get_args(PerJoint)) <= set(kinds):
            value = _EachJoint(value)
        elif value is None:
            kind = kinds[0]  # of `kind | None`
            kind = str if get_origin(kind) is Literal else get_origin(kind) or kind
            value = config_dict.placeholder(kind)
        out[name] = _nested(value) if hasattr(value, "_fields") else value
    return out


def apply_variant(config: config_dict.ConfigDict, variant: str) -> config_dict.ConfigDict:
    """Set what the variant changes, `best` where none is named; an unknown name is a ValueError."""
    variant = variant or "best"
    if variant not in VARIANTS:
        raise ValueError(f"variant {variant!r} is not one of {', '.join(VARIANTS)}")
    if variant in PAPER:
        horizon, (a, b, x, y) = PAPER[variant]
        config.rollout.horizon = horizon
        config.schedule.update(start_iteration=a, end_iteration=b, start_steps=x, end_steps=y)
    elif variant == "fast":
        config.model.update(late_epochs=5, late_from=50, precision="bfloat16")
    elif variant == "best":
        _best(config)
    elif variant == "few":
        _few(config)
    elif variant in ("logs", "logs_deploy"):
        _best(config) if variant == "logs" else _deploy(config)
        _logs(config)
    elif variant == "deploy":
        _deploy(config)
    elif variant in ROUGH:
        _deploy(config) if variant == "rough_deploy" else _best(config)
        rough(config, variant)
    elif variant == "laptop":
        # Learning takes half of a CPU's time, so the networks are small and the model has few epochs. Swish,
        # a larger KL and gamma 0.98 let it learn from fewer steps (experiments/04_laptop).
        config.physics.impl = "c"
        # As in `_best`: episodes begin in three ways; smaller steps of PPO and physics alone at the end
        config.task.update(tracking_std=1.0, episode_length=125, carry_on=True)
        config.task.update(start_anew=1 / 3, keep_command=1 / 3)
        config.schedule.update(late_from=250, last_iteration=350)
        config.ppo.late_kl = 0.5
        config.rollout.update(num_envs=512, horizon=24)
        config.schedule.update(start_iteration=0, end_iteration=20, start_steps=0, end_steps=16)
        config.model.update(clean=True, known_reward=True, falls=True, minibatches=6)
        config.model.update(hidden=(128, 128, 128), activation="swish")
        config.model.update(epochs=4, late_epochs=2, late_from=50)
        config.ppo.update(hidden=(128, 64), activation="swish", gamma=0.98, desired_kl=0.02)
        config.ppo.symmetry = True
        config.run.update(device="cpu", num_iterations=400, log_every=10)
        config.run.update(eval_envs=200, eval_steps=1000)
    elif variant == "quick":
        # The default kernel (std 0.5) first makes episodes shorter, because a fall ends negative
        # rewards; std 1 lets a robot learn within two minutes of two CPU cores.
        config.task.tracking_std = 1.0
        config.rollout.update(num_envs=256, horizon=24)
        config.schedule.update(start_iteration=0, end_iteration=40, start_steps=0, end_steps=4)
        config.model.update(epochs=2, minibatches=8)
        config.run.update(num_iterations=70, log_every=2, eval_envs=16, video_seconds=4.0)
    return config


def lift_feet(
    config, variant: str, best: float, laptop: float, deploy: tuple[float, float]
) -> None:
    """Pay for high feet in our own variants, on flat ground: weights of `foot_clearance`, and of `deploy` the
    weight and the height in m. There a robot pays by and by: at once such weights keep ANYmals from walking,
    and a seed in ten still falls at iteration 500. What they cost: experiments/22_deploy/feet.md."""
    # no log tells how high a foot was
    weights = {"": best, "best": best, "few": best, "laptop": laptop}
    if variant in weights:
        config.task.weights.foot_clearance = weights[variant]
    if variant in ("deploy", "logs_deploy"):
        config.task.weights.foot_clearance, config.task.clearance_height = deploy
    if variant == "deploy":
        config.task.clearance_ramp = 0.05


def _best(config: config_dict.ConfigDict) -> None:
    """Few robots, and four of five rows and two of three updates imagined, until the robot walks; then
    physics alone. What each setting is worth: experiments/21_less."""
    config.rollout.update(num_envs=1024, horizon=20)
    config.schedule.update(start_iteration=0, end_iteration=5, start_steps=0, end_steps=16)
    config.schedule.update(last_iteration=150, rounds=3, late_from=60)
    config.model.update(clean=True, known_reward=True, falls=True, minibatches=5)
    config.model.update(late_epochs=5, late_from=50, activation="swish", precision="bfloat16")
    config.ppo.update(symmetry=True, gamma=0.98, desired_kl=0.02, late_kl=0.5)
    config.ppo.update(activation="swish", precision="bfloat16")
    # Robots fall in the first second of an episode or of a command, so they must begin many; and some
    # after ten seconds of a slow one, so one in three goes on under its own
    config.task.update(episode_length=125, carry_on=True, start_anew=1 / 3, keep_command=1 / 3)
    config.run.eval_steps = 1000


def _few(config: config_dict.ConfigDict) -> None:
    """`best` with 64 robots and 44 k simulator steps in all: the model remembers every real row, and each
    real robot is continued by 64 imagined ones (dynappo/model/memory.py; experiments/27_few)."""
    _best(config)
    config.rollout.update(num_envs=64, imagined=64, horizon=26)
    config.model.update(memory=800, remembered=3, minibatches=13, symmetry=True, late_epochs=None)
    config.schedule.update(end_steps=24, anchors=200, last_iteration=None, late_from=None)
    config.ppo.late_kl = 1.0  # smaller steps late take no falls away (27_few/parts.md)
    # 64 robots hear few commands: without new ones 2 % of the episodes have a fall at the end. Those of a
    # heading or a gait clock cannot be drawn in a tail
    config.schedule.new_commands = not config.task.heading and config.task.gait_frequency is None
    config.run.num_iterations = 320  # of 128 real rows, after the ramp: 44 k


def _logs(config: config_dict.ConfigDict) -> None:
    """From the rows of a file in place of simulated ones (robots/DEPLOY.md; experiments/27_few)."""
    config.rollout.num_envs = 512
    config.schedule.update(end_iteration=0, start_steps=16, last_iteration=None, late_from=None)
    config.model.update(symmetry=True, late_epochs=None, learning_rate=1e-3)
    # the policy takes ten iterations: with more it learns what is wrong in the model
    config.ppo.update(late_kl=1.0, value_first=20, entropy_coef=0.0)
    config.run.num_iterations = 30


def _deploy(config: config_dict.ConfigDict) -> None:
    """`best` for a robot of metal (robots/DEPLOY.md). What was tried: experiments/22_deploy/tried.md."""
    _best(config)
    task, weights = config.task, config.task.weights
    # 45 numbers that a robot measures, of the last five steps; value and model see the state
    task.update(observation="onboard", history=5, standing=0.1)
    config.ppo.critic = "state"
    # longer episodes, for they are pushed; and the larger steps to the end, for the task is harder
    task.episode_length, config.ppo.late_kl = 250, 1.0
    # the task is harder, and a GPU has room for more robots
    config.rollout.num_envs = 4096
    config.run.num_iterations = 700
    # Payloads: twice Isaac Lab's range. Friction as legged_gym and unitree_rl_lab together. Gains, torque
    # and joint friction: what motors of one kind differ by. Delay: two control steps at most, of bus,
    # driver and computer together. Sensors: a degree.
    low, high = task.randomize.base_mass
    task.randomize.update(base_mass=(2 * low, 2 * high), base_com=(0.05, 0.05, 0.03))
    task.randomize.update(friction=(0.2, 1.25), kp_scale=(0.9, 1.1), kd_scale=(0.9, 1.1))
    task.randomize.update(strength=(0.8, 1.2), armature=(0.8, 1.2), joint_friction=(0.0, 0.2))
    task.randomize.update(delay=(0.0, 0.04), encoder_bias=0.02, imu_tilt=0.02)
    # Practice pushes every 5 to 10 s in episodes of 20; these have 5 s
    task.push.update(velocity=1.0, interval=(2.0, 6.0))
    # Smooth, with feet lifted, still when told to stand. Power: in the ratio of the torques' weights.
    # A larger clearance is a robot's own: configs/go1.py, configs/anymal_c.py
    weights.update(energy=5 * weights.joint_torques, foot_clearance=-0.3)
    for name in ("action_rate", "joint_torques", "joint_accelerations"):
        weights[name] *= 2
    weights.update(action_acceleration=-0.01)
    weights.update(stand_still=-0.5, joint_limits=-5.0)


def rough(config: config_dict.ConfigDict, variant: str) -> None:
    """Rough ground, on top of `best` or `deploy`, as Isaac Lab's rough tasks (velocity_env_cfg.py; a robot's
    own numbers: its file).

    Different from there, and why:

    - Every part that touches the ground ends an episode, where there it is the base alone: the fast kernels
      of physics have contacts of the feet only, so a shank would sink into a step. So a policy may not lean
      on one. For the base alone, on MuJoCo's own step: --config.task.termination=base
      --config.physics.contacts=full.
    - A robot that leaves its tile ends its episode, as the time does, and starts a row harder. There it walks
      on, for 20 s: here it gets to harder rows in a fifth of the steps.
    - The scan's noise and the ground are Isaac Lab's; rows are even from easy to hard (terrain/tiles.py).
    """
    task = config.task
    task.update(terrain="rough", scan="none" if variant == "rough_blind" else "grid")
    # commands: a heading, kept for an episode, which ends at the tile's edge; 2 % stand
    task.update(heading=True, standing=0.02, resample_steps=0)
    task.update(episode_length=1000, carry_on=False, start_anew=0.5, keep_command=0.0)
    # only the value function sees the ground at the feet
    config.ppo.critic = "state"
    # the scan has 187 numbers, so networks as there, and a GPU has room for more robots
    config.ppo.update(hidden=(512, 256, 128), late_kl=0.3)
    config.rollout.update(num_envs=2048, horizon=24)
    config.model.minibatches = 6
    config.schedule.update(start_iteration=0, end_iteration=20, start_steps=0, end_steps=16)
    config.schedule.update(last_iteration=None, late_from=350, rounds=3)
    config.run.num_iterations = 600
    task.weights.flat_orientation = 0.0
