"""29_student: who may teach whom."""

import sys
import types

import jax.numpy as jnp
import numpy as np
import pytest
from answers import refused
from result_files import EXPERIMENTS, script

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.policy import policy_file, policy_source


def test_a_teacher_says_what_its_policy_does_in_the_exact_state():
    """The bundled Go1's, against its own NumPy function; noise is not in it, nor what comes later."""
    student, rng = script("29_student/student"), np.random.default_rng(0)
    teacher = policy_file.load(EXPERIMENTS.parent / "robots/go1/policy.npz")
    prop, obs = rng.normal(size=(7, 33)), rng.normal(size=(7, 240))
    robots = types.SimpleNamespace(prop=jnp.float32(prop), obs=jnp.float32(obs))
    said = student.labels(types.SimpleNamespace(prop_size=33), None, teacher)(robots)
    told = policy_file.actor(teacher.params, teacher.activation)
    wanted = told(np.concatenate([prop, obs[:, 33:48]], 1).astype(np.float32))
    np.testing.assert_allclose(said, wanted, atol=1e-4)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (
            "--teacher go1_deploy",
            "sees 225 numbers, onboard-45, 5 readings; expected one that sees the state, 1",
        ),
        (
            "--teacher go1_rough",
            "sees 235 numbers, velocity-48, a height scan; expected one that",
        ),
        ("--teacher go2", "--teacher=go2 is a policy of go2; expected one of go1"),
        (
            "--teacher go1 --config anymal_c:best",
            "is a policy of go1; expected one of anymal_c",
        ),
        (
            "--set task.action_scale=0.3",
            "--teacher=go1 was trained with task.action_scale 0.25 at FL_hip_joint, and the student has 0.3 "
            "and at 11 joints more: the same action would be another motion; --set task.action_scale=0.25",
        ),
        (
            "--set task.kp={'.*_calf_joint':30.0,'.*':25.0}",
            "with task.kp 25 at FL_calf_joint, and the student has 30 and at 3 joints more",
        ),
        (
            "--set task.kd=0.6",
            "was trained with task.kd 0.5 at FL_hip_joint, and the student has 0.6",
        ),
        (
            "--set physics.substeps=5",
            "acts every 0.02 s and the student every 0.025 s, by physics.timestep and physics.substeps",
        ),
        ("--steps -3", "--steps='-3': expected"),
        ("--robots 0", "--robots='0': expected"),
        ("--teacher nothing", "nothing: no such file or folder; expected a workdir"),
        ("--config nope", "--config: no file 'nope'"),
        ("--set task.nothing=1", "--config.task.nothing: no such field"),
        ("--set task.history", "task.history=''"),
    ],
)
def test_a_student_without_a_fitting_teacher_is_refused_in_one_line(
    argv, said, capsys, monkeypatch
):
    """Before JAX has a device; the line names what was found and what is expected."""
    student = script("29_student/student")
    monkeypatch.setattr(student.devices, "own_process", lambda *_: pytest.fail("it begins"))
    monkeypatch.setattr(sys, "argv", ["student.py", "student.npz", *argv.split()])
    with pytest.raises(SystemExit) as end:
        student.main()
    line = capsys.readouterr().err
    assert end.value.code == 2 and said in line and line.count("\n") == 1, line


def test_a_teacher_of_another_default_pose_is_refused():
    student, robot = script("29_student/student"), robot_lib.load("go1")
    teacher, _ = policy_source.load("go1")
    bent = teacher._replace(default_pose=teacher.default_pose + 0.1 * np.eye(12)[4])
    said = refused(student.check, bent, "go1", config_lib.load("go1:best"), robot)
    assert (
        "was trained with default_pose 0.9 at FR_thigh_joint, and the student has 0.8: the" in said
    )


def test_the_bundled_policies_that_see_the_state_may_teach_their_robots():
    """A biped's has a gait clock."""
    student = script("29_student/student")
    for name in ("go1", "anymal_d", "g1"):
        config = config_lib.load(f"{name}:best")
        student.check(policy_source.load(name)[0], name, config, robot_lib.load(name))
