"""Config files and the command line: values with the type of their field, mistakes in one line."""

import functools
import json
import re

import pytest
from answers import ROOT, refused

from dynappo import config as config_lib
from dynappo.config import flags, loading
from dynappo.run import workdir as workdir_lib
from dynappo.tasks import names


def load(variant="dyna4", robot="go1"):
    """The config of one of the package's files."""
    return config_lib.load(f"configs/{robot}.py" + (f":{variant}" if variant else ""))


def get(config, field):
    """The value of a dotted field."""
    return functools.reduce(lambda node, key: node[key], field.split("."), config)


# ---- files and variants


def test_no_variant_is_best():
    texts = [config_lib.to_json(load(variant)) for variant in ("", "best", "dyna4")]
    assert texts[0] == texts[1] != texts[2]


@pytest.mark.parametrize("variant", ["", ":ppo16"])
def test_a_name_means_its_file_in_configs(variant):
    by_name, by_path = (config_lib.load(f"{n}{variant}") for n in ("go2", "configs/go2.py"))
    assert config_lib.to_json(by_name) == config_lib.to_json(by_path)


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
    ours, theirs = config_lib.flat(config), config_lib.flat(load())
    assert {name for name in ours if ours[name] != theirs[name]} <= set(fields)
    assert config.model.epochs == 25 and config.model.precision == "highest"


def test_the_packages_files_are_found_from_anywhere_and_ones_own_come_first(monkeypatch, tmp_path):
    expected = config_lib.to_json(load("dyna2"))
    monkeypatch.chdir(tmp_path)
    for spec in ("configs/go1.py:dyna2", "go1.py:dyna2", "./go1.py:dyna2"):
        assert config_lib.to_json(config_lib.load(spec)) == expected
    config_lib.validate(load())  # finds the robot too
    (tmp_path / "configs").mkdir()
    text = "import runpy\n"
    text += f"d = runpy.run_path({str(ROOT / 'configs' / 'default.py')!r})\n"
    text += "def get_config(variant=''):\n    c = d['defaults']()\n    c.run.seed = 77\n"
    (tmp_path / "configs" / "go1.py").write_text(text + "    return c\n")
    assert load().run.seed == 77


BAD_FILES = {  # text of mine.py, what the line must say beside its name
    "no get_config": ("x = 1\n", "get_config"),
    "syntax error": ("def get_config(variant\n    return 1\n", "line 1"),
    "error at import": ("import no_such_package\n", "no_such_package"),
    "missing key": ('def get_config(variant=""):\n    return {}["speed"]\n', "speed"),
    "no variant": ("def get_config():\n    return 1\n", "get_config"),
    "a dict": ('def get_config(variant=""):\n    return {"robot": "go1"}\n', "returns dict"),
    "ends Python": ("import sys\nsys.exit(0)\n", "SystemExit: 0"),
    "not text": ("\0", "null bytes"),
    "two lines": ('def get_config(variant=""):\n    raise ValueError("a\\nb")\n', "a b"),
    "fields missing": (
        "from ml_collections import config_dict\n\n\n"
        'def get_config(variant=""):\n    return config_dict.create(robot="go1")\n',
        "start from configs/default.py",
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_a_file_that_cannot_be_used_is_refused_by_name(tmp_path, name):
    text, expected = BAD_FILES[name]
    (tmp_path / "mine.py").write_text(text)
    line = refused(config_lib.load, str(tmp_path / "mine.py"))
    assert "mine.py" in line and expected in line


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (b"x = 1\ndef broken(:\n", "helper.py, line 2: it is no Python ("),
        (b"x = 1\n\0", "helper.py: it is no Python (source code string cannot contain null bytes"),
        (b"# -*- coding: foo -*-\n", "helper.py: it is no Python (unknown encoding: foo"),
    ],
)
def test_a_file_that_get_env_imports_and_that_is_no_python_is_one_line(tmp_path, text, said):
    """It has not been run when its text is compared with that of a run to go on."""
    (tmp_path / "helper.py").write_bytes(text)
    (tmp_path / "mine.py").write_text(
        f"import runpy\nd = runpy.run_path({str(ROOT / 'configs' / 'default.py')!r})\n"
        "def get_config(variant=''): return d['defaults']()\n"
        "def get_env(config):\n    import helper\n"
    )
    assert said in refused(config_lib.load, str(tmp_path / "mine.py"))


@pytest.mark.parametrize("name", ["get_envv", "get_evn", "getenv", "get_environment"])
def test_a_slip_in_the_name_of_get_env_trains_no_robot(tmp_path, name):
    """Without get_env the file is the config of a robot, and would train that; an import may be named so."""
    path = tmp_path / "mine.py"
    text = f"import runpy\nd = runpy.run_path({str(ROOT / 'configs' / 'default.py')!r})\n"
    text += "def get_config(variant=''): return d['defaults']()\nfrom os import getenv\n"
    path.write_text(text)
    assert config_lib.load_both(str(path))[1] is None
    path.write_text(f"{text}def {name}(config): pass\n")
    line = refused(config_lib.load, str(path))
    assert (
        f"mine.py: has a function {name}, but no get_env" in line
        and "did you mean get_env?" in line
    )
    path.write_text(f"{text}def {name}(config): pass\ndef get_env(config): pass\n")
    assert config_lib.load_both(str(path))[1]


def test_a_run_with_a_log_says_which_flag_names_it():
    """Its hash alone would say nothing to the user."""
    plain, logged = config_lib.load("go1:logs"), config_lib.load("go1:logs")
    logged.run.update(logs="/a b/walked.npz", logs_hash="28881d6f")
    plain, logged = config_lib.to_json(plain), config_lib.to_json(logged)
    may = workdir_lib.MAY_CHANGE
    line = config_lib.difference(logged, plain, may)
    assert line == "it learns from the log /a b/walked.npz: give '--logs=/a b/walked.npz'"
    assert config_lib.difference(plain, logged, may) == "it learns from no log: leave --logs out"


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ("configs/nobody.py", "no file 'configs/nobody.py' here or among dynappo's own configs"),
        ("/no/such/dir/go1.py:quick", "no file '/no/such/dir/go1.py'"),  # not dynappo's go1.py
        ("my/configs/go1.py", "no file 'my/configs/go1.py'"),
        ("", "no file ''"),
        ("Go1JoystickFlatTerrain", "did you mean playground:Go1JoystickFlatTerrain?"),
        ("spotgetup:ppo", "did you mean playground:SpotGetup:ppo?"),
        ("ant", "configs; did you mean brax:ant?"),
        ("Go1", "configs; did you mean go1?"),
        ("G1:laptop", "did you mean g1:laptop?"),
        ("goo2:laptop", "did you mean go2:laptop?"),
        ("go1_deploy", "did you mean go1:deploy?"),  # as play names its policy
        ("go1-dploy", "did you mean go1:deploy?"),
        (
            "configs/go1.py:dyna3",
            "configs/go1.py:dyna3: variant 'dyna3' is not one of ppo12, ppo16, dyna2",
        ),
    ],
)
def test_a_file_or_variant_that_is_not_there_is_refused(spec, expected):
    """From Python no flag is named; on a command line that is."""
    line = refused(config_lib.load, spec)
    assert expected in line and "--" not in line
    assert refused(config_lib.load_both, spec).startswith("--config")


@pytest.mark.parametrize("load", [config_lib.load, lambda spec: flags.load(spec, [])])
@pytest.mark.parametrize(
    ("name", "todo"), [("dog.xml", "adopt dog.xml"), ("walk.html", "expected a config in Python")]
)
def test_a_file_that_is_no_python_is_not_run(load, name, todo, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("raise SystemExit('it ran')")
    line = refused(load, name)
    assert f"{name} is no FILE.py" in line and line.endswith(todo)


@pytest.mark.parametrize(
    ("package", "module", "of"),
    [("brax", "envs", "brax"), ("mujoco_playground", "_src.locomotion", "playground")],
)
def test_names_of_other_packages_are_those_that_they_have(package, module, of):
    if known := names.registered(package, module):
        assert {*loading.OF_PACKAGES[of]} == {*known} - names.UNSHOWN


def test_a_field_that_is_none_of_dynappos_is_refused(tmp_path):
    """It would change nothing, and nobody would know."""
    text = f"import runpy\nd = runpy.run_path({str(ROOT / 'configs' / 'go1.py')!r})\n"
    text += "def get_config(variant):\n    c = d['get_config'](variant).unlock()\n"
    (tmp_path / "mine.py").write_text(text + "    c.ppo.epoch = 3\n    return c\n")
    line = refused(config_lib.load, str(tmp_path / "mine.py"))
    assert line.endswith("mine.py: ppo.epoch is not a field; did you mean ppo.epochs?")


# ---- a field of the command line


@pytest.mark.parametrize(
    ("field", "text", "value"),
    [
        ("ppo.clip_epsilon", "0.3", 0.3),
        ("ppo.learning_rate", "3e-4", 3e-4),
        ("ppo.clip_epsilon", "1", 1.0),  # a float stays a float
        ("task.weights.action_rate", "-1", -1.0),
        ("run.seed", "-7", -7),
        ("ppo.adaptive", "False", False),
        ("robot", "go2", "go2"),
        ("ppo.hidden", "(64, 32)", (64, 32)),
        ("ppo.hidden", "[64]", (64,)),
        ("ppo.critic_hidden", "(64, 32)", (64, 32)),  # None in the file, as the next
        ("task.weights.foot_slip", "-1", -1.0),
        ("task.max_tilt", "1", 1.0),
        ("task.command_x", "(0, 1)", (0.0, 1.0)),
        ("task.command_x", "-0.5,0.5", (-0.5, 0.5)),
        ("task.randomize.base_com", "(1, 2, 3)", (1.0, 2.0, 3.0)),
        ("task.tracking_std", "1", 1.0),  # None in the file
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


def test_from_python_a_value_is_set_as_it_is():
    config = load()
    for field, value in (("ppo.gamma", 0.3), ("ppo.hidden", (64, 32)), ("model.late_epochs", None)):
        config_lib.override(config, field, value)
        assert get(config, field) == value
    assert "=1.5: expected int" in refused(config_lib.override, config, "run.seed", 1.5)
    assert "=3: expected str" in refused(config_lib.override, config, "robot", 3)


def test_what_is_no_config_is_refused_with_what_loads_one():
    assert refused(config_lib.validate, "go1").endswith("load returns: config.load('go1')")
    assert "the config is None, expected" in refused(config_lib.validate, None)


BAD_OVERRIDES = [  # field, text, what the line must say
    ("ppo.clip_epsilom", "1", "did you mean ppo.clip_epsilon?"),
    ("ppoo.gamma", "1", "did you mean ppo.gamma?"),
    ("gamma", "1", "did you mean ppo.gamma?"),
    ("robot.name", "1", "did you mean robot?"),
    ("zzzz", "1", "configs/default.py lists all fields"),
    ("schedule", "1", "a group, expected one of anchors, end_iteration, end_steps"),
    ("run.seed", "1.5", "='1.5': expected int"),
    ("run.seed", "True", "='True': expected int"),
    ("ppo.clip_epsilon", "small", "='small': expected float"),
    ("ppo.clip_epsilon", "nan", "expected float"),
    ("ppo.adaptive", "true", "expected bool"),
    ("ppo.hidden", "64", "expected tuple"),
    ("ppo.hidden", "(64.5, 64)", "expected tuple"),
    ("ppo.hidden", "(0, 64)", "expected tuple"),
    ("task.command_x", "1.0", "expected tuple like (-1.0, 1.0)"),
    ("task.command_x", "(1, 2, 3)", "expected tuple"),
    ("model.late_epochs", "5.0", "expected int, or None"),
    ("model.epochs", "None", "expected int"),
    ("task.tracking_std", "wide", "expected float"),
    ("ppo.clip_epsilon", "1" + "0" * 400, "expected float"),  # no float can hold it
    ("run.seed", "-" * 5000 + "1", "expected int"),
    ("ppo.hidden", "{[]: 1}", "expected tuple"),
    ("task.terms_about", "{", "follows from the file that --config.task.terms names"),
    ("task.terms_hash", "0", "follows from the file that --config.task.terms names"),
    ("task.tiles.map_hash", "abc", "follows from the file that --config.task.tiles.map names"),
    ("run.logs_hash", "abc", "follows from the file that --logs names"),
    ("code", "abc", "follows from the config's file with get_env"),
    ("ppo.hidden", "(64, True)", "expected tuple"),
]


@pytest.mark.parametrize(("field", "text", "expected"), BAD_OVERRIDES)
def test_a_wrong_field_or_value_is_refused_and_changes_nothing(field, text, expected):
    config = load()
    before = config_lib.to_json(config)
    line = refused(config_lib.override, config, field, text)
    assert line.startswith(f"--config.{field}") and expected in line
    assert config_lib.to_json(config) == before


def test_a_field_that_is_none_by_default_can_be_none_again():
    config = load("best")
    assert config.schedule.late_from == 60
    config_lib.override(config, "schedule.late_from", "None")
    assert config.schedule.late_from is None
    config_lib.override(config, "schedule.late_from", "100")
    assert config.schedule.late_from == 100


# ---- config.json


def test_json_holds_every_field_and_its_value():
    config = config_lib.validate(load("quick"))
    tree = json.loads(config_lib.to_json(config))
    for field, value in config_lib.flat(config).items():
        assert get(tree, field) == json.loads(json.dumps(value)), field


def test_the_difference_of_two_configs_is_the_first_field_that_differs_with_both_values():
    """A field that only one of them has is none: another version of dynappo wrote the text."""
    old = config_lib.to_json(config_lib.validate(load()))
    config = load()
    config.ppo.epochs = 4
    new = config_lib.to_json(config_lib.validate(config))
    assert config_lib.difference(old, old) == config_lib.difference(old, new, ["ppo.epochs"]) == ""
    assert config_lib.difference(old, new) == "ppo.epochs 5 there, 4 here"
    other = json.loads(old)
    other["ppo"]["epochs_of_before"] = other["gone"] = 3
    assert config_lib.difference(old, json.dumps(other)) == ""
    assert config_lib.difference(json.dumps(other), old) == ""
    for text in ("{", "[]"):
        assert "cannot be read" in config_lib.difference(text, new)


# ---- a run's config.json


@pytest.mark.parametrize("spec", ["go1:best", "anymal_c:laptop", "go2:dyna4"])
def test_a_config_comes_back_from_its_json(spec):
    """Every field, tuples as tuples and floats as floats."""
    config = config_lib.load(spec)
    config.task.command_x = (-1.0, 2.0)
    found = config_lib.from_json(config_lib.to_json(config))
    assert config_lib.flat(found) == config_lib.flat(config)
    kinds = {name: type(value) for name, value in config_lib.flat(config).items()}
    assert {name: type(value) for name, value in config_lib.flat(found).items()} == kinds
    assert config_lib.versions_apart(config_lib.to_json(config), found) == ""


def test_what_another_version_wrote_is_filled_and_told():
    """A field that is new here has its default, one that is gone is left out."""
    text = json.loads(config_lib.to_json(config_lib.load("go1:best")))
    del text["schedule"]["last_iteration"], text["ppo"]["symmetry"]
    text["model"]["bounds"] = True
    found = config_lib.from_json(json.dumps(text))
    assert found.schedule.last_iteration is None and found.ppo.symmetry is False
    line = config_lib.versions_apart(json.dumps(text), found)
    said = {"schedule.last_iteration is new, and None", "ppo.symmetry is new, and False"}
    assert set(line.split(": ", 1)[1].split("; ")) == said | {"model.bounds is gone"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[1", "not the JSON of a config"),
        ("3", "not the JSON of a config"),
        ('{"ppo": {"epochs": "many"}}', "ppo.epochs is 'many', expected int"),
        ('{"ppo": {"epochs": null}}', "ppo.epochs is None, expected int"),
        ('{"task": {"command_x": [1]}}', "task.command_x is [1], expected tuple"),
    ],
)
def test_a_json_that_is_no_config_is_refused(text, said):
    with pytest.raises(config_lib.ConfigError, match=re.escape(said)):
        config_lib.from_json(text)
