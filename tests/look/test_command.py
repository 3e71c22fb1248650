"""The command `python -m dynappo.look`: what it says of a robot, its picture, and every mistake."""

import re
from functools import partial
from pathlib import Path

import pytest
from answers import mistake, shell, status
from toy_policy import GO1

from dynappo.look import command as look_command
from dynappo.policy import render

run = partial(status, look_command.main)
WEAK = ["anymal_c", "--config.task.kp=40", "--config.task.kd=25"]
MINE = """
from dynappo import config as config_lib
def get_config(variant=""):
    config = config_lib.load("configs/go1.py")
    config.robot = "mine"
    return config
"""


def test_it_says_what_a_robot_is_and_how_it_stands(capsys):
    assert run("go1") == 0
    text = capsys.readouterr().out
    told = {line[:8].strip(): line[8:] for line in text.splitlines()}
    assert told["robot"] == f"go1, {GO1.xml}" and told["mass"] == "12.74 kg"
    assert told["PD"] == "kp 25 N m/rad, kd 0.5 N m s/rad, a step of 5 ms"
    assert told["is"].startswith("stable: damping takes 0.19 of a joint's speed in a step")
    assert re.match(r"\d+ mm in 5 s: the base at 0.325 m, then 0.2\d+ m", told["sag"])
    assert re.match(
        r"up to \d\.\d N m, at F[LR]_calf_joint: \d+% of the limit 23.7", told["torque"]
    )
    for name, angle in zip(GO1.joint_names, GO1.default_pose, strict=True):
        assert re.search(rf"^{name} +{angle:.3f} +-\d.\d+ to +-?\d.\d+ +-?\d+\.\d\d$", text, re.M)
    assert "note: " not in text


def test_what_should_be_changed_is_a_note(capsys):
    """Gains with which an ANYmal's joints chatter and it kneels; any field can be set."""
    assert run(*WEAK) == 0
    text = capsys.readouterr().out
    assert "the joints chatter: damping takes 1.53" in text
    for part in ("lower task.kd", "touches the ground after", "it kneels", "does not come to rest"):
        assert re.search(rf"^note: .*{part}", text, re.M), part


def test_physics_that_blows_up_is_one_line_after_what_is_known(capsys):
    strong = ["effort_limit", "saturation_effort"]
    fields = [f"--config.task.{name}=100000" for name in strong]
    assert run("anymal_c", "--config.task.kd=100", *fields) == 1
    said = capsys.readouterr()
    assert "  is    unstable: damping takes 6.13" in said.out and "sag" not in said.out
    assert said.err.count("\n") == 1 and "its physics has blown up after" in said.err


def test_a_robot_of_ones_own_is_looked_at_from_its_folder(tmp_path, monkeypatch, capsys):
    """Two files; an MJCF that breaks the contract is one line that names it."""
    monkeypatch.chdir(tmp_path)
    for folder in ("robots/mine", "configs"):
        Path(folder).mkdir(parents=True)
    text = GO1.xml.read_text()
    Path("configs/mine.py").write_text(MINE)
    Path("robots/mine/mine.xml").write_text(text.replace('mass="5.204"', 'mass="6.204"', 1))
    assert run("configs/mine.py") == run("mine") == 0
    assert "mass    13.74 kg" in capsys.readouterr().out
    spring = text.replace('class="thigh"/>', 'class="thigh" stiffness="5"/>', 1)
    Path("robots/mine/mine.xml").write_text(spring)
    assert run("mine") == 0
    told = "note: .*robots/mine/mine.xml: because of springs at joints .* MuJoCo Warp's own step"
    assert re.search(told, capsys.readouterr().out)
    slides = text.replace('class="thigh"/>', 'class="thigh" type="slide"/>', 1)
    Path("robots/mine/mine.xml").write_text(slides)
    line = mistake(look_command.main, ["mine"], capsys)
    assert "robots/mine/mine.xml: expected hinge joints after the free one" in line


def test_a_picture_is_written_or_one_line_says_why_not(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    film = render.film
    monkeypatch.setattr(render, "film", lambda *_: render.NO_OPENGL)
    assert run("go1", "--out=a.png") == 2
    said = capsys.readouterr()
    assert said.err.startswith(
        "dynappo: --out=a.png: no picture: neither EGL nor OSMesa can render"
    )
    assert said.err.count("\n") == 1 and "mass    12.74 kg" in said.out
    assert not [*tmp_path.iterdir()]
    monkeypatch.setattr(render, "film", film)
    if run("go1", "--out=a.png"):
        pytest.skip(capsys.readouterr().err)
    assert Path("a.png").read_bytes()[:4] == b"\x89PNG"
    assert "picture a.png, after 5 s" in capsys.readouterr().out


MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "no config given; try: "),
    "unknown": (["wlk"], "--config: no file 'wlk'"),
    "suffix": (["go1", "--out=a.html"], "--out=a.html: expected a file named .png"),
    "no folder": (
        ["go1", "--out=/proc/no/a.png"],
        "--out=/proc/no/a.png: cannot write there (No such",
    ),
    "a flag": (["go1", "--fast"], "--fast: no such flag"),
    "a field": (["go1", "--config.task.kq=3"], "--config.task.kq: no such field"),
    "a value": (["go1", "--config.task.kp=-3"], "task.kp"),
    "a robot": (["go1", "--config.robot=spot"], "spot"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(name, tmp_path, monkeypatch, capsys):
    """Nothing is written, nothing printed but the line."""
    monkeypatch.chdir(tmp_path)
    arguments, expected = MISTAKES[name]
    assert expected in mistake(look_command.main, arguments, capsys)
    assert not [*tmp_path.iterdir()]


def test_it_needs_no_jax(tmp_path):
    """`python -m dynappo.look`, where JAX cannot be imported."""
    (tmp_path / "jax").mkdir()
    (tmp_path / "jax" / "__init__.py").write_text("raise ImportError('not here')\n")
    code = f"import runpy, sys; sys.path.insert(0, {str(tmp_path)!r}); "
    code += "runpy.run_module('dynappo.look', run_name='__main__', alter_sys=True)"
    done = shell("-c", code, "go2")
    assert done.returncode == 0, done.stderr
    assert "PD      kp 25" in done.stdout
