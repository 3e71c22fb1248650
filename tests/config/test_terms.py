"""Terms of one's own: their file, the config that names it, and who may make dynappo run it."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from answers import mistake, refused, status

from dynappo import config as config_lib
from dynappo import terms
from dynappo.config import ConfigError, flags
from dynappo.description import robot as robot_lib
from dynappo.evaluate import command as evaluate
from dynappo.evaluate import crossing
from dynappo.export import command as export
from dynappo.play import command as play
from dynappo.policy import policy_file, policy_source
from dynappo.run import workdir as workdir_lib
from dynappo.sweeps import grid
from dynappo.tasks.velocity import observe
from dynappo.train import command as train
from dynappo.web import policies

HEAD = "from dynappo import terms\n\n"
WORK = "@terms.reward(weight=-1e-3, numbers={'share': 0.5})\ndef work(torque, share): return 0.0\n"
SEEN = "@terms.observation(size=1, noise=0.1, signs=(1,))\ndef seen(qpos): return qpos[2:3]\n"
CONFIG = (
    "from dynappo import config\n\ndef get_config(variant=''):\n"
    "    loaded = config.load('go1:laptop')\n    {}\n    return loaded\n"
)
TOUCH = "import pathlib\npathlib.Path('ran').touch()\n"  # what must not run


@pytest.fixture(autouse=True)
def nothing_read(monkeypatch, tmp_path):
    """Each test is a process of its own, in an empty folder."""
    monkeypatch.setattr(terms, "_READ", {})
    monkeypatch.chdir(tmp_path)


def write(text=WORK, name="mine.py"):
    Path(name).write_text(HEAD + text)
    return name


def fields_of(config):
    task = config.task
    return task.weights.get("work"), task.noise.get("seen"), dict(task.own)


def test_a_flag_names_the_file_and_its_fields_are_flags_too():
    given = f"--config.task.terms={write(WORK + SEEN)}"
    config = flags.load("go1:laptop", ["--config.task.weights.work=-2", given])
    assert fields_of(config) == (-2.0, 0.1, {"share": 0.5}) and config.task.terms == "mine.py"
    assert re.fullmatch("[0-9a-f]{16}", config.task.terms_hash)
    assert [each.name for each in observe.own(config.task.terms_about)] == ["seen"]
    again = config_lib.from_json(config_lib.to_json(config_lib.validate(config)))
    assert fields_of(again) == fields_of(config) and terms.of(again.task).rewards.keys() == {"work"}
    said = refused(config_lib.override, config, "task.weights.wok", "2")
    assert said == "--config.task.weights.wok: no such field; did you mean task.weights.work?"
    config_lib.override(config, "task.terms", write(SEEN, "other.py"))
    assert fields_of(config) == (None, 0.1, {}) and config.task.terms == "other.py"
    both = (
        train.parse(["--config=go1:laptop", *more, "--config.task.weights.work=-2"]).config
        for more in ([given], ["--terms=mine.py"])
    )
    assert next(both) == next(both)
    config_lib.override(config, "task.terms", "")
    assert fields_of(config) == (None, None, {}) and not config.task.terms_hash


def test_a_config_file_may_have_terms_or_name_their_file_beside_it():
    Path("folder").mkdir()
    write(WORK + CONFIG.format("loaded.task.weights.work = -3"), "folder/both.py")
    config = config_lib.load("folder/both.py")
    assert fields_of(config) == (-3.0, None, {"share": 0.5}) and config.task.terms == "both.py"
    write(WORK, "folder/mine.py")
    Path("folder/names.py").write_text(CONFIG.format("loaded.task.terms = 'mine.py'"))
    config = config_lib.load("folder/names.py")
    assert fields_of(config) == (-1e-3, None, {"share": 0.5}) and config.task.terms == "mine.py"
    write(WORK + CONFIG.format("loaded.task.terms = 'mine.py'"), "folder/twice.py")
    assert "the file has terms itself (work, ...)" in refused(config_lib.load, "folder/twice.py")
    write(CONFIG.format("loaded.task.weights.works = -3"), "folder/typo.py")
    said = refused(config_lib.load, "folder/typo.py")
    assert "task.weights.works is not a field" in said


def test_a_hash_is_of_the_text_of_every_file_that_terms_come_from():
    def digest():
        return terms.read("mine.py").digest

    write()
    first = digest()
    assert digest() == first and terms.read(Path("mine.py").resolve()).digest == first
    write(WORK + "# a comment\n")
    assert digest() != first
    write(SEEN, "helper.py")
    write("import runpy\nseen = runpy.run_path('helper.py')['seen']\n" + WORK)
    first = digest()
    write(SEEN.replace("0.1", "0.2"), "helper.py")
    assert digest() != first


def test_terms_are_data_in_a_config_and_other_floats_of_it_stay_what_they_were():
    bare, config = (flags.load("go1:laptop", []) for _ in range(2))
    terms.use(config, terms.read(write(WORK + SEEN)))
    text = config_lib.to_json(config_lib.validate(config))
    assert "def " not in text and "return" not in json.loads(text)["task"]["terms_about"]
    static, hyper = config_lib.split(config_lib.validate(config))
    assert hyper.task.weights.work == -1e-3 and hyper.task.own.share == 0.5
    assert not hasattr(config_lib.split(config_lib.validate(bare))[1].task, "own")
    assert static.task.terms == "mine.py"
    values = {"task.weights.work": ["-1", "-2"], "task.own.share": ["0.1", "0.2"]}
    every = grid.combinations(config, values)
    assert len(grid.groups(every, [0] * 4)) == 1 and [
        len(g) for g in grid.groups(every, [0] * 4)
    ] == [4]


MISTAKES = {  # of a file -> a part of the line
    "": "mine.py has no terms",
    "import no_such_module\n": "mine.py cannot be run: ModuleNotFoundError",
    "raise SystemExit(0)\n": "mine.py cannot be run: SystemExit",
    WORK.replace("-1e-3", "float('nan')"): "weight is nan, expected a finite number",
    WORK.replace("0.5", "'half'"): "share is 'half', expected a finite number",
    "@terms.curriculum(start=0.1, evaluated='x')\ndef f(f): return f\n": "evaluated is 'x', expected",
    "@terms.known(start=(float('nan'),))\ndef f(f): return f\n": "start is nan, expected a finite number",
    "@terms.known(start=0.0)\ndef f(f): return f\n": "start is 0.0, expected a tuple of finite numbers",
    "@terms.known(start=())\ndef f(f): return f\n": "start is (), expected a tuple of finite numbers",
    "@terms.termination(timeout='no')\ndef f(height): return height < 0\n": "timeout is 'no', expected True",
    "@terms.termination(timeout=None)\ndef f(height): return height < 0\n": "timeout is None, expected True",
    SEEN.replace("size=1", "size=1, shown='no'"): "shown is 'no', expected True or False",
    SEEN.replace("size=1", "size=1, unit=None"): "unit is None, expected a short text",
    SEEN.replace("size=1", "size=1, unit=b'm'"): "unit is b'm', expected a short text",
    SEEN.replace("size=1", "size=1, scale='2'"): "scale is '2', expected a finite number",
    SEEN.replace("size=1", "size=1, scale=1e9"): "scale is 1e+09, expected a number between -1e9 and 1e9",
    SEEN.replace("size=1", "size=0"): "size is 0, expected an integer above 0",
    SEEN.replace("(1,)", "(1, -1)"): "signs is (1, -1), expected a tuple of 1 times 1 or -1",
    SEEN.replace("(1,)", "(1,), order=(1,)"): "order is (1,), expected a tuple of 0 to 0",
    WORK + SEEN.replace("noise=0.1", "numbers={'share': 1.0}"): "share of the term seen is 1, and 0.5",
    "@terms.command(draws=0)\ndef c(draw): return draw\n": "draws is 0",
    "".join(f"@terms.command(draws=1)\ndef {c}(draw): return draw\n" for c in "cd"): "two commands, c and d",
    WORK + "\n" + WORK.replace("0.5", "1.0"): "two functions work, at line 4 and line 7: the second",
    WORK + "\ndef work(): pass\n" + SEEN: "mine.py has two functions work, at line 4 and line 6",
    SEEN.replace("terms.", "x.").replace("@", "x = terms\n@") * 2: "two functions seen, at line 5 and line 8",
    WORK.replace("torque, share", "torque, share=0.1"): "line 3 has a number share, and no term of the file",
    "@terms.reward(weight=1.0)\nclass Term: pass\n": "the term Term is no function",
    "@terms.reward(-1.0)\ndef f(torque): return 0.0\n": "@terms.reward: too many positional arguments; write",
    "@terms.reward(weights=1.0)\ndef f(torque): return 0.0\n": "'weight'; write @terms.reward(weight=...)",
} | {  # each decorator without its parentheses
    f"@terms.{name}\ndef f(): return 0.0\n": f"write @terms.{name}({needed})"
    for name, needed in dict(
        reward="weight=...", observation="size=...", known="start=...", termination="", command="draws=...",
        curriculum="start=...",
    ).items()
}  # fmt: skip


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_in_the_file_is_one_line_and_nothing_is_written(text, capsys):
    given = f"--config.task.terms={write(text)}"
    said = mistake(train.main, ["--config=go1:laptop", given, "--workdir=run"], capsys)
    assert MISTAKES[text] in said and not Path("run").exists()


def test_other_functions_may_share_a_name_and_a_term_may_ask_for_the_number_of_another():
    helpers = "def helper(): pass\ndef helper(): pass\ndef work(): pass\n"
    asks = SEEN.replace("(qpos)", "(qpos, share)")
    assert terms.read(write(helpers + WORK.replace(", share", "") + asks)).rewards.keys() == {
        "work"
    }


def test_a_scale_may_be_an_integer():
    given = f"--config.task.terms={write(SEEN.replace('size=1', 'size=1, scale=2'))}"
    (seen,) = observe.own(flags.load("go1:laptop", [given]).task.terms_about)
    assert seen.quantity.scale == 2.0


def test_a_file_that_is_not_there_is_one_line(capsys):
    said = mistake(train.main, ["--config=go1", "--config.task.terms=no.py"], capsys)
    assert "task.terms: no file 'no.py'" in said
    config = config_lib.load("go1")
    config.task.terms = "mine.py"  # and nobody has read it
    assert "expected a file that has been read" in refused(config_lib.validate, config)
    config = config_lib.load("brax:ant")
    terms.use(config, terms.read(write()))
    assert "terms are of its velocity task" in refused(config_lib.validate, config)


@pytest.fixture
def saved():
    """A policy that sees a quantity of its own, whose config names a file that must not run; and its file."""
    config = flags.load("go1:laptop", [f"--config.task.terms={write(WORK + SEEN)}"])
    config.ppo.hidden = (2,)
    config = config_lib.validate(config)
    rng = np.random.default_rng(0)
    sizes = {"Dense_0": (49, 2), "Dense_1": (2, 12)}
    layers = {
        name: {"kernel": rng.normal(size=size).astype(np.float32), "bias": np.zeros(size[1], np.float32)}
        for name, size in sizes.items()
    }  # fmt: skip
    robot = robot_lib.load("go1")
    policy_file.save(Path("policy.npz"), {"actor": {"params": layers}}, config, robot)
    shutil.copy("mine.py", "good.py")
    write(TOUCH + WORK + SEEN)
    terms._READ.clear()
    return Path("policy.npz")


def test_a_policy_and_a_workdir_run_no_file_that_is_not_named(saved, capsys):
    for main, words in (
        (play.main, [saved, "--out=w.html", "--seconds=0.1"]),
        (evaluate.main, [saved, "--fast"]),
        (evaluate.main, [saved]),
    ):
        said = mistake(main, words, capsys)
        assert "sees seen: its terms are code in 'mine.py'" in said and "--terms=FILE" in said
    assert status(export.main, saved, "--out=policy.onnx") == 0
    assert status(export.main, saved, "--out=other.npz") == 0
    run = Path("run")
    run.mkdir()
    config = policy_file.load(saved).config
    run.joinpath("config.json").write_text(json.dumps(config))
    capsys.readouterr()
    said = mistake(train.main, [f"--workdir={run}"], capsys)
    assert "--workdir=run: its terms are code in 'mine.py'" in said
    assert not Path("ran").exists() and not Path("w.html").exists()
    assert status(play.main, saved, "--terms=good.py", "--out=w.html", "--seconds=0.1") == 0
    assert not Path("ran").exists() and Path("w.html").exists()
    assert "changed" not in capsys.readouterr().out


def test_a_file_that_has_changed_plays_unless_the_policy_sees_other_numbers(saved, capsys):
    assert status(play.main, saved, "--terms=mine.py", "--out=w.html", "--seconds=0.1") == 0
    assert "with mine.py, which has changed since the training" in capsys.readouterr().out
    write(SEEN.replace("size=1", "size=2").replace("(1,)", "(1, 1)"), "wide.py")
    words = [saved, "--terms=wide.py", "--out=w.html"]
    assert "or of other sizes" in mistake(play.main, words, capsys)
    said = mistake(play.main, ["go1", "--terms=good.py", "--out=w.html"], capsys)
    assert "trained without terms" in said


def test_a_policy_that_sees_nothing_of_its_own_plays_without_the_file():
    ends = "@terms.termination()\ndef low(height): return height < 9.0\n"
    config = flags.load("go1:laptop", [f"--config.task.terms={write(WORK + ends)}"])
    policy = policy_source.load("go1")[0]
    named = config_lib.validate(config).to_dict()["task"]
    task = policy.config["task"] | {
        n: named[n] for n in ("terms", "terms_hash", "terms_about", "own")
    }
    policy = policy._replace(config=policy.config | {"task": task})
    assert policy.own == () and policy_source.player(policy)[1] == ""
    terms._READ.clear()
    player, note = policy_source.player(policy)
    assert note == "note: nothing ends here by low (name their file: --terms)"
    assert not player.own.terms.path


def test_a_strangers_policy_that_names_quantities_without_terms_is_one_line(saved):
    policy = policy_file.load(saved)
    task = policy.config["task"] | {"terms_hash": ""}
    alone = policy._replace(config=policy.config | {"task": task})
    assert "sees seen, and its config names no terms" in refused(policy_source.player, alone)


def test_where_one_command_is_asked_for_that_of_a_file_is_left_out():
    draws = (
        "@terms.command(draws=1, numbers={'most': 2.0})\ndef fast(draw, most): return most * draw\n"
    )
    config = flags.load("go2:rough", [f"--config.task.terms={write(WORK + draws)}"])
    assert terms.of(config.task).command is not None and config.task.own.most == 2.0
    other = crossing.on_other_ground(config_lib.validate(config))
    assert terms.of(other.task).command is None and terms.of(other.task).rewards.keys() == {"work"}
    assert dict(other.task.own) == {"share": 0.5} and other.task.command_x == (0.8, 0.8)


def test_reading_a_file_again_gives_the_same_functions():
    """So a page that loads a newer policy of a run goes on with the robot that it shows."""
    first = terms.read(write(WORK + SEEN))
    assert terms.read("mine.py") is first
    write(WORK + SEEN + "# other\n")
    assert terms.read("mine.py") is not first


DAMAGE = {
    "name": "no name",
    "size": 0,
    "signs": [2],
    "order": [3],
    "scale": "x",
    "unit": 3,
    "content": None,
}


@pytest.mark.parametrize("part", DAMAGE)
def test_what_a_strangers_policy_says_of_its_quantities_is_checked(part, saved):
    policy = policy_file.load(saved)
    about = json.loads(policy.config["task"]["terms_about"])
    about["observation"][0][part] = DAMAGE[part]
    task = policy.config["task"] | {"terms_about": json.dumps(about)}
    arrays = dict(np.load(saved))
    of = json.loads(str(arrays["about"]))
    of["config"]["task"] = task
    np.savez("bad.npz", **arrays | {"about": json.dumps(of)})
    said = refused(policy_file.load, Path("bad.npz"))
    assert (
        said.startswith("bad.npz: task.terms_about has a quantity whose")
        and f"whose {part} is" in said
    )


def test_a_run_goes_on_only_with_the_same_text():
    config = flags.load("go1:laptop", [f"--config.task.terms={write()}"])
    before = config_lib.to_json(config)
    moved = shutil.copy("mine.py", "moved.py")
    config_lib.override(config, "task.terms", moved)
    may = workdir_lib.MAY_CHANGE
    assert config_lib.difference(before, config_lib.to_json(config), may) == ""
    config_lib.override(config, "task.terms", write(WORK + "# other\n"))
    told = config_lib.difference(before, config_lib.to_json(config), may)
    assert told == "the code of its terms, mine.py, is another now"
    after = config_lib.to_json(flags.load("go1:laptop", []))
    may = [*may, "task.weights.work", "task.own.share"]
    assert config_lib.difference(before, after, may) == "with terms work there, none here"
    assert config_lib.difference(after, before, may) == "with terms none there, work here"
    level = "@terms.curriculum(start=1.0)\ndef level(level): return level\n"
    command = "@terms.command(draws=1)\ndef fast(draw): return draw\n"
    config_lib.override(config, "task.terms", write(WORK + SEEN + level + command, "more.py"))
    told = config_lib.difference(before, config_lib.to_json(config), may)
    assert told == "with terms work there, work, seen, level, fast here"


def test_a_page_takes_the_file_for_the_policy_that_was_named(saved):
    offer = policies.Offer(str(saved), None, None, False)
    with pytest.raises(ConfigError, match="name the file"):
        policies.load(offer, str(saved))
    chosen = policies.load(offer._replace(terms=Path("good.py")), str(saved))
    assert chosen.player.own.terms.path.endswith("good.py") and "with good.py" in chosen.text
    assert not Path("ran").exists()
    again = policies.load(offer._replace(terms=Path("good.py")), str(saved))
    assert chosen.player.own == again.player.own  # so the robot goes on walking
