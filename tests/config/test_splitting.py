"""`static` and `hyper`: floats never reach the compiled program, all else does; a type checker knows."""

import itertools
import json
import pathlib
import runpy
import subprocess
import sys
import types
from typing import get_args, get_type_hints

import jax
import pytest
import write_halves

from dynappo import config as config_lib
from dynappo.config import files, halves, per_joint
from dynappo.description import robot

ROOT = pathlib.Path(__file__).parents[2]
OTHERS = {"biped", "brax", "playground"}  # no robot's
FILES = sorted({path.stem for path in (ROOT / "configs").glob("*.py")} - OTHERS)
VARIANTS = runpy.run_path(str(ROOT / "configs" / "default.py"))["VARIANTS"]
CASES = [
    (f"{file}.py:{variant}", "isaaclab")
    for file in FILES
    for variant in VARIANTS
    if file != "g1" or not variant.startswith("logs")  # it has a gait clock, which no log tells
]
CASES += [("go1.py:dyna4", "paper_text"), ("go1.py:dyna4", "isaaclab_exact")]
GROUND = "task.tiles."
# what pyright must say, and where
CODE = """\
from dynappo import config
from dynappo.types import Hyper, Static

def of_functions(static: Static, hyper: Hyper) -> float:
    low, high = hyper.task.command_x
    low, high = hyper.task.randomize.base_com  # error: three numbers
    return static.ppo.epochs * hyper.ppo.gamma + len(static.model.hidden) + low * high

static, hyper = config.split(config.validate(config.load("go1:ppo16")))
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
    """Whether a value has this type: a bool or an int is no float, and a tuple has its length."""
    kinds = get_args(kind)
    if isinstance(kind, types.UnionType):
        return any(fits(value, one) for one in kinds)
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


def split(config):
    return config_lib.split(config_lib.validate(config))


@pytest.mark.parametrize(("spec", "formulation"), CASES)
def test_every_config_splits_into_the_written_fields_each_in_one_half(spec, formulation):
    config = config_lib.load(f"configs/{spec}")
    config.task.formulation = formulation
    if formulation == "isaaclab_exact":
        config.physics.contacts = "full"
    config = config_lib.validate(config)
    spec_of = robot.physics_spec(files.find("robots", f"{config.robot}/{config.robot}.xml"))
    joints = [motor.name for motor in spec_of.actuators]
    static, hyper = config_lib.split(per_joint.resolved(config, joints, config.robot))
    compiled, floats = leaves(static, halves.Static), leaves(hyper, halves.Hyper)
    assert not compiled.keys() & floats.keys()
    assert compiled.keys() | floats.keys() == config_lib.flat(config).keys()
    # not `float | None` either: set in another config, it would be in the other half
    # what is built into the program is always here: motors' inertia, and of what the ground is made
    assert compiled.pop("task.armature") == float | tuple[float, ...] | None
    compiled = {name: kind for name, kind in compiled.items() if not name.startswith(GROUND)}
    assert all(float not in (kind, *get_args(kind)) for kind in compiled.values())
    one_or_several = (
        float,
        float | tuple[float, ...],
        float | None,
        float | tuple[float, ...] | None,
        tuple[float, float] | None,
    )
    assert all(kind in one_or_several or {float} == set(get_args(kind)) for kind in floats.values())


def test_a_float_that_is_none_is_part_of_the_program_and_any_number_of_it_is_not():
    """By the structure of the tree."""

    def hyper(value):
        config = config_lib.load("go1:ppo16")
        config.task.max_tilt = config.task.weights.foot_slip = value
        static, hyper = split(config)
        assert "max_tilt" not in static.task._fields and "foot_slip" in hyper.task.weights._fields
        return jax.tree.structure(hyper)

    assert hyper(None) != hyper(0.5) == hyper(1.0)


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


def test_equal_configs_have_equal_static_parts_with_equal_hashes():
    (one, _), (two, _) = (split(config_lib.load("go1:dyna4")) for _ in range(2))
    assert one == two and hash(one) == hash(two) and type(one) is type(two)
    assert one.ppo == two.ppo and hash(one.ppo) == hash(two.ppo)


def test_a_changed_float_changes_no_static_part_and_no_tree_structure():
    """So no learning rate, and no sweep over it, compiles anything anew."""
    config = config_lib.load("go1:dyna4")
    config.schedule.late_from = 60  # where ppo.late_kl has a meaning
    static, hyper = split(config)
    for field, value in config_lib.flat(config).items():
        if type(value) is float and value > 0 and not field.startswith(GROUND):
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
        ("task.tiles", dict(tread=0.25)),
        ("model.late_epochs", 3),
    ],
)
def test_a_changed_field_that_is_no_float_changes_the_static_part_only(field, value):
    config = config_lib.load("go1:dyna4")
    static, hyper = split(config)
    group, _, leaf = field.partition(".")
    config[group].update({leaf: value})
    other_static, other_hyper = split(config)
    found = other_static[static._fields.index(group)]._asdict()[leaf]
    assert other_static != static and other_hyper == hyper
    assert found == value or found.tread == value["tread"]
