"""Settings: every mistake is one line that names the field, and floats never reach the program."""

import functools
import json
import math
import os
import pathlib
import subprocess
import sys

import jax
import pytest
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import ConfigError

ROOT = pathlib.Path(config_lib.__file__).parent.parent
VARIANTS = ("", "ppo12", "ppo16", "dyna2", "dyna4_noschedule", "dyna4", "fast", "best", "quick")
# The type of every field that is not a float or a tuple of floats.
INTS = """
run.seed run.num_seeds run.mesh_seed run.mesh_env run.num_iterations run.log_every
run.checkpoint_every run.eval_every run.eval_envs rollout.num_envs rollout.horizon
schedule.start_iteration schedule.end_iteration schedule.start_steps schedule.end_steps model.epochs
model.late_from model.minibatches model.ensemble model.unroll model.history
ppo.first_order_steps ppo.epochs ppo.minibatches ppo.shuffle_blocks
task.episode_length physics.substeps physics.iterations physics.ls_iterations
""".split()
STRINGS = """
robot run.device run.wandb model.activation model.precision ppo.activation ppo.precision task.formulation
physics.impl physics.contacts
""".split()
BOOLS = (
    "run.tensorboard run.time_phases model.predict_change model.normalize ppo.adaptive "
    "ppo.clip_value task.random_clock model.clean model.known_reward model.falls model.bounds "
    "model.private schedule.by_error"
).split()
SIZES = "model.hidden ppo.hidden".split()
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
OPTIONAL = {
    "task.tracking_std": float,
    "task.air_time": str,
    "task.heading": bool,
    "task.resample_steps": int,
    "task.standing": float,
    "task.termination": str,
    "task.undesired": str,
    "task.remember_ground": bool,
    "model.late_epochs": int,
}


def load(variant="dyna4", robot="go1"):
    """The config of one of the package's files."""
    return config_lib.load(f"configs/{robot}.py" + (f":{variant}" if variant else ""))


def put(config, field, value):
    """Set a dotted field as a config file does."""
    *groups, leaf = field.split(".")
    functools.reduce(lambda node, key: node[key], groups, config)[leaf] = value


def get(config, field):
    """The value of a dotted field of a config, or of either half of a split."""
    groups = field.split(".")
    if isinstance(config, tuple):
        return functools.reduce(getattr, groups, config)
    return functools.reduce(lambda node, key: node[key], groups, config)


def leaves(config, prefix=""):
    """`{dotted field: value}`."""
    out = {}
    for name, value in config.items():
        if isinstance(value, (config_dict.ConfigDict, config_dict.FrozenConfigDict)):
            out |= leaves(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


def refused(function, *words):
    """The one line with which `function` refuses; it must hold every one of `words`."""
    with pytest.raises(ConfigError) as caught:
        function()
    message = str(caught.value)
    assert "\n" not in message and message
    for word in words:
        assert word in message
    return message


# files and variants


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("file", sorted(p.name for p in (ROOT / "configs").glob("*.py")))
def test_every_variant_of_every_config_file_is_valid(file, variant):
    config = config_lib.load(f"configs/{file}" + (f":{variant}" if variant else ""))
    frozen = config_lib.validate(config)
    assert isinstance(frozen, config_dict.FrozenConfigDict)
    static, hyper = config_lib.split(frozen)
    assert static.robot == frozen.robot
    json.loads(config_lib.to_json(frozen))


@pytest.mark.parametrize("robot", ["default", "go1", "go2", "anymal_c", "anymal_d"])
def test_no_variant_means_best(robot):
    bare = config_lib.to_json(load("", robot))
    assert (
        bare == config_lib.to_json(load("best", robot)) != config_lib.to_json(load("dyna4", robot))
    )


@pytest.mark.parametrize(
    ("variant", "expected"),
    [
        ("ppo12", (12, 0, 0, 0, 0)),
        ("ppo16", (16, 0, 0, 0, 0)),
        ("dyna2", (16, 0, 0, 2, 2)),
        ("dyna4_noschedule", (16, 0, 0, 4, 4)),
        ("dyna4", (16, 0, 100, 0, 4)),
    ],
)
def test_the_papers_variants_differ_in_horizon_and_schedule_only(variant, expected):
    fields = "rollout.horizon schedule.start_iteration schedule.end_iteration"
    fields = f"{fields} schedule.start_steps schedule.end_steps".split()
    config = load(variant)
    assert tuple(get(config, field) for field in fields) == expected
    theirs, ours = leaves(load()), leaves(config)
    assert {name for name in ours if ours[name] != theirs[name]} <= set(fields)
    assert config.model.epochs == 25 and config.model.precision == "highest"


def test_package_configs_load_from_any_working_directory(monkeypatch, tmp_path):
    expected = config_lib.to_json(load("dyna2"))
    monkeypatch.chdir(tmp_path)
    assert config_lib.to_json(load("dyna2")) == expected
    config_lib.validate(load())  # finds the robot too


def test_a_file_in_the_working_directory_comes_before_the_packages_own(monkeypatch, tmp_path):
    (tmp_path / "configs").mkdir()
    text = "import runpy\n"
    text += f"d = runpy.run_path({str(ROOT / 'configs' / 'default.py')!r})\n"
    text += "def get_config(variant=''):\n    c = d['defaults']()\n    c.run.seed = 77\n"
    (tmp_path / "configs" / "go1.py").write_text(text + "    return c\n")
    monkeypatch.chdir(tmp_path)
    assert load().run.seed == 77


def test_a_missing_file_is_refused_by_name():
    refused(lambda: config_lib.load("configs/nobody.py"), "--config", "configs/nobody.py")
    refused(lambda: config_lib.load(""), "--config")
    refused(lambda: config_lib.load("configs"), "--config")


def test_an_unknown_variant_is_refused_with_those_there_are():
    refused(lambda: load("dyna3"), "go1.py:dyna3", "'dyna3'", *VARIANTS[1:])


def test_a_file_without_get_config_is_refused(tmp_path):
    (tmp_path / "empty.py").write_text("x = 1\n")
    refused(lambda: config_lib.load(str(tmp_path / "empty.py")), "empty.py", "get_config")


def test_loading_and_validating_does_not_import_jax():
    code = """
import sys
from dynappo import config, schedule
c = config.load("configs/go1.py:dyna4")
config.override(c, "ppo.clip_epsilon", "0.3")
config.split(config.validate(c))
schedule.columns(c)
assert not {"jax", "flax", "mujoco", "optax"} & set(sys.modules), sorted(sys.modules)
"""
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    subprocess.run(
        [sys.executable, "-c", code], check=True, timeout=120, env=os.environ | {"PYTHONPATH": path}
    )


# overriding a field from the command line


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        ("ppo.clip_epsilon", "0.3", 0.3),
        ("ppo.learning_rate", "3e-4", 3e-4),
        ("ppo.clip_epsilon", "1", 1.0),  # a float stays a float
        ("task.weights.action_rate", "-1", -1.0),
        ("run.seed", "7", 7),
        ("run.seed", "-7", -7),
        ("ppo.adaptive", "False", False),
        ("robot", "go2", "go2"),
        ("run.device", "cpu", "cpu"),
        ("ppo.hidden", "(64, 32)", (64, 32)),
        ("ppo.hidden", "[64]", (64,)),
        ("task.command_x", "(0, 1)", (0.0, 1.0)),
        ("task.command_x", "-0.5,0.5", (-0.5, 0.5)),
        ("task.randomize.base_com", "(1, 2, 3)", (1.0, 2.0, 3.0)),
        ("task.tracking_std", "0.7", 0.7),
        ("task.tracking_std", "1", 1.0),
        ("task.air_time", "indicator", "indicator"),
        ("model.late_epochs", "5", 5),
    ],
)
def test_an_override_has_the_value_and_the_type_of_the_field(field, text, value):
    config = load()
    config_lib.override(config, field, text)
    found = get(config, field)
    assert found == value and type(found) is type(value)
    if isinstance(value, tuple):
        assert [type(x) for x in found] == [type(x) for x in value]
    config_lib.split(config_lib.validate(config))


@pytest.mark.parametrize(
    ("field", "suggestion"),
    [
        ("ppo.clip_epsilom", "ppo.clip_epsilon"),
        ("ppo.learningrate", "ppo.learning_rate"),
        ("rollout.num_env", "rollout.num_envs"),
        ("task.weights.action_rat", "task.weights.action_rate"),
        ("ppoo.gamma", "ppo.gamma"),
        ("gamma", "ppo.gamma"),
        ("robot.name", "robot"),
    ],
)
def test_an_unknown_field_is_refused_with_the_nearest_one_there_is(field, suggestion):
    before = config_lib.to_json(load())
    config = load()
    message = refused(lambda: config_lib.override(config, field, "1"), f"--config.{field}")
    assert message.endswith(f"did you mean {suggestion}?")
    assert config_lib.to_json(config) == before


def test_an_unknown_field_like_no_other_is_refused_with_the_file_that_lists_all():
    refused(lambda: config_lib.override(load(), "zzzz", "1"), "--config.zzzz", "default.py")


@pytest.mark.parametrize("group", ["ppo", "task", "task.weights"])
def test_a_group_in_place_of_a_field_is_refused_with_its_fields(group):
    message = refused(lambda: config_lib.override(load(), group, "1"), f"--config.{group}", "group")
    assert all(name in message for name in get(load(), group))


@pytest.mark.parametrize(
    ("field", "text", "kind"),
    [
        ("run.seed", "1.5", "int"),
        ("run.seed", "one", "int"),
        ("run.seed", "True", "int"),
        ("run.seed", "", "int"),
        ("ppo.clip_epsilon", "small", "float"),
        ("ppo.clip_epsilon", "nan", "float"),
        ("ppo.clip_epsilon", "True", "float"),
        ("ppo.clip_epsilon", "(0.1,)", "float"),
        ("ppo.adaptive", "1", "bool"),
        ("ppo.adaptive", "true", "bool"),
        ("ppo.hidden", "64", "tuple"),
        ("ppo.hidden", "(64", "tuple"),
        ("task.command_x", "1.0", "tuple"),
        ("model.late_epochs", "5.0", "int"),
        ("task.tracking_std", "wide", "float"),
    ],
)
def test_a_value_of_another_type_is_refused_with_the_type_expected(field, text, kind):
    config = load()
    before = config_lib.to_json(config)
    refused(
        lambda: config_lib.override(config, field, text),
        f"--config.{field}={text!r}",
        f"expected {kind}",
    )
    assert config_lib.to_json(config) == before


@pytest.mark.parametrize(
    ("field", "text"),
    [
        ("task.command_x", "(1, 2, 3)"),  # three bounds
        ("task.command_x", "('low', 'high')"),
        ("task.command_x", "(None, 1)"),
        ("task.randomize.base_com", "(0, 0)"),
        ("ppo.hidden", "(64.5, 64)"),
        ("ppo.hidden", "('wide',)"),
        ("ppo.hidden", "()"),
        ("ppo.hidden", "(0, 64)"),
    ],
)
def test_a_tuple_of_another_length_or_of_other_elements_is_refused(field, text):
    config = load()

    def use():
        config_lib.override(config, field, text)
        config_lib.validate(config)

    refused(use, field)


# validation


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"rollout.num_envs": 4090}, ("rollout.num_envs", "4090", "ppo.shuffle_blocks = 8")),
        ({"ppo.shuffle_blocks": 3}, ("rollout.num_envs", "4096", "ppo.shuffle_blocks = 3")),
        (
            {"rollout.num_envs": 8, "rollout.horizon": 15, "schedule.end_steps": 0},
            ("rollout.num_envs x rollout.horizon", "is 15,", "ppo.minibatches = 4"),
        ),
        ({"ppo.minibatches": 3}, ("rollout.horizon", "is 8192,", "ppo.minibatches = 3")),
        ({"model.minibatches": 3}, ("rollout.horizon is 16", "model.minibatches = 3")),
        ({"schedule.end_steps": 16}, ("schedule.end_steps is 16", "rollout.horizon = 16")),
        ({"schedule.end_steps": 40}, ("schedule.end_steps is 40", "rollout.horizon = 16")),
        ({"schedule.end_steps": -1}, ("schedule.start_steps, end_steps", "0, -1", "0 or more")),
        ({"schedule.start_steps": -1}, ("schedule.start_steps, end_steps", "-1, 4")),
        ({"schedule.start_steps": 5}, ("schedule.end_steps is 4", "schedule.start_steps = 5")),
        (
            {"schedule.start_iteration": 101},
            ("schedule.end_iteration is 100", "schedule.start_iteration = 101"),
        ),
        (
            {"schedule.end_steps": 13, "schedule.end_iteration": 100},
            ("model.minibatches is 4", "4 rows of", "3 real rows", "schedule.end_steps"),
        ),
        ({"run.num_seeds": 3, "run.mesh_seed": 2}, ("run.num_seeds is 3", "run.mesh_seed = 2")),
        ({"run.mesh_env": 16}, ("ppo.shuffle_blocks is 8", "run.mesh_env = 16")),
        ({"run.mesh_env": 8, "run.eval_envs": 12}, ("run.eval_envs is 12", "run.mesh_env = 8")),
        ({"run.mesh_env": 0}, ("run.mesh_env is 0", "more than 0")),
        ({"robot": "go9"}, ("robot is 'go9'", "go1", "go2", "anymal_c", "anymal_d")),
        ({"robot": ""}, ("robot is ''", "go1")),
        ({"run.checkpoint_every": 15}, ("run.checkpoint_every is 15", "run.log_every = 10")),
        ({"run.checkpoint_every": -10}, ("run.checkpoint_every is -10",)),
        ({"run.eval_every": 5}, ("run.eval_every is 5", "run.log_every = 10")),
        ({"run.eval_every": -1}, ("run.eval_every is -1",)),
        ({"run.num_iterations": 505}, ("run.num_iterations is 505", "run.log_every = 10")),
        ({"run.log_every": 0}, ("run.log_every is 0", "more than 0")),
        ({"run.num_iterations": 0}, ("more than 0",)),
        ({"rollout.num_envs": 0}, ("rollout.num_envs is 0", "more than 0")),
        ({"model.epochs": -2}, ("model.epochs is -2", "more than 0")),
        ({"ppo.learning_rate": 0.0}, ("ppo.learning_rate is 0.0", "more than 0")),
        ({"ppo.min_std": -0.1}, ("ppo.min_std is -0.1", "more than 0")),
        ({"task.tracking_std": -1.0}, ("task.tracking_std is -1.0", "more than 0")),
        ({"ppo.gamma": math.nan}, ("ppo.gamma is nan", "number")),
        ({"ppo.learning_rate": math.nan}, ("ppo.learning_rate is nan",)),
        ({"task.weights.action_rate": math.nan}, ("task.weights.action_rate is nan",)),
        ({"task.command_x": (1.0, -1.0)}, ("task.command_x is (1.0, -1.0)", "low <= high")),
        ({"task.randomize.friction": (0.9, 0.8)}, ("task.randomize.friction is (0.9, 0.8)",)),
        ({"physics.impl": "cuda"}, ("physics.impl is 'cuda'", "auto, jax, warp")),
        ({"physics.contacts": "all"}, ("physics.contacts is 'all'", "feet, full")),
        ({"run.device": "tpu"}, ("run.device is 'tpu'", "auto, cpu, gpu")),
        ({"task.formulation": "mine"}, ("task.formulation is 'mine'", "isaaclab, paper_text")),
        ({"task.air_time": "long"}, ("task.air_time is 'long'", "touchdown, indicator")),
        ({"model.precision": "float64"}, ("model.precision is 'float64'", "highest, tf32, bfloat")),
        ({"ppo.precision": "float16"}, ("ppo.precision is 'float16'", "highest, tf32, bfloat16")),
        ({"model.activation": "gelu"}, ("model.activation is 'gelu'", "elu, relu, tanh, swish")),
        ({"ppo.activation": "ELU"}, ("ppo.activation is 'ELU'", "elu, relu, tanh, swish")),
    ],
    ids=lambda x: ",".join(f"{k}={v}" for k, v in x.items()) if isinstance(x, dict) else "",
)
def test_a_setting_that_cannot_run_is_refused_with_the_field_what_was_found_and_expected(
    fields, words
):
    config = load()
    for field, value in (BASE | fields).items():
        put(config, field, value)
    refused(lambda: config_lib.validate(config), "expected", *words)


@pytest.mark.parametrize(
    "fields",
    [
        {"task.command_x": (math.nan, 1.0)},
        {"ppo.learning_rate": math.inf},
        {"task.command_x": (0.0, math.inf)},
        {"model.late_epochs": -1},
    ],
    ids=str,
)
def test_numbers_that_no_run_can_have_are_refused(fields):
    config = load()
    for field, value in (BASE | fields).items():
        put(config, field, value)
    refused(lambda: config_lib.validate(config), *fields)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"model.private": True}, ("model.private is True", "model.clean=True")),
        (
            {"model.history": 2, "model.unroll": 3},
            ("model.history is 2", "expected 0", "model.unroll = 3"),
        ),
        (
            {"ppo.first_order_steps": 4, "schedule.end_steps": 0},
            ("ppo.first_order_steps is 4", "expected 0", "schedule.end_steps = 0"),
        ),
        ({"ppo.first_order_steps": -1}, ("ppo.first_order_steps is -1", "expected 0 or more")),
        ({"model.history": -1}, ("model.history is -1", "expected 0 or more")),
        ({"schedule.max_error": 0.0}, ("schedule.max_error is 0.0", "expected more than 0")),
    ],
    ids=str,
)
def test_ideas_for_a_tail_that_cannot_go_together_are_refused(fields, words):
    config = load()
    for field, value in (BASE | fields).items():
        put(config, field, value)
    refused(lambda: config_lib.validate(config), *words)
    for field, value in {"model.clean": True, "model.unroll": 1, "schedule.end_steps": 4}.items():
        put(config, field, value)
    if not any(value in (-1, 0.0) for value in fields.values()):
        config_lib.validate(config)


def test_whole_numbers_in_a_tuple_of_floats_of_a_config_file_are_floats_or_refused():
    config = load()
    config.task.command_x = (0, 1)
    try:
        static, hyper = config_lib.split(config_lib.validate(config))
    except ConfigError:
        return
    assert hyper.task.command_x == (0.0, 1.0) and not hasattr(static.task, "command_x")


@pytest.mark.parametrize(
    "fields",
    [
        {"schedule.end_steps": 15, "model.minibatches": 16},  # one real row is enough
        {"schedule.end_steps": 0, "model.minibatches": 3},  # no model: its sizes do not matter
        {"schedule.start_iteration": 100},  # a ramp of no length
        {"run.checkpoint_every": 0, "run.eval_every": 0},
        {"run.checkpoint_every": 1001},  # beyond the run: only the last
        {"task.command_x": (0.5, 0.5)},  # a collapsed range
        {"run.num_iterations": 7, "run.log_every": 7, "run.checkpoint_every": 7},
    ],
    ids=str,
)
def test_settings_at_the_edge_of_what_can_run_are_accepted(fields):
    config = load()
    for field, value in (BASE | fields).items():
        put(config, field, value)
    config_lib.validate(config)


def test_a_run_shorter_than_log_every_is_one_chunk():
    config = load()
    config.run.num_iterations = 3
    assert config_lib.validate(config).run.log_every == 3


def test_a_validated_config_cannot_be_changed():
    with pytest.raises(AttributeError):
        config_lib.validate(load()).run.seed = 1


def test_validation_leaves_the_config_it_is_given_alone():
    config = load()
    before = config_lib.to_json(config)
    config_lib.validate(config)
    assert config_lib.to_json(config) == before
    config.task.formulation = "paper_text"  # not frozen at what the first validation chose
    assert config_lib.validate(config).task.tracking_std == 1.0


@pytest.mark.parametrize(
    ("formulation", "std", "air_time"),
    [("isaaclab", 0.5, "touchdown"), ("paper_text", 1.0, "indicator")],
)
def test_fields_left_open_are_what_the_formulation_says_and_set_ones_stay(
    formulation, std, air_time
):
    config = load()
    config.task.formulation = formulation
    task = config_lib.validate(config).task
    assert (task.tracking_std, task.air_time) == (std, air_time)
    config.task.tracking_std = 0.3
    task = config_lib.validate(config).task
    assert (task.tracking_std, task.air_time) == (0.3, air_time)
    config.task.air_time = "touchdown"
    assert config_lib.validate(config).task.air_time == "touchdown"


def test_where_only_the_base_falls_all_contacts_are_needed():
    config = load()
    config.task.formulation = "isaaclab_exact"
    with pytest.raises(config_lib.ConfigError, match=r"physics\.contacts is feet, expected full"):
        config_lib.validate(config)
    config.physics.contacts = "full"
    task = config_lib.validate(config).task
    assert (task.heading, task.resample_steps, task.standing) == (True, 500, 0.02)
    assert (task.termination, task.undesired, task.air_time) == ("base", "thighs", "touchdown")
    assert task.tracking_std == 0.5 and task.remember_ground
    config.task.update(heading=False, termination="parts")  # each decision alone
    config.physics.contacts = "feet"
    task = config_lib.validate(config).task
    assert (task.heading, task.resample_steps, task.termination) == (False, 500, "parts")


def test_validation_can_be_repeated():
    once = config_lib.validate(load())
    assert config_lib.to_json(config_lib.validate(once)) == config_lib.to_json(once)


# types, and what is compiled


def test_the_default_of_every_field_has_exactly_its_documented_type():
    found = leaves(load())
    named = {*INTS, *STRINGS, *BOOLS, *SIZES, *OPTIONAL}
    assert named <= found.keys(), named - found.keys()
    for field, value in found.items():
        if field in OPTIONAL:
            group, _, leaf = field.rpartition(".")
            assert value is None and get(load(), group).get_type(leaf) is OPTIONAL[field], field
        elif field in SIZES:
            assert type(value) is tuple and {type(x) for x in value} == {int}, field
        elif field in named:
            kind = int if field in INTS else str if field in STRINGS else bool
            assert type(value) is kind, field
        elif isinstance(value, tuple):  # `1` in place of `1.0` would compile it in
            assert {type(x) for x in value} == {float}, field
        else:
            assert type(value) is float, field


@pytest.mark.parametrize("robot", sorted(p.stem for p in (ROOT / "configs").glob("*.py")))
def test_every_config_file_and_variant_keeps_the_types_of_the_defaults(robot):
    defaults = leaves(load(robot="default"))
    for variant in VARIANTS:
        found = leaves(load(variant, robot))
        assert found.keys() == defaults.keys()
        for field, value in found.items():
            expected = defaults[field]
            if expected is None:
                assert value is None or type(value) is OPTIONAL[field], field
            else:
                assert type(value) is type(expected), field
            if isinstance(expected, tuple):
                assert {type(x) for x in value} == {type(x) for x in expected}, field


def fields_of(half, prefix=""):
    """`{dotted field: value}` of one half of a split."""
    out = {}
    for name, value in half._asdict().items():
        if hasattr(value, "_asdict"):
            out |= fields_of(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


def test_a_split_puts_every_float_in_hyper_and_everything_else_in_static():
    config = config_lib.validate(load("fast"))
    static, hyper = (fields_of(half) for half in config_lib.split(config))
    assert not static.keys() & hyper.keys()
    assert static | hyper == leaves(config)
    for field, value in hyper.items():
        for x in value if isinstance(value, tuple) else (value,):
            assert type(x) is float, field
    assert {*INTS, *STRINGS, *BOOLS, *SIZES, *OPTIONAL} - {
        "task.tracking_std",
        "task.standing",
    } == set(static)


def test_equal_configs_have_equal_static_parts_with_equal_hashes():
    (one, _), (two, _) = (config_lib.split(config_lib.validate(load())) for _ in range(2))
    assert one == two and hash(one) == hash(two) and type(one) is type(two)
    assert one.ppo == two.ppo and hash(one.ppo) == hash(two.ppo)


def test_a_changed_float_changes_no_static_part_and_no_tree_structure():
    config = load()
    static, hyper = config_lib.split(config_lib.validate(config))
    for field, value in leaves(config).items():
        if type(value) is float and value > 0:
            put(config, field, 1.01 * value)
    config.task.command_x = (0.25, 0.75)
    config.task.tracking_std = 0.9
    other_static, other_hyper = config_lib.split(config_lib.validate(config))
    assert other_static == static and hash(other_static) == hash(static)
    assert jax.tree.structure(other_hyper) == jax.tree.structure(hyper)
    assert other_hyper != hyper
    assert all(type(leaf) is float for leaf in jax.tree.leaves(other_hyper))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("ppo.hidden", (64,)),
        ("run.seed", 1),
        ("ppo.adaptive", False),
        ("task.air_time", "indicator"),
        ("model.late_epochs", 3),
    ],
)
def test_a_changed_field_that_is_no_float_changes_the_static_part_only(field, value):
    config = load()
    static, hyper = config_lib.split(config_lib.validate(config))
    put(config, field, value)
    other_static, other_hyper = config_lib.split(config_lib.validate(config))
    assert other_static != static and get(other_static, field) == value
    assert other_hyper == hyper


# config.json


def test_json_holds_every_field_and_its_value():
    config = config_lib.validate(load("quick"))
    tree = json.loads(config_lib.to_json(config))
    for field, value in leaves(config).items():
        found = functools.reduce(lambda node, key: node[key], field.split("."), tree)
        assert found == (list(value) if isinstance(value, tuple) else value), field


def test_the_difference_of_two_configs_is_the_first_field_that_differs_with_both_values():
    old = config_lib.to_json(config_lib.validate(load()))
    config = load()
    config.ppo.epochs = 4
    new = config_lib.to_json(config_lib.validate(config))
    assert config_lib.difference(old, old) == ""
    assert config_lib.difference(old, new) == "ppo.epochs 5 there, 4 here"
    assert "cannot be read" in config_lib.difference("{", new)
    assert "cannot be read" in config_lib.difference("[]", new)
