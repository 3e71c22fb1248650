"""The combinations of a sweep: how they are read, checked, named and put together."""

import pytest
from answers import refused

from dynappo import config as config_lib
from dynappo.sweeps import grid


@pytest.fixture
def config():
    return config_lib.load("configs/go1.py:dyna4")


def names(config, *texts):
    return [one.name for one in grid.combinations(config, grid.read(list(texts)))]


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("ppo.epochs=3,5", ["3", "5"]),
        ("config.ppo.epochs=3", ["3"]),
        ("ppo.hidden=(64,64),(128,)", ["(64,64)", "(128,)"]),
        ("ppo.hidden=[64,64],[128]", ["[64,64]", "[128]"]),
        ("task.command_x=(-1.0,1.0), (0,1)", ["(-1.0,1.0)", "(0,1)"]),
        ("ppo.activation=elu,swish", ["elu", "swish"]),
    ],
)
def test_commas_part_values_but_not_inside_of_brackets(text, values):
    assert list(grid.read([text]).values()) == [values]


def test_a_grid_has_every_combination_and_the_values_of_flags(config):
    """As nested loops make it; each config is that of the same fields given as flags."""
    found = grid.combinations(config, grid.read(["ppo.entropy_coef=3e-3,1", "ppo.epochs=3,5"]))
    expected = []
    for coef in (0.003, 1.0):
        for epochs in (3, 5):
            own = config_lib.load("configs/go1.py:dyna4")
            own.ppo.entropy_coef, own.ppo.epochs = coef, epochs
            expected.append((coef, epochs, config_lib.validate(own)))
    assert [(*one.values.values(), one.config) for one in found] == expected
    assert found[0].name == "ppo.entropy_coef=0.003,ppo.epochs=3"
    assert config.ppo.epochs == config_lib.load("configs/go1.py:dyna4").ppo.epochs  # not changed


def test_a_folder_has_a_name_that_needs_no_quotes(config):
    found = names(config, "ppo.hidden=(64,64),(128,)", "task.command_x=(-1,1)")
    assert found == [
        "ppo.hidden=64x64,task.command_x=-1.0x1.0",
        "ppo.hidden=128,task.command_x=-1.0x1.0",
    ]


@pytest.mark.parametrize(
    ("texts", "expected"),
    [
        (["ppo.epochs"], "--sweep=ppo.epochs: expected FIELD=VALUE,VALUE,..."),
        (["ppo.epochs=3,,5"], "a value is empty"),
        (["ppo.epochs="], "a value is empty"),
        (["ppo.epohs=3,5"], "--sweep=ppo.epohs: no such field; did you mean ppo.epochs?"),
        (["ppo=3,5"], "--sweep=ppo is a group"),
        (["ppo.epochs=3,x"], "--sweep=ppo.epochs='x': expected int"),
        (
            ["ppo.epochs=3,0"],
            "ppo.epochs is 0, expected 1 to 10,000 (the combination ppo.epochs=0)",
        ),
        (["ppo.entropy_coef=0.01,1e-2"], "ppo.entropy_coef=0.01 appears twice"),
        (["ppo.epochs=3", "ppo.epochs=5"], "ppo.epochs is swept twice"),
        (["ppo.hidden=64,64"], "--sweep=ppo.hidden='64': expected tuple"),
        (["run.device=cpu,gpu"], "run.device cannot be swept"),
        (["run.seed=0,1"], "for seeds use --config.run.num_seeds=2"),
        (["config.run.num_seeds=1,2"], "for seeds use --config.run.num_seeds=2"),
        (["run.wandb=a,b"], "does not log to Weights & Biases"),
        (
            ["run.num_iterations=" + ",".join(map(str, range(1001)))],
            "1,001 combinations, expected at most",
        ),
        ([f"ppo.hidden=({'8,' * 120})"], "sweep fewer fields at once"),
    ],
)
def test_a_wrong_sweep_is_one_line(config, texts, expected):
    assert expected in refused(lambda: names(config, *texts))


@pytest.mark.parametrize(
    ("field", "vmap", "own"),
    [
        ("ppo.entropy_coef", True, True),
        ("model.learning_rate", True, True),
        ("task.weights.action_rate", True, False),
        ("task.tracking_std", True, False),  # None until it is set
        ("task.command_x", True, False),
        ("task.randomize.friction", False, False),  # says which bodies differ
        ("physics.timestep", False, False),
        ("run.video_seconds", False, False),
        ("ppo.epochs", False, False),
        ("ppo.hidden", False, False),
        ("ppo.adaptive", False, False),
        ("ppo.activation", False, False),
        ("schedule.last_iteration", False, False),
    ],
)
def test_floats_of_the_method_and_the_task_share_a_program(field, vmap, own):
    """With an environment of one's own only those that it cannot read."""
    assert (grid.by_vmap(field), grid.by_vmap(field, True)) == (vmap, own)


def test_a_group_differs_in_floats_alone_and_has_come_as_far(config):
    texts = ["ppo.epochs=3,5", "ppo.entropy_coef=0.1,0.2,0.3"]
    found = grid.combinations(config, grid.read(texts))
    groups = grid.groups(found, [0, 0, 0, 0, 10, 0])
    assert [[found.index(one) for one in group] for group in groups] == [[0, 1, 2], [3, 5], [4]]


def test_a_number_that_is_none_in_one_is_in_no_program_with_those_that_have_it(config):
    """Its term, or its rule, is part of the program."""
    found = grid.combinations(config, grid.read(["task.max_tilt=1.0,1.2"]))
    found += [found[0]._replace(name="plain", config=config_lib.validate(config))]
    groups = grid.groups(found, [0, 0, 0])
    assert [[found.index(one) for one in group] for group in groups] == [[0, 1], [2]]
