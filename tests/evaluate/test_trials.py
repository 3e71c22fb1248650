"""A grid of commands in C MuJoCo: recordings, effort and gait against plain loops over raw episodes."""

import itertools
import math

import mujoco
import numpy as np
import pytest
from toy_policy import GO1, actor, described, trot

from dynappo.evaluate import trials
from dynappo.policy import episode, policy_file

NAMES = ("FL", "FR", "RL", "RR")
TROT = np.array([0.4, 0.0, 0.3])


@pytest.fixture(scope="module")
def policy():
    """A Go1 whose actor always gives zero: it stands at the default pose."""
    return policy_file.describe(*described(), actor(size=0.0))


@pytest.fixture(scope="module")
def player(policy):
    return episode.load(GO1.xml, policy, policy.timestep)


@pytest.fixture(scope="module")
def walked(player):
    """Two seconds of the trot."""
    return trials.record(player, trot(), TROT, 2.0)


def made_up(seed, fall=None, rows=130, command=(0.5, 0.0, 0.1), speed=0.4):
    """A recording of random numbers; contacts in stretches."""
    rng = np.random.default_rng(seed)
    contact = np.repeat(rng.random((rows, 4)) < 0.6, 4, axis=0)
    return {
        "velocity": rng.normal([speed, 0, 0.1], 0.3, (rows, 3)),
        "action": rng.normal(size=(rows, 12)),
        "torque": rng.normal(size=(4 * rows, 12)),
        "speed": rng.normal(size=(4 * rows, 12)),
        "contact": contact,
        "load": rng.uniform(10, 90, contact.shape) * contact,
        "slide": rng.uniform(0, 0.5, contact.shape) * contact,
        "height": rng.uniform(0, 0.1, contact.shape) * ~contact,
        "qpos": rng.normal([0, 0, 0.3] + [1, 0, 0, 0] + 12 * [0.0], 0.01, (rows, 19)),
        "command": np.array(command),
        "fall": fall,
    }


# ---- a recording


def test_a_recording_is_that_of_a_loop_over_physics_steps(player, walked):
    """Torque, the speed it acts at, and contacts, by PD and heights of the feet; go1's numbers."""
    model, data, act = player.model, mujoco.MjData(player.model), trot()
    feet = [model.geom(f"{name}_foot").id for name in NAMES]
    episode.reset(player, data)
    torques, speeds, contacts = [], [], []
    for _ in range(100):
        target = 0.25 * act(None) + model.key("home").qpos[7:]
        for _ in range(4):
            q, qd = data.qpos[7:].copy(), data.qvel[6:].copy()
            torque = np.zeros(12)
            for j in range(12):  # the motor's limits fall with the speed at which it turns
                high = min(max(23.7 * (1 - qd[j] / 30.0), 0), 23.7)
                low = max(min(23.7 * (-1 - qd[j] / 30.0), 0), -23.7)
                torque[j] = min(max(25.0 * (target[j] - q[j]) - 0.5 * qd[j], low), high)
            data.qfrc_applied[6:] = torque
            mujoco.mj_step(model, data)
            torques.append(torque)
            speeds.append(qd)
            contacts.append([data.geom_xpos[i, 2] < model.geom_size[i, 0] for i in feet])
    assert 0.2 < np.mean(contacts) < 0.95
    np.testing.assert_allclose(walked["torque"], torques, atol=1e-6)
    np.testing.assert_allclose(walked["speed"], speeds, atol=1e-6)
    np.testing.assert_array_equal(walked["contact"], contacts)
    np.testing.assert_array_equal(walked["command"], TROT)
    assert walked["fall"] is None


def test_a_recording_is_the_episode_that_play_plays(player, walked):
    """The same velocities, and the same work of the motors."""
    played = episode.play(player, trot(), lambda t: TROT, 2.0)
    np.testing.assert_array_equal(walked["velocity"], played["velocity"])
    work = (np.abs(walked["torque"] * walked["speed"]).sum(1) * 0.005).reshape(100, 4).sum(1)
    np.testing.assert_allclose(work, played["work"], rtol=1e-9)


def test_a_fall_ends_a_recording(player):
    """At the control step at which play says so; the actions are those that were taken."""
    throw = lambda obs: np.full(12, 6.0)  # noqa: E731
    played = episode.play(player, throw, lambda t: TROT, 2.0)
    fell = int(np.flatnonzero(played["fell"])[0])
    recording = trials.record(player, throw, TROT, 2.0)
    assert recording["fall"] == pytest.approx((fell + 1) * 0.02)
    assert len(recording["velocity"]) == fell + 1 and len(recording["torque"]) == 4 * (fell + 1)
    np.testing.assert_array_equal(recording["action"], np.full((fell + 1, 12), 6.0))


def test_a_blow_up_is_a_fall(player):
    """Numbers that are not finite end the episode, are in no row, and leave nothing to measure."""
    count = itertools.count()
    recording = trials.record(
        player, lambda obs: np.full(12, np.nan if next(count) else 0), TROT, 2
    )
    assert recording["fall"] == pytest.approx(0.04)
    assert {name: len(recording[name]) for name in ("velocity", "contact")} == {
        "velocity": 1,
        "contact": 4,
    }
    at_once = trials.record(player, lambda obs: np.full(12, np.nan), TROT, 2.0)
    assert at_once["velocity"].shape == (0, 3) and at_once["torque"].shape == (0, 12)
    assert set(trials.measures(player, [at_once]).values()) == {None}
    assert trials.gait(player, [at_once])["duty_factor"] is None


# ---- what it came to


def loops(recordings):
    """Every measure of recordings of the Go1, by loops over rows and joints."""
    model = mujoco.MjModel.from_xml_path(str(GO1.xml))
    weight = 9.81 * sum(model.body_mass)
    planar, yaw, torques, changes = [], [], [], []
    shares, turning, tilts, heights = [], [], [], []
    energy, given, distance, walking, walking_given, seconds, gone = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    for r in recordings:
        end = len(r["velocity"]) if r["fall"] is None else round(r["fall"] / 0.02) - 1
        mean, spent, positive = [0.0, 0.0], 0.0, 0.0
        for t in range(50, end):
            vx, vy, turn = r["velocity"][t]
            planar.append((vx - r["command"][0]) ** 2 + (vy - r["command"][1]) ** 2)
            yaw.append((turn - r["command"][2]) ** 2)
            mean = [mean[0] + vx / (end - 50), mean[1] + vy / (end - 50)]
            for j in range(12):
                changes.append((0.25 * (r["action"][t][j] - r["action"][t - 1][j]) / 0.02) ** 2)
            heights.append(r["qpos"][t][2])
            up = np.zeros(3)
            mujoco.mju_rotVecQuat(up, np.array([0, 0, 1.0]), r["qpos"][t][3:7])
            tilts.append(math.acos(up[2]))
            for p in range(4 * t, 4 * t + 4):
                shares.append(max(abs(torque) for torque in r["torque"][p]) / 23.7)
                turning += [speed**2 for speed in r["speed"][p]]
                for torque, speed in zip(r["torque"][p], r["speed"][p], strict=True):
                    torques.append(abs(torque))
                    spent += abs(torque * speed) * 0.005
                    positive += max(torque * speed, 0) * 0.005
        if end <= 50:
            continue
        length, speed = (end - 50) * 0.02, math.hypot(*mean)
        energy, given, seconds = energy + spent, given + positive, seconds + length
        gone += speed * length
        if speed > 0.1:
            walking, walking_given = walking + spent, walking_given + positive
            distance += speed * length
    return {
        "tracking_error": math.sqrt(np.mean(planar)),
        "yaw_error": math.sqrt(np.mean(yaw)),
        "speed": gone / seconds,
        "power": energy / seconds,
        "positive_power": given / seconds,
        "torque": np.mean(torques),
        "torque_share": sorted(shares)[math.floor(0.99 * (len(shares) - 1))],
        "action_rate": math.sqrt(np.mean(changes)),
        "joint_speed": math.sqrt(np.mean(turning)),
        "tilt": np.mean(tilts),
        "height": np.mean(heights),
        "cost_of_transport": walking / (weight * distance) if distance else None,
        "positive_cost_of_transport": walking_given / (weight * distance) if distance else None,
    }


RECORDINGS = {
    "one": lambda walked: [walked],
    "two of different lengths": lambda walked: [walked, made_up(1)],
    "a fall, and one in the first second": lambda walked: [
        made_up(2, fall=1.8, rows=90),
        made_up(3, fall=0.6, rows=30),
    ],
    "one that stands": lambda walked: [made_up(4, speed=0.0), made_up(5)],
    "nobody walks": lambda walked: [made_up(6, speed=0.0)],
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_measures_are_those_of_loops(player, walked, name):
    recordings = RECORDINGS[name](walked)
    measured, expected = trials.measures(player, recordings), loops(recordings)
    assert measured.keys() == expected.keys()
    for key, value in expected.items():
        if value is None:
            assert measured[key] is None, key
        else:
            rel = 0.05 if key == "torque_share" else 1e-9  # between two rows, or one of them
            assert measured[key] == pytest.approx(value, rel=rel), key
    if name == "nobody walks":
        assert measured["cost_of_transport"] is None and measured["power"] > 0


def test_nothing_is_said_of_an_episode_that_ended_in_the_first_second(player):
    measured = trials.measures(player, [made_up(0, fall=1.0, rows=50)])
    assert measured.keys() == loops([made_up(1)]).keys()
    assert set(measured.values()) == {None}


# ---- the grid


def test_who_goes_nowhere_makes_no_strides(policy, player, monkeypatch):
    """Feet that chatter where it stands, at 0.03 m/s: no strides just where there is no cost of transport."""
    going = {0.5: 0.4, 1.0: 0.0}

    def record(player, act, command, seconds):
        return made_up(6, command=command, speed=going.get(command[0], 0.0))

    monkeypatch.setattr(trials, "record", record)
    monkeypatch.setattr(trials.slow, "run", lambda _: {})
    strides = ("air_time", "stride_frequency", "clearance", "asymmetry")
    for all_go in (False, True):
        if all_go:
            going[-1.0] = 0.4
        numbers, recordings = trials.run(policy, points=3)
        walks, stands = numbers["ahead"]
        gone = {"all": all_go, "walks": True, "stands": False, "standing": False}
        for name, row in {**numbers, "walks": walks, "stands": stands}.items():
            if name in gone:
                assert (row["cost_of_transport"] is not None) == gone[name]
                for some in (row, *row["feet"].values()):
                    kept = {some[n] is not None for n in strides if n in some}
                    assert kept == {gone[name]}, name
                    assert some["duty_factor"] > 0.3 and some["slip"] > 0
        expected = trials.gait(player, [recordings[0.5, 0.0, 0.0]])
        assert {n: walks[n] for n in expected} == expected


def test_a_robot_that_stands_is_wrong_by_what_it_is_asked(policy):
    """Every command of the grid, and all together; it sways a little (0.03 m/s) on soft legs."""
    told = []
    numbers, recordings = trials.run(policy, 1.4, 3, lambda *count: told.append(count))
    values = (-1.0, 0.0, 1.0)
    expected = {(x, y, 0.0) for x in values for y in values}
    expected |= {(x, 0.0, turn) for x in values for turn in values}
    assert [tuple(row["command"]) for row in numbers["commands"]] == [
        *dict.fromkeys(tuple(row["command"]) for row in numbers["commands"])
    ]
    assert {tuple(row["command"]) for row in numbers["commands"]} == expected
    for row in numbers["commands"]:
        x, y, turn = row["command"]
        assert row["tracking_error"] == pytest.approx(math.hypot(x, y), abs=0.04)
        assert row["yaw_error"] == pytest.approx(abs(turn), abs=0.04)
        assert row["fall"] is None and row["cost_of_transport"] is None
    squares = [x**2 + y**2 for x, y, _ in expected]
    assert numbers["all"]["tracking_error"] == pytest.approx(np.sqrt(np.mean(squares)), abs=0.01)
    assert (numbers["all"]["episodes"], numbers["all"]["falls"]) == (15, 0)
    assert numbers["all"]["duty_factor"] == 1.0 and numbers["all"]["air_time"] is None
    assert [row["command"] for row in numbers["ahead"]] == [[0.5, 0, 0], [1, 0, 0]]
    assert set(recordings) == expected | {
        (0.5, 0, 0)
    }  # a speed ahead that is not in a grid of three
    for command, r in recordings.items():
        assert tuple(r["command"]) == command
        assert len(r["qpos"]) == len(r["velocity"]) == 70
    assert told == [(i, 16) for i in range(17)]


def test_the_grid_is_the_range_that_was_trained(policy):
    """Also where it is not about zero, or where an axis was not trained at all."""
    odd = policy._replace(command_x=(0.2, 0.6), command_y=(-0.5, 0.5), command_yaw=(0.0, 0.0))
    grid = {name: values.tolist() for name, values in trials.axes(odd).items()}
    assert grid == {
        "vx": [0.2, 0.3, 0.4, 0.5, 0.6],
        "vy": [-0.5, -0.25, 0, 0.25, 0.5],
        "wz": [0],
    }
    assert trials.speeds(odd) == [0.5, 0.6] and trials.speeds(policy) == [0.5, 1.0]
    assert trials.speeds(odd._replace(command_x=(-1.0, 0.3))) == [0.3]
    numbers, _ = trials.run(odd._replace(command_y=(0.1, 0.3)), 0.1, 2)
    assert numbers["held"] == {"vy": 0.1, "wz": 0.0}
    commands = [tuple(row["command"]) for row in numbers["commands"]]
    assert commands == [(0.2, 0.1, 0), (0.2, 0.3, 0), (0.6, 0.1, 0), (0.6, 0.3, 0)]
    assert numbers["all"]["tracking_error"] is None


def test_falls_are_counted_and_what_came_before_is_measured(policy):
    """An actor that throws the robot over after it was told to go ahead."""
    params = actor(size=0.0)
    layer = params["actor"]["params"]
    layer["Dense_0"]["kernel"][33, 0] = 1.0  # the command ahead
    layer["Dense_1"]["kernel"][0, 0] = 1.0
    layer["Dense_2"]["kernel"][0, :] = 8.0
    numbers, _ = trials.run(policy._replace(params=params), 1.2, 3)
    fell = {row["command"][0] for row in numbers["commands"] if row["fall"] is not None}
    assert 1.0 in fell and 0.0 not in fell
    assert numbers["all"]["falls"] == sum(row["fall"] is not None for row in numbers["commands"])
    assert numbers["ahead"][1]["fall"] is not None


def test_the_gait_of_all_commands_is_that_of_walking(policy, monkeypatch):
    """A robot that is told to stand, and stands, is not counted: 0.25 is the share of the others."""

    def fake(player, act, command, seconds):
        walks = np.linalg.norm(command) > 0
        contact = np.tile(np.arange(400)[:, None] % 40 < (10 if walks else 40), (1, 4))
        return made_up(0, rows=100, command=command) | {"contact": contact}

    monkeypatch.setattr(trials, "record", fake)
    numbers, _ = trials.run(policy, 2.0, 3)
    assert numbers["all"]["duty_factor"] == pytest.approx(0.25)
    assert numbers["all"]["air_time"] == pytest.approx(0.15)
