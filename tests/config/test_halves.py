"""The types of `static` and `hyper`: a type checker knows which half has which field."""

import itertools
import json
import pathlib
import runpy
import subprocess
import sys
from typing import get_args, get_type_hints

import pytest
import write_halves

from dynappo import config as config_lib
from dynappo.config import halves

ROOT = pathlib.Path(__file__).parents[2]
FILES = sorted(path.stem for path in (ROOT / "configs").glob("*.py"))
VARIANTS = runpy.run_path(str(ROOT / "configs" / "default.py"))["VARIANTS"]
CASES = [(f"{file}.py:{variant}", "isaaclab") for file in FILES for variant in VARIANTS]
CASES += [("go1.py:dyna4", "paper_text"), ("go1.py:dyna4", "isaaclab_exact")]
# what pyright must say, and where
CODE = """\
from dynappo import config
from dynappo.types import Hyper, Static

def of_functions(static: Static, hyper: Hyper) -> float:
    low, high = hyper.task.command_x
    low, high = hyper.task.randomize.base_com  # error: three numbers
    return static.ppo.epochs * hyper.ppo.gamma + len(static.model.hidden) + low * high

static, hyper = config.split(config.validate(config.load("go1")))
static.ppo.gamma  # error: a float
hyper.ppo.epochs  # error: no float
static.task.weights  # error: all floats
hyper.rollout  # error: none is a float
hyper.task.tracking_std + hyper.task.standing  # None until validation sets them
static.schedule.last_iteration + 1  # error: it may stay None
static.ppo.gama  # error: no field
of_functions(static, hyper)
of_functions(hyper, static)  # error: the wrong way round
"""


def fits(value, kind):
    """Whether a value has this type: a bool is no int, and a tuple has its length."""
    kinds = get_args(kind)
    if type(value) is not tuple or not kinds:
        return type(value) in (kinds or (kind,))
    return all(map(fits, value, itertools.repeat(kinds[0]))) and (
        kinds[-1] is ... or len(value) == len(kinds)
    )


def leaves(values, kind, prefix=""):
    """`{dotted field: its type}` of a half, whose classes are those of halves.py."""
    assert type(values).__name__ == kind.__name__
    assert values._fields == kind._fields, "run: make format"
    out = {}
    for name, inner in get_type_hints(kind).items():
        value = getattr(values, name)
        if hasattr(inner, "_fields"):
            out |= leaves(value, inner, f"{prefix}{name}.")
        else:
            assert fits(value, inner), f"{prefix}{name} is {value!r}, and not {inner}"
            out[prefix + name] = inner
    return out


@pytest.mark.parametrize(("spec", "formulation"), CASES)
def test_every_config_splits_into_the_written_fields_each_in_one_half(spec, formulation):
    config = config_lib.load(f"configs/{spec}")
    config.task.formulation = formulation
    if formulation == "isaaclab_exact":
        config.physics.contacts = "full"
    config = config_lib.validate(config)
    static, hyper = config_lib.split(config)
    compiled, floats = leaves(static, halves.Static), leaves(hyper, halves.Hyper)
    assert not compiled.keys() & floats.keys()
    assert compiled.keys() | floats.keys() == config_lib.flat(config).keys()
    # not `float | None` either: set in another config, it would be in the other half
    assert all(float not in (kind, *get_args(kind)) for kind in compiled.values())
    assert all({float} == set(get_args(kind) or [kind]) for kind in floats.values())


def test_the_written_types_are_those_of_the_defaults():
    assert write_halves.text() == write_halves.FILE.read_text(), "run: make format"


def test_a_type_checker_reports_a_field_of_the_other_half(tmp_path):
    pytest.importorskip("pyright")
    (tmp_path / "code.py").write_text(CODE)
    done = subprocess.run(
        [sys.executable, "-m", "pyright", "--outputjson", str(tmp_path / "code.py")],
        cwd=ROOT,  # with the project's settings
        text=True,
        capture_output=True,
    )
    found = json.loads(done.stdout)["generalDiagnostics"]
    lines = {one["range"]["start"]["line"] for one in found if one["severity"] == "error"}
    wrong = {i for i, line in enumerate(CODE.splitlines()) if "# error" in line}
    assert lines == wrong, done.stdout
