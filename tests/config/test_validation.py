"""Which settings can be run: every other one is a line with the field, what it is and what it may be."""

import functools
import math
import time

import pytest
from answers import refused
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import fields, validation

# What the sizes in the messages below follow from.
BASE = {
    "run.num_iterations": 500,
    "run.log_every": 10,
    "rollout.num_envs": 4096,
    "rollout.horizon": 16,
    "model.minibatches": 4,
    "ppo.minibatches": 4,
    "ppo.shuffle_blocks": 8,
}


def config(some):
    """`dyna4` with BASE and the fields `some` set, as a config file does."""
    out = config_lib.load("configs/go1.py:dyna4")
    for field, value in (BASE | some).items():
        *groups, leaf = field.split(".")
        functools.reduce(lambda node, key: node[key], groups, out)[leaf] = value
    return out


REMEMBERS = {
    "model.memory": 20,
    "model.remembered": 3,
    "schedule.anchors": 9,
    "schedule.rounds": 2,
}
ASKED = {"schedule.new_commands": True}
TIED = {"model.symmetry": True, "ppo.symmetry": True}
WRONG = [  # fields, what the line begins with, what is expected
    # one field by itself
    ({"run.log_every": 0}, "run.log_every is 0", "1 to 2,147,483,647"),
    # a memory, and who reads it
    ({"rollout.imagined": 0}, "rollout.imagined is 0", "1 to 10,000"),
    ({"model.memory": 15, "model.remembered": 1}, "model.memory is 15", "rollout.horizon = 16"),
    ({"model.memory": 16}, "model.memory is 16", "0 where neither model.remembered nor"),
    ({"model.remembered": 1}, "model.remembered is 1", "0 where model.memory is 0"),
    ({"schedule.anchors": 1}, "schedule.anchors is 1", "at most model.memory = 0"),
    (REMEMBERS | {"schedule.anchors": 21}, "schedule.anchors is 21", "at most model.memory = 20"),
    (REMEMBERS | {"schedule.rounds": 1}, "schedule.anchors is 9", "0 where schedule.rounds is 1"),
    (REMEMBERS | {"model.memory": 10**6}, "rollout.num_envs x rollout.imagined", "32 bits"),
    ({"schedule.new_commands": True}, "schedule.new_commands is True", "schedule.rounds is 1"),
    (REMEMBERS | ASKED | {"task.heading": True}, "schedule.new_commands is True", "headings"),
    ({"model.symmetry": True}, "model.symmetry is True", "False where ppo.symmetry is False"),
    (TIED | {"model.hidden": (8, 7)}, "model.hidden is (8, 7)", "even sizes where model.symmetry"),
    ({"model.bound": 0.0}, "model.bound is 0.0", "more than 0"),
    ({"model.bound": -3.0}, "model.bound is -3.0", "more than 0"),
    ({"run.eval_envs": -1}, "run.eval_envs is -1", "0 to 1,000,000"),
    ({"run.video_seconds": -1.0}, "run.video_seconds is -1.0", "0 to 600"),
    ({"task.kp": 1e9}, "task.kp is 1000000000.0", "0 to 100,000"),
    ({"task.standing": -0.1}, "task.standing is -0.1", "0 to 1"),
    ({"physics.timestep": 5.0}, "physics.timestep is 5.0", "0.0001 to 0.1"),
    ({"ppo.learning_rate": 0.0}, "ppo.learning_rate is 0.0", "more than 0, at most 1,000,000,000"),
    ({"ppo.learning_rate": math.nan}, "ppo.learning_rate is nan", "finite"),
    ({"ppo.min_learning_rate": 1e-20}, "ppo.min_learning_rate is 1e-20", "0, or 1e-12 or more"),
    ({"task.weights.action_rate": -2e9}, "task.weights.action_rate is", "-1,000,000,000 to"),
    ({"task.command_x": (0.0, 101.0)}, "task.command_x is (0.0, 101.0)", "-100 to 100"),
    ({"task.command_x": (1.0, -1.0)}, "task.command_x is (1.0, -1.0)", "low <= high"),
    ({"task.randomize.base_mass": (0.0, math.inf)}, "task.randomize.base_mass is", "finite"),
    ({"ppo.hidden": (64, -3)}, "ppo.hidden is (64, -3)", "one or more sizes above 0"),
    ({"ppo.hidden": (10_001,)}, "ppo.hidden is (10001,)", "1 to 10,000"),
    ({"ppo.critic_hidden": (64, 0)}, "ppo.critic_hidden is (64, 0)", "one or more sizes above 0"),
    ({"ppo.critic_hidden": (8,) * 33}, "ppo.critic_hidden is (8, 8", "at most 32 layers"),
    ({"task.max_tilt": 0.0}, "task.max_tilt is 0.0", "0.01 to 3.15"),
    ({"task.posture_std": 0.0}, "task.posture_std is 0.0", "0.001 to"),
    ({"run.walks": "well"}, "run.walks is 'well'", "one of return, tracking"),
    ({"run.seed": 2**31}, "run.seed is 2147483648", "-2,147,483,647 to 2,147,483,647"),
    ({"run.seed": 2**31 - 1, "run.num_seeds": 2}, "run.seed is 2147483647", "32 bits"),
    ({"ppo.critic": "no such"}, "ppo.critic is 'no such'", "one of obs, state"),
    ({"task.air_time": "no such"}, "task.air_time is 'no such'", "one of touchdown, indicator"),
    ({"robot": "go9"}, "robot is 'go9'", "one of anymal_c, anymal_d, g1, go1, go2"),
    ({"robot": "../go1"}, "robot is '../go1'", "one of anymal_c"),
    ({"robot": "a" * 300}, "robot is 'aaa", "one of anymal_c"),
    # two that must fit each other
    ({"rollout.num_envs": 4090}, "rollout.num_envs is 4090", "of ppo.shuffle_blocks = 8"),
    ({"run.num_seeds": 3, "run.mesh_seed": 2}, "run.num_seeds is 3", "of run.mesh_seed = 2"),
    ({"run.mesh_env": 16}, "ppo.shuffle_blocks is 8", "a multiple of run.mesh_env = 16"),
    ({"ppo.symmetry": True, "ppo.hidden": (64, 33)}, "ppo.hidden is (64, 33)", "even sizes"),
    ({"ppo.symmetry": True, "ppo.critic_hidden": (7,)}, "ppo.critic_hidden is (7,)", "even sizes"),
    ({"run.mesh_env": 8, "run.eval_envs": 12}, "run.eval_envs is 12", "of run.mesh_env = 8"),
    ({"run.checkpoint_every": 15}, "run.checkpoint_every is 15", "of run.log_every = 10"),
    ({"run.eval_every": 10, "run.eval_envs": 0}, "run.eval_every is 10", "run.eval_envs is 0"),
    ({"run.eval_every": 5}, "run.eval_every is 5", "of run.log_every = 10"),
    ({"run.num_iterations": 505}, "run.num_iterations is 505", "of run.log_every = 10"),
    (
        {"ppo.min_learning_rate": 0.1},
        "ppo.max_learning_rate is 0.01",
        "at least ppo.min_learning_rate = 0.1",
    ),
    ({"schedule.start_steps": 5}, "schedule.end_steps is 4", "at least schedule.start_steps = 5"),
    (
        {"schedule.start_iteration": 101},
        "schedule.end_iteration is 100",
        "at least schedule.start_iteration = 101",
    ),
    ({"ppo.late_kl": 0.5}, "schedule.late_from is None", "an iteration where ppo.late_kl is 0.5"),
    ({"task.keep_command": 0.6}, "task.keep_command is 0.6", "at most 1 - task.start_anew = 0.5"),
    (
        {"task.start_anew": 0.7, "task.keep_command": 0.4},
        "task.keep_command is 0.4",
        "at most 1 - task.start_anew = 0.3",
    ),
    (
        {"task.terrain": "rough", "task.carry_on": True},
        "task.carry_on is True",
        "False where task.terrain is rough",
    ),
    ({"schedule.end_steps": 16}, "schedule.end_steps is 16", "less than rollout.horizon = 16"),
    (
        {"ppo.minibatches": 3},
        "rollout.num_envs x rollout.horizon / ppo.shuffle_blocks is 8192",
        "a multiple of ppo.minibatches = 3",
    ),
    ({"model.minibatches": 3}, "rollout.horizon is 16", "a multiple of model.minibatches = 3"),
    (
        {"schedule.end_steps": 13},
        "model.minibatches is 4: a minibatch has 4 rows",
        "at most the 3 real rows of the longest tail",
    ),
    ({"ppo.critic": "state"}, "ppo.critic is 'state'", "obs where model.clean is False"),
    (
        {"task.formulation": "isaaclab_exact"},
        "physics.contacts is 'feet'",
        "--config.physics.contacts=full",
    ),
]


@pytest.mark.parametrize(("fields", "found", "expected"), WRONG, ids=str)
def test_a_setting_that_cannot_run_is_one_line(fields, found, expected):
    line = refused(config_lib.validate, config(fields))
    assert line.startswith(found) and "expected" in line and expected in line


@pytest.mark.parametrize("more", [{"model.clean": True}, {"schedule.end_steps": 0}], ids=str)
def test_a_value_function_of_the_state_is_fine_where_no_tail_is_noisy(more):
    assert config_lib.validate(config({"ppo.critic": "state"} | more)).ppo.critic == "state"


def test_every_default_is_inside_its_bounds_and_what_is_outside_is_refused():
    """The bounds are read from configs/default.py, of each field alone or in a tuple."""
    for name, field in fields.every().items():
        fields.check(name, field.default)
        if field.kind in (int, float, tuple):
            for number in (field.low - 1, field.high + field.high / 10):
                number = number if field.kind is tuple else field.kind(number)
                value = (number,) * len(field.like) if field.kind is tuple else number
                assert refused(fields.check, name, value).startswith(f"{name} is {value}, expected")
        elif field.choices:
            assert "expected one of" in refused(fields.check, name, "no such")
    limits = {name: (f.low, f.high) for name, f in fields.every().items()}
    assert limits["rollout.num_envs"] == (1, 1e8) and limits["ppo.gamma"] == (0, 1)
    assert limits["model.hidden"] == (1, 1e4) and limits["task.tracking_std"] == (1e-12, 1e9)
    assert limits["task.push.interval"] == (0, 1e6) and limits["ppo.entropy_coef"] == (-1e9, 1e9)
    assert fields.every()["task.formulation"].choices == tuple(validation.FORMULATIONS)


FAR = 3_000_000_000  # more than an int32 holds
TOO_FAR = [  # what made a traceback, wrapped round, overflowed in float32 or took for ever
    {"run.log_every": 10**12, "run.num_iterations": 10**12},
    {"run.checkpoint_every": FAR},
    {"run.seed": -FAR},
    {"rollout.num_envs": 8 * 10**6, "rollout.horizon": 8192},
    {"schedule.start_iteration": -(10**30)},
    {"model.late_from": FAR},
    {"model.late_epochs": 2 * 10**9},
    {"model.minibatches": FAR, "schedule.end_steps": 0},
    {"ppo.hidden": (64,) * 1000},
    {"ppo.value_coef": 1e39},
    {"ppo.min_std": 1e-40},
    {"task.resample_steps": FAR},
    {"task.push.interval": (1e9, 1e9)},
    {"physics.timestep": 1e-4, "physics.substeps": 1},
    {"physics.threads": 10**9},
]


@pytest.mark.parametrize("some", TOO_FAR, ids=str)
def test_a_number_that_nothing_can_hold_is_refused_at_once(some):
    began = time.process_time()
    line = refused(config_lib.validate, config(some))
    assert time.process_time() - began < 5
    assert "expected" in line and any(name in line for name in some)


def by_hand(field, value):
    """A config whose fields have no types, as somebody may make one: `field` is `value`."""
    tree = config({}).to_dict()
    *groups, leaf = field.split(".")
    functools.reduce(lambda node, key: node[key], groups, tree)[leaf] = value
    return config_dict.ConfigDict(tree)


@pytest.mark.parametrize(
    ("field", "value", "line"),
    [
        ("run.num_iterations", "many", "run.num_iterations is 'many', expected int"),
        ("run.num_iterations", 10.0, "run.num_iterations is 10.0, expected int"),
        ("run.log_every", None, "run.log_every is None, expected int"),
        ("ppo.gamma", "1", "ppo.gamma is '1', expected float"),
        ("ppo.gamma", 10**400, f"ppo.gamma is {10**400}, expected float"),
        ("ppo.adaptive", 1, "ppo.adaptive is 1, expected bool"),
        ("task.formulation", [], "task.formulation is [], expected str"),
        (
            "task.noise",
            3,
            "the config lacks task.noise.angular_velocity; start from configs/default.py",
        ),
        ("task.command_x", (1.0,), "task.command_x is (1.0,), expected tuple like (-1.0, 1.0)"),
        (
            "task.command_x",
            {"a": 1},
            "the config lacks task.command_x; start from configs/default.py",
        ),
        (
            "ppo.hidden",
            "64",
            "ppo.hidden is '64', expected tuple like (128, 128, 128), one or more",
        ),
    ],
)
def test_a_value_of_another_type_is_one_line(field, value, line):
    assert refused(config_lib.validate, by_hand(field, value)).startswith(line)


def test_whole_numbers_become_floats_however_the_config_was_made():
    """Else they would be compiled in; a list is a tuple."""
    assert type(config_lib.validate(by_hand("ppo.gamma", 1)).ppo.gamma) is float
    assert config_lib.validate(by_hand("ppo.hidden", [64, 32])).ppo.hidden == (64, 32)


@pytest.mark.parametrize(
    "fields",
    [
        {"schedule.end_steps": 15, "model.minibatches": 16},  # one real row is enough
        {"schedule.end_steps": 0, "model.minibatches": 3},  # no model: its sizes do not matter
        {"schedule.start_iteration": 100},  # a ramp of no length
        {"schedule.late_from": 0, "ppo.late_kl": 0.5},
        {"task.start_anew": 0.9, "task.keep_command": 0.1},  # nobody is told anew
        {"run.checkpoint_every": 0, "run.eval_every": 0},
        {"run.checkpoint_every": 1001},  # beyond the run: only the last
        {"task.command_x": (0.5, 0.5)},  # a collapsed range
        {"run.num_iterations": 7, "run.log_every": 7, "run.checkpoint_every": 7},
    ],
    ids=str,
)
def test_settings_at_the_edge_of_what_can_run_are_accepted(fields):
    settled = config_lib.flat(config_lib.validate(config(fields)))
    assert {name: settled[name] for name in fields} == fields


def test_what_is_settled():
    """A short run is one chunk, whole numbers become floats; all is frozen, and the argument is not."""
    given = config({"run.num_iterations": 3, "task.command_x": (0, 1)})
    before = config_lib.to_json(given)
    frozen = config_lib.validate(given)
    assert frozen.run.log_every == 3
    assert frozen.task.command_x == (0.0, 1.0) and type(frozen.task.command_x[0]) is float
    with pytest.raises(AttributeError):
        frozen.run.seed = 1
    assert config_lib.to_json(given) == before
    assert config_lib.to_json(config_lib.validate(frozen)) == config_lib.to_json(frozen)


def test_fields_left_open_are_what_the_formulation_says_and_set_ones_stay():
    """Each of them by itself, too: a formulation is a set of decisions."""
    open_fields = {name: None for name in validation.FORMULATIONS["isaaclab"]}
    for name, expected in validation.FORMULATIONS.items():
        fields = {"task.formulation": name, "physics.contacts": "full"}
        task = config_lib.validate(config(fields)).task
        assert {field: task[field] for field in open_fields} == expected
        task = config_lib.validate(config(fields | {"task.tracking_std": 0.3})).task
        assert {field: task[field] for field in open_fields} == expected | {"tracking_std": 0.3}
    mixed = {"task.formulation": "isaaclab_exact", "task.termination": "parts"}
    task = config_lib.validate(config(mixed)).task
    assert (task.heading, task.resample_steps, task.termination) == (True, 500, "parts")
