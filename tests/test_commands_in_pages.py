"""The commands in the Markdown pages: each could be run as it is written. None of them is run.

dynappo's commands go through their own parsers, and config fields through the checks of a run. Of a
script its argparse is rebuilt from the source, of a Makefile and an extra the names are looked up.
"""

import argparse
import ast
import functools
import importlib
import json
import re
import shlex
import tomllib

import numpy as np
import pytest
from answers import ROOT
from PIL import Image
from test_pages import PAGES

from dynappo import config as config_lib
from dynappo.config import ConfigError, files
from experiments import paper

HISTORY = {"CHANGELOG.md"}  # commands of the versions that it is about
OUTPUT = ("dynappo trains ",)  # what a command prints, not a command
SHELLS = {"", "sh", "bash", "shell", "console", "powershell"}  # languages of a fence
STARTS = re.compile(
    r"([A-Z_]+=\S* +)*(taskset \S+ \S+ +)?(\.venv[/\\]\w+[/\\])?"
    r"((dynappo|make|pip install|sbatch|docker run)(?=\s|$)|"
    r"(mj)?python3? -m dynappo|python3? (experiments|\$[A-Z]+)/)"
)
VARIABLE = r"([A-Z]+)=(\S+)"  # of the shell, set on a line of its own
ROBOT = r"(?:go1|go2|anymal_c|anymal_d):\w+"
WRITTEN = {  # configs that a reader writes, and what stands for them
    "configs/NAME.py": "load(f'anymal_c:{variant}')",
    "configs/mine.py": "load(f'go1:{variant}')",
    "configs/spot.py": "load(f'anymal_c:{variant}')",  # of experiments/23_untuned, run from there
    "pendulum.py": "load('go1')",
}


def commands(text):
    """`(line, command)` of each command in a page, with its shell variables filled in."""
    prose, code, language = [], [], None
    for number, line in enumerate(text.split("\n"), 1):
        if fence := re.match(r" {0,3}```(\w*)", line):
            language = fence[1] if language is None else None
            prose.append("")
        elif language is None and not line.startswith("    "):
            prose.append(line)
        else:
            prose.append("")
            code += [(number, line)] if language is None or language in SHELLS else []
    prose = "\n".join(prose)
    for span in re.finditer(r"`([^`]+)`", prose):
        command = " ".join(span[1].split())
        if STARTS.match(command) and " " in command:
            yield prose.count("\n", 0, span.start()) + 1, command
    known = {}
    while code:
        (number, line), *code = code
        while line.endswith("\\") and code:
            line, code = line[:-1] + code[0][1].strip(), code[1:]
        line = line.strip()
        if variable := re.fullmatch(VARIABLE, line):
            known[variable[1]] = variable[2]
        for part in line.split("; "):
            if STARTS.match(part) and not part.startswith(OUTPUT):
                yield number, re.sub(r"\$([A-Z]+)", lambda m: known.get(m[1], m[0]), part)


def all_commands():
    return [
        pytest.param(command, id=f"{page.relative_to(ROOT)}:{number}")
        for page in PAGES
        if page.name not in HISTORY
        for number, command in commands(page.read_text())
    ]


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """A folder with a run, a sweep, and the configs that a reader would write."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs" / "go1").mkdir(parents=True)
    (tmp_path / "runs" / "go1" / "config.json").write_text(
        config_lib.to_json(config_lib.load("go1:best"))
    )
    sweep = tmp_path / "runs" / "go1-sweep"
    sweep.mkdir()
    about = dict(sweep={"ppo.gamma": ["0.97"]}, combinations={}, restore=None, own_env=False)
    about["config"] = config_lib.load("go1:best").to_dict()
    (sweep / "sweep.json").write_text(json.dumps(about))
    page = (ROOT / "docs" / "task.md").read_text()  # whose reader writes its first example
    (tmp_path / "my_terms.py").write_text(re.search(r"^```python\n(.*?)^```", page, re.M | re.S)[1])
    (tmp_path / "walked.npz").touch()  # a log, whose content a parser does not read
    Image.fromarray(np.zeros((90, 90), np.uint8)).save(tmp_path / "ground.png")
    for name, config in WRITTEN.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        text = (
            f"from dynappo.config import load\n\ndef get_config(variant=''):\n    return {config}\n"
        )
        (tmp_path / name).write_text(text)


@pytest.mark.parametrize("command", all_commands())
def test_every_command_is_real(command):
    check(command)


@pytest.mark.parametrize(
    "command",
    [
        "dynappo teach --config=go1",
        "dynappo train --config=go1 --worker=3",
        "dynappo train --config=go1:bset",
        "dynappo train --config=go3",
        "dynappo train --config=go1 --config.run.num_seed=8",
        "dynappo train --config=go1 --config.run.num_seeds=eight",
        "dynappo train --config=go1 --config.run.num_seeds=8 --config.run.mesh_seed=3",
        "dynappo play go3",
        "dynappo play go1 --comand=0.8,0,0",
        "dynappo play go1 --command=0.8,0",
        "dynappo export go1 --out=policy.tflite",
        "dynappo export go1 --out=policy.onnx --joint-order=ros",
        "python -m dynappo.evaluate go1 --quick",
        "python -m dynappo.bench --config=go1 --engines=c",
        "python experiments/03_speed/no_such.py OUT.json",
        "python experiments/03_speed/start.py OUT.json --case warm",
        "python experiments/03_speed/start.py",
        "python experiments/10_ablation/run.py --fast",
        "python experiments/10_ablation/run.py --more many",
        "python experiments/12_platforms/run.py --robot go2",
        "python experiments/16_gaits/run.py --robot go3",
        "python experiments/16_gaits/run.py --movies",
        "python experiments/run.py OUT go1:bset",
        "python experiments/run.py OUT go1:best --set run.eval_env=200",
        "make tests",
        "make CONFIGS=go1 train",
        "pip install -e '.[cuda14]'",
        "sbatch experiments/cluster/train.sbatch --config=configs/go1.py --nodes=4",
        "sbatch experiments/cluster/no_such.sbatch",
        "docker run --rm dynappo teach --config=go1",
    ],
)
def test_a_wrong_command_is_found(command):
    with pytest.raises((ConfigError, AssertionError)):
        check(command)


def test_commands_are_found_in_a_page():
    page = (
        "Say `make\ntest`, `make` or `dynappo/x.py`.\n\n"
        "    R=experiments/03_speed\n    python $R/start.py OUT  # times\n"
        "    dynappo train \\\n      --config=go1\n    dynappo trains go1: 512 robots\n\n"
        "```sh\ndynappo play go1\n```\n\n```python\nmake = 1\n    make test\n```\n"
    )
    assert list(commands(page)) == [
        (1, "make test"),
        (5, "python experiments/03_speed/start.py OUT  # times"),
        (6, "dynappo train --config=go1"),
        (11, "dynappo play go1"),
    ]


def check(command):
    """AssertionError or ConfigError where the command would be refused, or names what is not there."""
    words = shlex.split(command.replace("\\", "/"), comments=True)
    while re.match(r"[A-Z_]+=", words[0]):
        words = words[1:]
    words = words[3:] if words[0] == "taskset" else words
    program, rest = words[0].rsplit("/")[-1], words[1:]
    if program == "make":
        check_make(rest)
    elif program == "pip":
        check_pip(rest[1:])
    elif program == "sbatch":
        check_sbatch(rest)
    elif program == "docker":
        check_dynappo(*rest[rest.index("dynappo") + 1 :])
    elif program == "dynappo":
        check_dynappo(*rest)
    elif rest[0] == "-m":
        module = rest[1].removeprefix("dynappo").removeprefix(".")
        check_dynappo(*([module] if module else []), *rest[2:])
    else:
        check_script(rest[0], rest[1:])


def check_dynappo(name, *rest):
    """A command as its own parser reads it, without a look at policies and devices."""
    from dynappo.__main__ import COMMANDS

    assert name in COMMANDS, f"no command {name}"
    if not rest:  # only its name is said
        return
    command = importlib.import_module(f"dynappo.{name}.command")
    # K, N: a number that the reader puts in
    found = command.parse([re.sub(r"(?<==)[A-Z]$", "1", word) for word in rest])
    if name in ("play", "evaluate", "export"):
        what = found.what
        assert what in files.bundled() or what == "DIR" or re.search(r"[/.]", what), what
    if name == "play" and not (found.command or "").endswith(".csv"):
        from dynappo.play import command_script

        command_script.commands(found.command, found.seconds)
    if name == "export":
        from dynappo.export import joint_order

        assert found.joint_order in (None, *joint_order.ORDERS), found.joint_order


def check_make(words):
    text = (ROOT / "Makefile").read_text()
    for word in words:
        name, equals, _ = word.partition("=")
        defined = rf"^{re.escape(name)} \?=" if equals else rf"^{re.escape(name)}:.*## "
        assert re.search(defined, text, re.M), f"the Makefile has no {name}"


def check_pip(words):
    """Extras of this project; other packages are not ours to know."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    for word in words:
        if named := re.fullmatch(r"(?:\.|dynappo)\[(.*)\]", word):
            assert not set(named[1].split(",")) - extras.keys(), word
        if word.endswith(".txt"):
            assert (ROOT / word).is_file(), word


def check_sbatch(words):
    file = next(i for i, word in enumerate(words) if not word.startswith("-"))
    assert (ROOT / words[file]).is_file(), words[file]
    if words[file].endswith("train.sbatch"):
        check_dynappo("train", "--config=configs/go1.py", *words[file + 1 :])


def check_script(path, words):
    """Its flags and the number of its arguments; jobs and fields of configs among them."""
    file = ROOT / path
    assert file.is_file(), path
    source = file.read_text()
    parser = parser_of(source)
    if parser:
        try:
            parser.parse_args(words)
        except argparse.ArgumentError as error:
            raise AssertionError(f"{path}: {error}") from None
        except SystemExit:
            raise AssertionError(f"{path}: {' '.join(words)}") from None
    else:
        assert not words or "sys.argv" in source, f"{path} takes no arguments"
        for word in words:
            flag = word.partition("=")[0]
            assert not flag.startswith("--") or f'"{flag}"' in source, f"{path} knows no {flag}"
    for i, word in enumerate(words):
        if re.match(ROBOT, word):
            name, variant, *fields = re.sub(r"[\[\]]", "", word).split(":")  # [...]: as you like
            job(f"{name}:{variant}", fields)
        elif words[i - 1] == "--set":
            job("go1", [word])


def job(spec, fields):
    config = config_lib.load(spec)
    for field in fields:
        config_lib.override(config, *field.split("=", 1))


@functools.cache
def parser_of(source):
    """The argparse of a script, rebuilt from its `add_argument` calls; None where it has none.

    To import a script would take seconds and run what has no `main`. What is no literal, as the
    type of a path, is left out, but for numbers.
    """
    if "less.main(" in source:  # the command of 21_less/run.py, too
        source = (ROOT / "experiments/21_less/run.py").read_text()
    calls = called(ast.parse(source))
    if "options" in calls:  # those of experiments.paper too
        shared = ast.parse((ROOT / "experiments/paper.py").read_text()).body
        options = called(next(f for f in shared if getattr(f, "name", "") == "options"))
        calls["add_argument"] = calls.get("add_argument", []) + options["add_argument"]
    if not {"parser", "ArgumentParser"} & calls.keys():
        return None
    parser = argparse.ArgumentParser(allow_abbrev=False, exit_on_error=False)
    for call in calls.get("add_argument", []):
        literal = {}
        for word in call.keywords:
            if word.arg == "type" and ast.unparse(word.value) in ("int", "float"):
                literal["type"] = {"int": int, "float": float}[ast.unparse(word.value)]
            elif word.arg == "choices" and ast.unparse(word.value) == "paper.ROBOTS":
                literal["choices"] = paper.ROBOTS
            elif word.arg in ("nargs", "action", "choices"):
                literal[word.arg] = ast.literal_eval(word.value)
        parser.add_argument(*map(ast.literal_eval, call.args), **literal)
    return parser


def called(tree):
    """The calls in a piece of code by the last name of what they call."""
    found = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "attr", getattr(node.func, "id", ""))
            found.setdefault(name, []).append(node)
    return found
