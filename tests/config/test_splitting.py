"""`static` and `hyper`: floats never reach the compiled program, everything else is part of it."""

import jax
import pytest

from dynappo import config as config_lib

# The type of every field that is neither a float nor a tuple of floats.
INTS = """
run.seed run.num_seeds run.mesh_seed run.mesh_env run.num_iterations run.log_every
run.checkpoint_every run.eval_every run.eval_envs run.eval_steps rollout.num_envs rollout.horizon
schedule.start_iteration schedule.end_iteration schedule.start_steps schedule.end_steps schedule.rounds
model.epochs
model.late_from model.minibatches ppo.epochs ppo.minibatches ppo.shuffle_blocks
task.episode_length task.history physics.threads physics.substeps physics.iterations physics.ls_iterations
""".split()
STRINGS = """
robot run.device run.wandb model.activation model.precision ppo.activation ppo.precision task.formulation
physics.impl physics.contacts task.observation task.actuator ppo.critic
""".split()
BOOLS = """
run.tensorboard model.predict_change model.normalize model.clean model.known_reward model.falls
ppo.adaptive ppo.clip_value ppo.symmetry task.random_clock task.carry_on
""".split()
SIZES = "model.hidden ppo.hidden".split()
OPTIONAL = {  # None in the file
    "task.tracking_std": float,
    "task.air_time": str,
    "task.heading": bool,
    "task.resample_steps": int,
    "task.standing": float,
    "task.termination": str,
    "task.undesired": str,
    "task.remember_ground": bool,
    "model.late_epochs": int,
    "schedule.last_iteration": int,
    "schedule.late_from": int,
    "schedule.late_steps": int,
    "schedule.late_rounds": int,
}


def load(variant="dyna4"):
    return config_lib.load(f"configs/go1.py:{variant}")


def split(config):
    return config_lib.split(config_lib.validate(config))


def fields_of(half, prefix=""):
    """`{dotted field: value}` of one half of a split."""
    out = {}
    for name, value in half._asdict().items():
        if hasattr(value, "_asdict"):
            out |= fields_of(value, f"{prefix}{name}.")
        else:
            out[prefix + name] = value
    return out


def test_the_default_of_every_field_has_exactly_its_type():
    """An int default where a float is meant would be compiled in."""
    kinds = dict.fromkeys(INTS, int) | dict.fromkeys(STRINGS, str) | dict.fromkeys(BOOLS, bool)
    found = config_lib.flat(load())
    assert kinds.keys() | OPTIONAL.keys() | set(SIZES) <= found.keys()
    for field, value in found.items():
        if field in OPTIONAL:
            group, _, leaf = field.rpartition(".")
            assert value is None and load()[group].get_type(leaf) is OPTIONAL[field], field
        elif isinstance(value, tuple):
            assert {type(x) for x in value} == {int if field in SIZES else float}, field
        else:
            assert type(value) is kinds.get(field, float), field


def test_every_float_is_in_hyper_and_everything_else_in_static():
    config = config_lib.validate(load("fast"))
    static, hyper = (fields_of(half) for half in config_lib.split(config))
    assert not static.keys() & hyper.keys() and static | hyper == config_lib.flat(config)
    floats = {name for name, kind in OPTIONAL.items() if kind is float}
    assert static.keys() == {*INTS, *STRINGS, *BOOLS, *SIZES, *OPTIONAL} - floats


def test_equal_configs_have_equal_static_parts_with_equal_hashes():
    (one, _), (two, _) = (split(load()) for _ in range(2))
    assert one == two and hash(one) == hash(two) and type(one) is type(two)
    assert one.ppo == two.ppo and hash(one.ppo) == hash(two.ppo)


def test_a_changed_float_changes_no_static_part_and_no_tree_structure():
    """So no learning rate, and no sweep over it, compiles anything anew."""
    config = load()
    static, hyper = split(config)
    for field, value in config_lib.flat(config).items():
        if type(value) is float and value > 0:
            config_lib.override(config, field, repr(0.99 * value))
    config.task.command_x = (0.25, 0.75)
    config.task.tracking_std = 0.9
    other_static, other_hyper = split(config)
    assert other_static == static and hash(other_static) == hash(static)
    assert jax.tree.structure(other_hyper) == jax.tree.structure(hyper) and other_hyper != hyper
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
    static, hyper = split(config)
    group, _, leaf = field.partition(".")
    config[group][leaf] = value
    other_static, other_hyper = split(config)
    assert other_static != static and fields_of(other_static)[field] == value
    assert other_hyper == hyper
