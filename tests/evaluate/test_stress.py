"""Disturbances, one by one: what each changes, and that it changes nothing else."""

import json

import mujoco
import numpy as np
import pytest
from answers import status

from dynappo.evaluate import command, stress, trials
from dynappo.evaluate.stress import Stress
from dynappo.policy import episode, policy_source
from dynappo.tasks.velocity import observe

ROWS = observe.slices(12)
SECONDS = 0.6
AHEAD = np.array([0.5, 0.0, 0.0])


@pytest.fixture(scope="module")
def player():
    return policy_source.player(policy_source.load("go1")[0])[0]


@pytest.fixture(scope="module")
def onboard():
    return policy_source.player(policy_source.load("go1_deploy")[0])[0]


def scripted(late=0):
    """Actions that ask for nothing: of each control step those of `late` steps before; and what was seen."""
    actions, seen = np.random.default_rng(0).normal(0, 0.3, (100, 12)), []

    def act(obs):
        seen.append(obs)
        k = len(seen) - 1 - late
        return actions[k] if k >= 0 else np.zeros(12)

    return act, seen


def play(player, act, **disturbance):
    return stress.play(player, act, AHEAD, Stress("", **disturbance), seconds=SECONDS)[0]


def test_without_a_disturbance_it_is_an_episode_of_trials(player):
    np.testing.assert_array_equal(
        play(player, scripted()[0]),
        trials.record(player, scripted()[0], AHEAD, SECONDS)["velocity"],
    )


def test_late_actions_are_those_of_the_steps_before(player):
    for late in (1, 2):
        found = play(player, scripted()[0], action_delay=0.02 * late)
        expected = trials.record(player, scripted(late)[0], AHEAD, SECONDS)["velocity"]
        np.testing.assert_array_equal(found, expected)


def test_an_action_may_be_late_by_physics_steps(player):
    """Between those of no and of one control step, and neither."""
    now, half, one = (play(player, scripted()[0], action_delay=d) for d in (0.0, 0.01, 0.02))
    assert np.abs(half - now).max() > 1e-4 < np.abs(half - one).max()


def test_jitter_draws_a_delay_an_action_and_keeps_their_order(player, monkeypatch):
    followed, pd = [], stress.actuators.pd

    def spy(target, *rest):
        followed.append(target)
        return pd(target, *rest)

    monkeypatch.setattr(stress.actuators, "pd", spy)
    act, _ = scripted()
    sent = []
    play(player, lambda obs: sent.append(act(obs)) or sent[-1], jitter=0.04)
    p = player.policy
    sent = p.default_pose + p.action_scale * np.array(sent)
    which = np.array([np.flatnonzero((sent == t).all(1)) for t in followed[8:]]).ravel()
    age = np.arange(8, len(followed)) // player.substeps - which
    assert (np.diff(which) >= 0).all() and age.min() == 0 and age.max() == 2
    steps = round(0.04 / player.model.opt.timestep)
    assert (which >= (np.arange(8, len(followed)) - steps) // player.substeps).all()


def test_late_sensors_show_the_state_before_and_the_command_now(player):
    (act, seen), (other, late) = scripted(), scripted()
    play(player, act)
    play(player, other, sensor_delay=0.02)
    np.testing.assert_array_equal(np.array(late)[1:, :33], np.array(seen)[:-1, :33])
    np.testing.assert_array_equal(np.array(late)[:, 33:], np.array(seen)[:, 33:])


def test_weak_motors_are_those_of_smaller_gains_and_limits(player):
    p = player.policy
    weak = p._replace(
        kp=0.8 * p.kp,
        kd=0.8 * p.kd,
        effort_limit=0.8 * p.effort_limit,
        saturation_effort=0.8 * p.saturation_effort,
    )
    expected = trials.record(player._replace(policy=weak), scripted()[0], AHEAD, SECONDS)[
        "velocity"
    ]
    np.testing.assert_allclose(play(player, scripted()[0], motors=0.8), expected, atol=1e-9)


def test_gains_of_every_joint_are_those_of_the_joint(player):
    """Arrays [A]: equal ones are the number; a disturbance acts on the others as on the robot's own."""
    p, number = player.policy, len(player.policy.joint_names)
    same = p._replace(kp=np.full(number, p.kp), kd=np.full(number, p.kd))
    for disturbance in (dict(), dict(action_delay=0.01, motors=0.8, push=0.5, noise=1.0)):
        one = play(player, scripted()[0], **disturbance)
        np.testing.assert_array_equal(
            play(player._replace(policy=same), scripted()[0], **disturbance), one
        )
    kp, kd = p.kp * np.linspace(0.6, 1.4, number), p.kd * np.linspace(1.4, 0.6, number)
    own = player._replace(policy=p._replace(kp=kp, kd=kd))
    plain = np.array(play(own, scripted()[0]))
    expected = trials.record(own, scripted()[0], AHEAD, SECONDS)
    np.testing.assert_array_equal(plain, expected["velocity"])
    data, target = mujoco.MjData(player.model), p.default_pose + 0.1
    episode.reset(own, data)
    q = data.qpos[own.joint_q].copy()
    torque, _, _ = episode.physics_step(own, data, target, 0.8)
    np.testing.assert_allclose(torque, 0.8 * kp * (target - q))  # at rest, within the limits
    weak = p._replace(
        kp=0.8 * kp,
        kd=0.8 * kd,
        effort_limit=0.8 * p.effort_limit,
        saturation_effort=0.8 * p.saturation_effort,
    )
    expected = trials.record(player._replace(policy=weak), scripted()[0], AHEAD, SECONDS)[
        "velocity"
    ]
    np.testing.assert_allclose(play(own, scripted()[0], motors=0.8), expected, atol=1e-9)
    assert np.abs(plain - play(player, scripted()[0])).max() > 1e-3
    rows = [stress.measure(b, Stress("", noise=1.0), 1.2) for b in (player, own)]
    assert rows[0]["tracking_error"] != rows[1]["tracking_error"] and rows[1]["episodes"] == 8


def test_a_load_is_in_the_base_and_friction_everywhere(player):
    loaded = stress.disturbed(player, Stress("", mass=5.0, friction=0.3)).model
    base, before = player.base_body, player.model
    assert loaded.body_mass[base] == before.body_mass[base] + 5.0
    assert loaded.body_mass.sum() == pytest.approx(before.body_mass.sum() + 5.0)
    share = loaded.body_inertia[base] / before.body_inertia[base]
    np.testing.assert_allclose(share, loaded.body_mass[base] / before.body_mass[base])
    assert (loaded.geom_friction[:, 0] == 0.3).all() and (before.geom_friction[:, 0] != 0.3).any()


def test_a_push_is_a_velocity_of_its_size_every_two_seconds(player, monkeypatch):
    monkeypatch.setattr(stress, "PUSH_EVERY", 0.2)
    still = play(player, lambda obs: np.zeros(12))
    pushed = play(player, lambda obs: np.zeros(12), push=1.0)
    np.testing.assert_array_equal(pushed[:10], still[:10])
    jump = np.linalg.norm((pushed - still)[10, :2])
    assert 0.5 < jump < 1.1  # m/s, after a control step with friction


def test_noise_and_a_wrong_velocity_are_what_the_policy_sees(player):
    (act, seen), (other, noisy), (third, wrong) = scripted(), scripted(), scripted()
    play(player, act)
    play(player, other, noise=1.0)
    play(player, third, velocity=0.5)
    off = np.abs(np.array(noisy) - np.array(seen)).max(0)
    assert (off[ROWS["joint_velocity"]] > 1.2).all() and (off[ROWS["joint_velocity"]] <= 1.5).all()
    assert (off[ROWS["command"]] == 0).all() and (off[ROWS["previous_action"]] == 0).all()
    expected = np.array(seen)
    expected[:, ROWS["linear_velocity"]] *= 0.5
    np.testing.assert_array_equal(np.array(wrong), expected)


def test_the_first_noise_is_not_the_pose_that_the_episode_starts_in(player):
    """Drawn from one stream, they would be the same numbers, scaled."""
    (act, seen), (other, noisy) = scripted(), scripted()
    play(player, act)
    play(player, other, noise=1.0)
    pose, noise = seen[0][ROWS["joint_position"]], (noisy[0] - seen[0])[ROWS["joint_position"]]
    by_name = pose[np.argsort(player.policy.joint_names)]  # in the order in which they are drawn
    assert abs(np.corrcoef(by_name, noise)[0, 1]) < 0.9


def test_a_policy_without_velocity_has_no_row_of_it(player, onboard):
    every = {s.name for s in stress.table(player.policy)}
    some = {s.name for s in stress.table(onboard.policy)}
    assert every - some == {"velocity read as zero", "velocity read as half"}
    assert len(stress.commands(onboard.policy)) == 8


def test_other_physics_are_other_physics_of_the_same_length(player):
    for name, other in stress.other_physics(player):
        period = other.model.opt.timestep * other.substeps
        assert period == pytest.approx(0.02), name
        assert (
            name == "pyramidal cone"
            or name == "elliptic cone"
            or (
                other.model.opt.solver != player.model.opt.solver
                or other.model.opt.timestep != player.model.opt.timestep
            )
        )


def test_the_policies_for_hardware_stand_what_hardware_does(onboard):
    """One command each: late by 40 ms, on ice, under a load; a policy that falls at once fails."""
    for disturbance in (Stress("", action_delay=0.04), Stress("", friction=0.3, mass=5.0)):
        act = trials.policy_file.actor(onboard.policy.params, onboard.policy.activation)
        changed = stress.disturbed(onboard, disturbance)
        velocity, fall = stress.play(changed, act, AHEAD, disturbance, seconds=4.0)
        assert fall is None
        assert np.abs(velocity[100:, 0].mean() - 0.5) < 0.15


def test_the_command_prints_and_writes_the_table(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(stress, "SECONDS", 0.1)
    monkeypatch.setattr(stress.measure, "__defaults__", (1.2,))
    monkeypatch.setattr(stress, "TABLE", stress.TABLE[:2])
    monkeypatch.setattr(stress, "other_physics", lambda player: [])
    assert status(command.main, "go1_deploy", "--stress", f"--out={tmp_path}/out") == 0
    said = capsys.readouterr().out
    assert "actions 20 ms late  0 of 8" in said and "stress.json" in said
    rows = json.loads((tmp_path / "out" / "stress.json").read_text())["rows"]
    assert [row["stress"] for row in rows] == ["none", "actions 20 ms late"]
    assert all(row["falls"] == 0 and 0 < row["tracking_error"] < 0.6 for row in rows)
