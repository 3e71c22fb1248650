"""Words and numbers of an evaluation, a summary and an export that could claim more than was measured."""

from pathlib import Path
from types import SimpleNamespace

import pytest
from answers import status
from ml_collections import config_dict
from rich.console import Console
from toy_policy import GO1, actor

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.bench import command as bench_command
from dynappo.description import robot
from dynappo.evaluate import command as evaluate_command
from dynappo.evaluate import tables
from dynappo.export import command as export_command
from dynappo.export import deploy_yaml, joint_order
from dynappo.policy import policy_file, policy_source, walks
from dynappo.run import show
from dynappo.run import workdir as workdir_lib

SEEN = {"return": 15.0, "fall_rate": 0.0, "tracking_error": 0.08, "yaw_error": 0.1, "length": 320.0}


def config(spec="go2:rough"):
    return config_lib.validate(config_lib.load(spec))


def test_a_robot_that_crosses_its_tile_soon_is_not_said_to_walk_badly():
    """Its episode ends there and so does its return; on a floor the same return is one that is low."""
    assert walks.in_words(config(), SEEN) == "walks, turns, does not fall"
    assert "return 15.00 < 38" in walks.in_words(config("go2:best"), SEEN)
    assert "error 0.50 m/s" in walks.in_words(config(), SEEN | {"tracking_error": 0.5})


def test_who_fell_once_is_not_said_not_to_fall():
    """One of 200 episodes, as of 10,000."""
    for falls, words in ((0.0, "does not fall"), (1e-4, "seldom falls"), (0.005, "seldom falls")):
        found = walks.in_words(config("go1:best"), SEEN | {"return": 42.0, "fall_rate": falls})
        assert found == f"walks, turns, {words}"


def test_what_numbers_of_rough_ground_are_of_is_said(tmp_path, monkeypatch, capsys):
    """By `evaluate` before it begins, by `train` in its table."""
    policy, _ = policy_source.load("go1")
    rough = policy._replace(
        config=policy.config | {"task": policy.config["task"] | {"terrain": "rough"}}
    )
    flags = SimpleNamespace(crossing=False, record=None, stress=False, fast=False, robot_xml=None)
    assert evaluate_command.rough_note(policy, flags) == ""
    line = evaluate_command.rough_note(rough, flags)
    assert "are on a flat floor" in line and "ends where the robot leaves its tile" in line
    flags.fast = True
    line = evaluate_command.rough_note(rough, flags)
    assert "are on a flat floor, --crossing tells" in line and "episode" not in line
    flags.stress = True
    line = evaluate_command.rough_note(rough, flags)
    assert "disturbances are on a flat floor, and flights of stairs follow" in line
    flags.crossing = True
    assert evaluate_command.rough_note(rough, flags) == ""
    summary = {"return": 1.0, "return_max": 1.0, "sim_steps": 9, "seconds": 1.0, "impl": "c"}
    summary |= {"compile_seconds": 1.0, "evaluation": SEEN | {"crossed": [0.905, 0.925]}}
    show.summary(Console(width=120), config(), tmp_path, summary)
    text = " ".join(capsys.readouterr().out.split())
    assert (
        "evaluation: length 320.00 control steps, until a fall, its tile's edge or the time" in text
    )
    told = tables.episodes_rows(SEEN | {"seconds": 20.0, "crossed": 0.915})
    assert ["tiles crossed", "91.5 %"] in told
    floor = [label for label, _ in tables.episodes_rows(SEEN | {"seconds": 20.0})]
    assert floor and "tiles crossed" not in floor
    assert "evaluation: tiles crossed 91.50 % (2 seeds: 90.50 to 92.50)" in text
    assert "next:" not in text  # which would be another task, on a floor


def test_seconds_of_two_machines_are_said_to_be_of_two(tmp_path, capsys):
    """A run that was resumed elsewhere has one clock."""
    origins = [{"engine": "warp", "device": "NVIDIA H200"}, {"engine": "c", "device": "cpu"}]
    summary = {"return": 1.0, "return_max": 1.0, "sim_steps": 9, "seconds": 1.0, "impl": "c"}
    summary |= {"compile_seconds": 1.0, "origins": origins}
    show.summary(Console(width=120), config("go1:laptop"), tmp_path, summary)
    assert "warp on NVIDIA H200, then c on cpu" in " ".join(capsys.readouterr().out.split())
    # another commit on the same machine is nothing to say of seconds
    show.summary(
        Console(width=120), config("go1:laptop"), tmp_path, summary | {"origins": origins[1:] * 2}
    )
    assert "computed by" not in capsys.readouterr().out


def test_a_policy_that_gets_another_robot_keeps_its_pose_and_says_so(tmp_path, monkeypatch, capsys):
    """`export --robot-xml`, in any order of joints; the same pose is not a word worth."""
    monkeypatch.chdir(tmp_path)
    small = config_lib.load("go1:dyna4")
    small.ppo.hidden = (16, 16)
    policy_file.save(Path("mine.npz"), actor(), config_lib.validate(small), GO1)
    text = GO1.xml.read_text()
    Path("heavy.xml").write_text(text.replace('mass="5.204"', 'mass="7.5"', 1))
    Path("bent.xml").write_text(text.replace(" 0.1 0.8 -1.5", " 0.2 0.9 -1.6", 1))
    for xml, more, said in (
        ("heavy.xml", [], False),
        ("heavy.xml", ["--joint-order=isaaclab"], False),
        ("bent.xml", [], True),
        ("bent.xml", ["--joint-order=isaaclab"], True),
    ):
        out = f"--out={xml}{len(more)}.npz"
        assert status(export_command.main, "mine.npz", f"--robot-xml={xml}", out, *more) == 0
        assert ("the policy keeps its own" in capsys.readouterr().out) == said
        pose = dict(zip(GO1.joint_names, GO1.default_pose.tolist(), strict=True))
        kept = policy_file.load(Path(out.removeprefix("--out=")))
        assert kept.default_pose.tolist() == [pytest.approx(pose[n]) for n in kept.joint_names]


@pytest.mark.parametrize("spec", ["go1:few", "go1:best", "go1:ppo16", "go2:rough", "g1:best"])
def test_simulator_steps_are_those_of_real_robots_alone(spec):
    """Counted row by row: robots that only the model moves, and rows that it writes, are none."""
    c = config(spec)
    columns = workdir_lib.scheduled_columns(c, c.run.num_iterations)
    steps, found = 0, []
    for real in schedule.columns(c)["n_real"]:
        steps += int(real) * c.rollout.num_envs
        found.append(steps)
    assert columns["sim_steps"].tolist() == found
    assert (columns["n_real"] + columns["n_synthetic"] == c.rollout.horizon).all()
    if spec == "go1:few":
        assert c.rollout.imagined > 1
        more = config_dict.ConfigDict(c.to_dict())
        more.rollout.imagined = 1
        again = workdir_lib.scheduled_columns(config_lib.validate(more), c.run.num_iterations)
        assert again["sim_steps"].tolist() == found


def test_a_config_that_is_timed_beside_itself_has_two_columns():
    """Its file would have one."""
    for argv in (
        ["--config=go1:laptop", "--vs=go1:laptop"],
        ["--config=go1:laptop", "--engines=c,c"],
    ):
        _, names, *_ = bench_command.parse(argv)
        assert len({*names}) == 2 and names[1] == f"{names[0]}, again"
    assert bench_command.parse(["--config=go1:laptop", "--vs=go1"])[1] == ["go1:laptop", "go1"]


def test_a_g1_of_any_file_has_its_makers_motor_numbers():
    """In deploy.yaml, whatever order its joints have."""
    g1 = robot.load("g1")
    turned = g1._replace(joint_names=g1.joint_names[::-1])
    for one in (g1, turned):
        assert deploy_yaml.motors(one) == joint_order.UNITREE_G1
    assert deploy_yaml.motors(robot.load("anymal_c")) == robot.load("anymal_c").joint_names


def test_the_version_of_a_task_of_others_is_part_of_what_made_a_run():
    """A run of another version of Playground or brax says so when it goes on."""
    program = SimpleNamespace(impl="c", device="cpu")
    plain = workdir_lib.made_by(program, config("go1:best"))
    theirs = workdir_lib.made_by(program, SimpleNamespace(env="brax:fast"))
    assert theirs.keys() - plain.keys() == {"brax"}
