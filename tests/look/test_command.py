"""The command `python -m dynappo.look`: what it says of a robot, its picture, and every mistake."""

import re
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest
from answers import mistake, shell, status
from toy_policy import GO1

from dynappo.description import robot as robot_lib
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
    assert re.match(r"up to \d\.\d N m, at \w+_joint: \d+% of the limit 23.7", told["torque"])
    assert told["limbs"] == "12 joints, feet FL, FR, RL, RR, 14 other shapes"
    assert told["explore"].endswith("6.2 N m, at FL_hip_joint: 26% of the limit 23.7")
    rows = {
        "hip_joint": r"-0.10 to 0.10 +-0.86 to 0.86 +25 +0.5 +23.7 +\d+% +26%",
        "thigh_joint": r"0.80 to 1.00 +-0.69 to 4.50 +25 +0.5 +23.7 +\d+% +26%",
        "calf_joint": r"-1.50 +-2.82 to -0.89 +25 +0.5 +35.55 +\d+% +18%",
    }
    for kind, numbers in rows.items():
        assert re.search(rf"^{kind} +x 4 +{numbers}$", text, re.M), kind
    assert "note: " not in text


def test_what_should_be_changed_is_a_note(capsys):
    """Gains with which an ANYmal's joints chatter and it kneels; any field can be set."""
    assert run(*WEAK) == 0
    text = capsys.readouterr().out
    assert "stable, but the joints chatter: damping takes 1.53" in text
    assert re.search(r"most at \w\w_KFE;", text)  # the shank is lightest
    for part in (
        "lower task.kd",
        "a part that is no foot, touches the ground after",
        "it kneels",
        "does not come to rest",
    ):
        assert re.search(rf"^note: .*{part}", text, re.M), part


RULES = {  # fields, what the note says: every rule of robots/README.md that a config can break
    "exploration": (["action_scale=1.0"], "exploration asks FL_hip_joint for 105% of its motor"),
    "spawn height": (
        ["reset.spawn_height=1.2"],
        "task.reset.spawn_height is 1.2 m, the base .* at 0.325",
    ),
    "base mass": (["randomize.base_mass=(-1.0,9.0)"], "task.randomize.base_mass is -1 to 9 kg"),
    "friction": (["randomize.friction=(0.2,0.5)"], "friction is 0.80 in the file, but 0.2 to 0.5"),
    "a range": (
        ["action_scale=2.0"],
        "the whole range of FL_hip_joint, FL_calf_joint, .* is 1.73 to 1.93 rad, less than task.action_scale",
    ),
    "a weak motor": (["effort_limit=3", "saturation_effort=3"], "a motor is at task.effort_limit"),
}


@pytest.mark.parametrize("name", RULES)
def test_a_rule_that_a_config_breaks_is_a_note(name, capsys):
    fields, expected = RULES[name]
    assert run("go1", *[f"--config.task.{field}" for field in fields]) == 0
    assert re.search(f"^note: .*{expected}", capsys.readouterr().out, re.M)


def test_heavy_robots_are_paid_less_for_saving_torque(capsys):
    assert run("anymal_c", "--config.task.weights.joint_torques=-2e-4") == 0
    assert (
        "task.weights.joint_torques is -0.0002; for 52 kg -2.5e-05 is usual"
        in capsys.readouterr().out
    )


def test_soft_feet_and_low_shanks_are_notes(tmp_path, monkeypatch, capsys):
    """Menagerie's feet under a heavy robot, and a shank that reaches the floor beside the foot."""
    monkeypatch.chdir(tmp_path)
    text = robot_lib.load("anymal_c").xml.read_text()
    for folder in ("robots/soft", "robots/low", "configs"):
        Path(folder).mkdir(parents=True)
    Path("robots/soft/soft.xml").write_text(
        text.replace('solimp="0.9 0.95 0.03"', 'solimp="0.015 1 0.03"').replace(' impratio="3"', "")
    )
    foot = re.search(r'<geom name="LF_foot"[^>]*pos="([^"]*)"', text)
    assert foot
    low = f'<geom type="sphere" size="0.025" pos="{foot[1]}" contype="0" conaffinity="1"/>'
    Path("robots/low/low.xml").write_text(text.replace(foot[0], low + foot[0], 1))
    mine = 'from dynappo import config as c\ndef get_config(v=""):\n  k = c.load("configs/anymal_c.py")\n'
    for name in ("soft", "low"):
        Path(f"configs/{name}.py").write_text(mine + f"  k.robot = '{name}'\n  return k\n")
    assert run("soft") == 0
    assert re.search(
        r"^note: its feet sink into the floor by \d+ mm", capsys.readouterr().out, re.M
    )
    assert run("low") == 0
    assert (
        "note: no feet, but close to the floor in the default pose: LF_" in capsys.readouterr().out
    )


def test_what_train_refuses_look_refuses_in_the_same_words(capsys):
    """A base that may weigh nothing (program/build.py)."""
    line = mistake(
        look_command.main, ["go1", "--config.task.randomize.base_mass=(-6.0,1.0)"], capsys
    )
    assert "task.randomize.base_mass is (-6.0, 1.0), expected more than -5.20 kg" in line


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
    assert "picture a.png: its looks, feet (orange)" in capsys.readouterr().out


def test_motors_are_told_by_kind_of_joint(capsys):
    """The PD, and the joint that is nearest to its own limit."""
    flags = ["--config.task.kp={'.*_calf_joint': 35, '.*': 25}"]
    flags += ["--config.task.effort_limit={'.*_hip_joint': 2, '.*': 23.7}"]
    assert run("go1", *flags) == 0
    said = capsys.readouterr().out
    assert "PD      kp 25 to 35 N m/rad, kd 0.5 N m s/rad, a step of 5 ms" in said
    assert re.search(r"^thigh_joint .* 25 +0.5 +23.7 ", said, re.M)
    assert re.search(r"^calf_joint .* 35 +0.5 +23.7 ", said, re.M)
    assert re.search(r"torque  up to 2.0 N m, at .*_hip_joint: \d+% of the limit 2\n", said), said


MISTAKES = {  # arguments, what the line must say
    "nothing": ([], "no config given; try: "),
    "unknown": (["wlk"], "no file 'wlk' here or among dynappo's own configs; robots"),
    "suffix": (["go1", "--out=a.html"], "--out=a.html: expected a file named .png"),
    "no folder": (
        ["go1", "--out=/proc/no/a.png"],
        "--out=/proc/no/a.png: cannot write there (No such",
    ),
    "no folder for the ground": (
        ["go2:rough", "--ground=/proc/no/a.png"],
        "--ground=/proc/no/a.png: cannot write there (No such",
    ),
    "a flag": (["go1", "--fast"], "--fast: no such flag"),
    "a field": (["go1", "--config.task.kq=3"], "--config.task.kq: no such field"),
    "a value": (["go1", "--config.task.kp=-3"], "task.kp"),
    "a pattern": (
        ["go1", "--config.task.kp={'.*_knee': 35, '.*': 25}"],
        "the pattern '.*_knee' of task.kp matches no joint of go1",
    ),
    "a robot": (["go1", "--config.robot=spot"], "spot"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(name, tmp_path, monkeypatch, capsys):
    """Nothing is written, nothing printed but the line."""
    monkeypatch.chdir(tmp_path)
    arguments, expected = MISTAKES[name]
    assert expected in mistake(look_command.main, arguments, capsys)
    assert not [*tmp_path.iterdir()]


@pytest.mark.slow  # test_house.py sees every import
def test_it_needs_no_jax(tmp_path):
    """`python -m dynappo.look`, where JAX cannot be imported."""
    (tmp_path / "jax").mkdir()
    (tmp_path / "jax" / "__init__.py").write_text("raise ImportError('not here')\n")
    code = f"import runpy, sys; sys.path.insert(0, {str(tmp_path)!r}); "
    code += "runpy.run_module('dynappo.look', run_name='__main__', alter_sys=True)"
    done = shell("-c", code, "go2")
    assert done.returncode == 0, done.stderr
    assert "PD      kp 25" in done.stdout


@pytest.mark.slow
def test_nothing_is_said_of_gpus_where_there_is_none(tmp_path):
    """Warp's C++ writes past Python's stderr as it starts, for a file that has more than the plain one."""
    if find_spec("warp") is None:
        pytest.skip("warp-lang is not installed")
    for folder in ("robots/mine", "configs"):
        (tmp_path / folder).mkdir(parents=True)
    tie = '<equality><joint joint1="FL_hip_joint" joint2="FR_hip_joint"/></equality></mujoco>'
    (tmp_path / "robots/mine/mine.xml").write_text(GO1.xml.read_text().replace("</mujoco>", tie))
    (tmp_path / "configs/mine.py").write_text(MINE)
    done = shell("-m", "dynappo.look", "mine", cwd=tmp_path)
    assert done.returncode == 0 and done.stderr == ""
    assert "because of equality constraints" in done.stdout
