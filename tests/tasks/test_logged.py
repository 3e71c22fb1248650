"""Logs: what a recording holds, what a log's environment makes of it, and each log that is refused."""

import io
import json
import zipfile
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from answers import refused
from npy_files import DAMAGED
from toy_runs import assert_same, observe, row

from dynappo import algorithm, terms
from dynappo import config as config_lib
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.evaluate import recording
from dynappo.physics import actuators
from dynappo.policy import policy_file, policy_source
from dynappo.tasks import of_robots
from dynappo.tasks.velocity import log_file, logged, rewards
from dynappo.tasks.velocity import observe as observe_lib

SECONDS = 11


def configured(variant="logs", **task):
    """`(config, robot)` of a Go1 on C MuJoCo, which needs no compilation of physics."""
    config = config_lib.load(f"configs/go1.py:{variant}")
    config.physics.impl = "c"
    config.task.update(task)
    config.task.weights.update(joint_limits=-5.0, energy=-1e-3, action_acceleration=-0.01)
    return motors.fitted(config_lib.validate(config), robot_lib.load("go1"))


@pytest.fixture(scope="module")
def walked():
    """`(player, arrays)`: the bundled Go1 under its own mean actions."""
    policy, _ = policy_source.load("go1")
    player, _ = policy_source.player(policy)
    return player, recording.record(player, SECONDS)


@pytest.fixture
def write(walked, tmp_path):
    """`write(about, **arrays) -> path`: that recording with these entries; None takes one out."""
    player, arrays = walked

    def to(about=None, **changes):
        path = tmp_path / "log.npz"
        facts = recording.about(player) | (about or {})
        every = {name: x for name, x in (arrays | changes).items() if x is not None}
        log_file.save(path, {n: x for n, x in facts.items() if x is not None}, every)
        return str(path)

    return to


# ---- recording


def test_a_recording_is_what_the_policy_saw_and_did(walked):
    """The policy, given the readings of an entry and the action before, answers with the entry's action."""
    player, arrays = walked
    count, policy = len(arrays["time"]), player.policy
    assert count == SECONDS / 0.02 + 1 and not arrays["fell"].any()
    np.testing.assert_allclose(np.diff(arrays["time"]), 0.02, rtol=1e-6)
    before = np.concatenate([np.zeros((1, 12)), arrays["action"][:-1]])
    obs = np.concatenate([*(arrays[name] for name in log_file.SEEN), before], 1)[:-1]
    act = policy_file.actor(policy.params, policy.activation)
    np.testing.assert_allclose(act(obs), arrays["action"][:-1], atol=1e-4)
    commands = np.unique(arrays["command"], axis=0)
    assert SECONDS / 3 <= len(commands) <= SECONDS / 2 + 1 and (abs(commands) <= 1).all()
    error = arrays["linear_velocity"][:, :2] - arrays["command"][:, :2]
    assert np.median(np.linalg.norm(error, axis=1)) < 0.15  # it does walk
    assert 0.3 < arrays["contact"].mean() < 0.9


def test_noise_is_on_actions_or_on_readings_and_a_fall_begins_another_episode(walked):
    player, arrays = walked
    both = [recording.record(player, 1, exploration=0.3), recording.record(player, 1, sensors=1.0)]
    first = {name: [one[name][0] for one in both] for name in ("action", "joint_velocity")}
    np.testing.assert_array_equal(first["joint_velocity"][0], arrays["joint_velocity"][0])
    off = first["action"][0] - arrays["action"][0]
    assert 0.1 < off.std() < 0.6
    off = both[1]["joint_velocity"] - arrays["joint_velocity"][: len(both[1]["time"])]
    assert abs(off[0]).max() < 1.5 and abs(off[0]).std() > 0.1
    weak = recording.record(player, 3, strength=0.1)
    falls = np.flatnonzero(weak["fell"])
    assert len(falls) and (np.diff(weak["time"])[falls[falls < len(weak["time"]) - 1]] > 0.5).all()


# ---- the environment


@pytest.fixture(scope="module")
def world(walked, tmp_path_factory):
    """The environment of a log with a fall and a gap, its entries, and what wrote it."""
    player, arrays = walked
    arrays = {name: x.copy() for name, x in arrays.items()}
    arrays["fell"][200], arrays["time"][400:] = True, arrays["time"][400:] + 7
    arrays["action"] += 0.1 * np.random.default_rng(0).standard_normal(arrays["action"].shape)
    path = tmp_path_factory.mktemp("log") / "log.npz"
    recording.save(path, player, arrays)
    config, robot = configured()
    log = log_file.load(str(path), robot, config)
    env = logged.make(of_robots.make(config, robot, impl="c"), log, robot, config.task)
    return config, robot, env, log, arrays


def test_a_log_is_split_where_the_robot_fell_and_where_time_jumps(world):
    config, _, _, log, arrays = world
    ends = [200, 399, len(arrays["time"]) - 1]
    assert [(e.start, e.stop - 1) for e in log_file.episodes(log)] == [
        *zip([0, *(end + 1 for end in ends[:-1])], ends, strict=True)
    ]
    assert "3 episodes, 1 falls" in log_file.in_words(log, config)


def test_a_step_is_the_row_of_the_log(world):
    """Whatever action it is given; at an episode's end the robot is put somewhere else."""
    config, _, env, _, arrays = world
    _, hyper = config_lib.split(config)
    start = jax.jit(partial(env.reset, hyper, None))(jax.random.key(0))

    def walk(state, key):
        after, outcome = env.step(hyper, None, state, jnp.full(12, 9.0), key)
        return env.autoreset(hyper, None, after, outcome, key), (
            state,
            env.recorded(state),
            outcome,
        )

    first = start.replace(entry=jnp.int32(190), obs=start.obs, episode_steps=jnp.int32(0))
    keys = jax.random.split(jax.random.key(1), 500)
    _, (states, actions, outcomes) = jax.jit(partial(jax.lax.scan, walk))(first, keys)
    t = np.asarray(states.entry)
    assert t[:11].tolist() == [*range(190, 200), t[10]] and t[10] not in (200, 201)
    assert not set(t.tolist()) & {200, 399, len(arrays["time"]) - 1}
    np.testing.assert_allclose(actions, arrays["action"][t], rtol=1e-6)
    names = [*log_file.SEEN]
    seen = np.concatenate([arrays[name] for name in names], 1)
    np.testing.assert_allclose(states.obs[1:, :36], seen[t[1:]], rtol=1e-6)
    np.testing.assert_allclose(outcomes.next_obs[:, :36], seen[t + 1], rtol=1e-6)
    np.testing.assert_allclose(outcomes.next_obs[:, 36:], arrays["action"][t], rtol=1e-6)
    np.testing.assert_array_equal(outcomes.next_prop, outcomes.next_obs[:, :33])
    np.testing.assert_array_equal(outcomes.discount, (t + 1 != 200) * 1.0)
    ends = np.isin(t + 1, [399, len(arrays["time"]) - 1])
    np.testing.assert_array_equal(outcomes.truncation, ends * 1.0)
    first_rows = np.isin(t, [0, 201, 400])
    if first_rows.any():
        assert not np.asarray(states.obs)[first_rows, 36:].any()


def test_the_reward_is_that_of_the_terms_that_a_log_tells(world):
    """Row by row in NumPy, from what the arrays say; the swing of a foot is counted by hand."""
    config, robot, env, log, arrays = world
    _, hyper = config_lib.split(config)
    task, default, dt = config.task, robot.default_pose, 0.02
    entries = np.array([*range(203, 260)])
    start = env.reset(hyper, None, jax.random.key(0))
    obs = logged.of_log(log, logged.view.make("full", 1, 12)).obs
    states = jax.vmap(lambda t, o: start.replace(entry=t, obs=o, prop=o[:33]))(
        entries, obs[entries]
    )
    step = jax.vmap(partial(env.step, hyper, None), (0, None, None))
    _, outcomes = jax.jit(step)(states, jnp.zeros(12), jax.random.key(0))
    low, high = robot.mj_model.jnt_range[1:].T
    spare = 0.05 * (high - low)
    expected = []
    for t in entries:
        now = {name: arrays[name][t + 1].astype(float) for name in observe_lib.PREDICTED}
        action, before, older = arrays["action"][[t, t - 1, t - 2]]
        q = arrays["joint_position"][t + 1] + default
        torque = (
            task.kp * (default + task.action_scale * action - q) - task.kd * now["joint_velocity"]
        )
        limits = (
            np.asarray(task[n]) for n in ("effort_limit", "saturation_effort", "velocity_limit")
        )
        names = "effort_limit", "saturation_effort", "velocity_limit"
        torque = actuators.clip_dc_motor(
            torque, now["joint_velocity"], **dict(zip(names, limits, strict=True))
        )
        down = arrays["contact"][201 : t + 2]
        touchdown = down[-1] & ~down[-2]
        air = np.zeros(4)
        for foot in np.flatnonzero(touchdown):
            swing = down[:-1, foot][::-1]
            air[foot] = dt * (np.argmax(swing) if swing.any() else len(swing) - 1)
        w, command = task.weights, arrays["command"][t]
        acceleration = (now["joint_velocity"] - arrays["joint_velocity"][t]) / dt
        per_second = (
            w.track_linear_velocity
            * rewards.track_linear_velocity(now["linear_velocity"], command, task.tracking_std)
            + w.track_yaw_rate
            * rewards.track_yaw_rate(now["angular_velocity"], command, task.tracking_std)
            + w.vertical_velocity * now["linear_velocity"][2] ** 2
            + w.roll_pitch_rate * (now["angular_velocity"][:2] ** 2).sum()
            + w.flat_orientation * (now["gravity"][:2] ** 2).sum()
            + w.joint_torques * (torque**2).sum()
            + w.joint_accelerations * (acceleration**2).sum()
            + w.energy * abs(torque * now["joint_velocity"]).sum()
            + w.joint_limits * np.clip(np.maximum(low + spare - q, q - high + spare), 0, None).sum()
            + w.action_acceleration * ((action - 2 * before + older) ** 2).sum()
            + w.action_rate * ((action - before) ** 2).sum()
            + w.feet_air_time * ((air - 0.5) * touchdown).sum() * (np.hypot(*command[:2]) > 0.1)
        )
        expected.append(dt * per_second)
    np.testing.assert_allclose(outcomes.reward, expected, rtol=2e-3, atol=2e-5)
    assert np.ptp(expected) > 1e-3
    assert log_file.left_out(task, log) == []
    without = log._replace(contact=None)
    assert log_file.left_out(task, without) == ["feet_air_time"]
    assert "it does not tell feet_air_time" in log_file.in_words(without, config)


def test_a_policy_that_sees_readings_before_sees_those_of_the_log(world):
    """Against the memory that a player has."""
    log = world[3]
    config, robot = configured(observation="onboard", history=3)
    layout = logged.view.make("onboard", 3, 12, logged.randomize.varied(config.task.randomize))
    entries, views = logged.of_log(log, layout), logged.view.views(layout)
    assert views is not None
    for episode in log_file.episodes(log):
        see = observe_lib.memory("onboard-45", 3)
        for t in range(episode.start, min(episode.stop, episode.start + 6)):
            previous = log.readings["action"][t - 1] * (t > episode.start)
            now = np.concatenate([*(log.readings[n][t] for n in log_file.SEEN), previous])
            np.testing.assert_array_equal(entries.obs[t][views.actor], see(now))


# ---- the method


@pytest.fixture(scope="module")
def replayed():
    """Two iterations of a toy whose robots do what a record says: another action in every state."""
    env = toy_env.make()._replace(recorded=lambda state: jnp.sin(7 * state.prop[:2]))
    config, static, hyper = toy_env.settings(toy_env.TAIL | {"ppo.value_first": 1})
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    call, states = observe(env, static), [state]
    for i in (1, 2):
        rows, state, _ = call(hyper, state, row(config, n_real=4, first=i))
        states.append(state)
    return env, static, hyper, rows, states


def test_ppo_learns_from_no_recorded_row_and_the_model_from_all(replayed):
    env, static, hyper, rows, states = replayed
    expected = jax.vmap(jax.vmap(lambda prop: jnp.sin(7 * prop[:2])))(rows.prop[:4])
    np.testing.assert_allclose(rows.action[:4], expected, atol=1e-6)
    assert abs(rows.action[4:] - rows.action_mean[4:]).max() > 0.5
    params, real = states[1].learner.params, (jnp.arange(8) < 4)[:, None]
    for own, weight in ((env, 0), (toy_env.make(), 1)):
        batch = algorithm.estimate(static, hyper, own, params=params, rows=rows, real=real)
        assert (
            batch.weight is not None
            and (batch.weight[:4] == weight).all()
            and (batch.weight[4] == 1).all()
        )
    first, later = (jax.tree.leaves(states[i].model.params)[0] for i in (0, 1))
    assert (first != later).any()


def test_the_value_function_may_learn_first(replayed):
    """The policy waits, to the bit; then it moves."""
    first, held, moved = (state.learner.params for state in replayed[-1])
    for name in ("actor", "std"):
        assert_same(held[name], first[name])
        pairs = zip(*map(jax.tree.leaves, (held[name], moved[name])), strict=True)
        assert any((a != b).any() for a, b in pairs)
    kernels = [x["critic"]["params"]["Dense_0"]["kernel"] for x in (first, held)]
    assert (kernels[0] != kernels[1]).any()


# ---- what is refused


def test_joints_and_feet_may_have_another_order(write, walked):
    """As in a file exported with --joint-order."""
    config, robot = configured()
    expected = log_file.load(write(), robot, config)
    player, arrays = walked
    order, feet = np.random.default_rng(1).permutation(12), [2, 0, 3, 1]
    names = player.policy.joint_names
    about = dict(
        joint_names=[names[i] for i in order],
        default_pose=player.policy.default_pose[order].tolist(),
        foot_names=[player.foot_names[i] for i in feet],
        robot=None,  # the text need not name it
    )
    moved = {n: arrays[n][:, order] for n in ("joint_position", "joint_velocity", "action")}
    found = log_file.load(write(about, **moved, contact=arrays["contact"][:, feet]), robot, config)
    assert_same(found._asdict(), expected._asdict())


NAMES = robot_lib.load("go1").joint_names
REFUSED = {  # entries of `about`, what becomes of the arrays, what the line must say
    "joints": (dict(joint_names=["knee"]), {}, "its joint_names are ['knee'], expected FL_hip"),
    "a joint less": (
        dict(joint_names=NAMES[:-1]),
        {},
        f"its joint_names lack {NAMES[-1]}, expected FL_hip",
    ),
    "a joint more": (
        dict(joint_names=[*NAMES, "x"]),
        {},
        "its joint_names have too many: x, expected FL_hip",
    ),
    "robot": (
        dict(robot="go2"),
        {},
        "it is of the robot 'go2', expected go1; train with a --config of that",
    ),
    "degrees": (
        {},
        dict(joint_position=lambda x: np.rad2deg(x + 1)),
        "expected -0.863 to 0.863; is it in degrees",
    ),
    "upside down": ({}, dict(gravity=lambda x: -x), "expected about -1 of a robot that stands"),
    "no joints": (dict(joint_names=None), {}, "its text `about` lacks joint_names"),
    "period": (dict(control_dt=0.01), {}, "its control_dt is 0.01, expected 0.02 s"),
    "gains": (dict(kp=40.0), {}, "its kp is 40.0, expected 25.0 as in the config"),
    "pose": (dict(default_pose=[0.0] * 12), {}, "its default_pose is [0.0, "),
    "text": (dict(kd="soft"), {}, "its kd is 'soft', expected 0.5"),
    "feet": (dict(foot_names=None), {}, "its foot_names are None, expected "),
    "NaN": (
        {},
        dict(action=lambda x: x / (x != x[7])),
        "in 1 of 551 entries, the first is entry 7;",
    ),
    "no velocity": ({}, dict(linear_velocity=None), "shape (551, 3); no sensor tells it"),
    "no time": (
        {},
        dict(time=None),
        "it has no array `time`, expected numbers of the shape [T], s",
    ),
    "since 1970": (
        {},
        dict(time=lambda x: np.float32(x + 1.7e9)),
        "expected control_dt = 0.02; time is float32 of 1700000000 s: subtract its first, or save float64",
    ),
    "no fell": ({}, dict(fell=None), "it has no array `fell`"),
    "empty": ({}, dict(time=lambda x: x[:0]), "it has no entries"),
    "narrow": (
        {},
        dict(command=lambda x: x[:, :2]),
        "command has the shape (551, 2), expected (551, 3)",
    ),
    "two feet": ({}, dict(contact=lambda x: x[:, :2]), "contact has the shape (551, 2)"),
    "fast": ({}, dict(time=lambda x: x / 2), "its entries are 0.01 s apart, expected control_dt"),
    "short": ({}, dict(fell=lambda x: np.arange(len(x)) % 5 > 1), "it has 4.4 s of control steps"),
    "accelerometer": (
        {},
        dict(gravity=lambda x: 9.81 * x),
        "gravity has the length 9.81, expected 1",
    ),
    "words": ({}, dict(command=lambda x: x.astype(str)), "command holds <U"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_log_that_does_not_fit_is_one_line(write, walked, name):
    about, arrays, said = REFUSED[name]
    config, robot = configured()
    with np.errstate(divide="ignore", invalid="ignore"):
        changed = {n: change and change(walked[1][n]) for n, change in arrays.items()}
    path = write(about, **changed)
    line = refused(log_file.load, path, robot, config)
    assert line.startswith(f"--logs={path}: ") and said in line


def zipped(entry):
    """A zip with this entry as the array `time`."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        file.writestr("time.npy", entry)
    return out.getvalue()


def test_what_is_no_log_is_one_line(tmp_path, write):
    config, robot = configured()
    path = tmp_path / "log.npz"
    of_damaged = [zipped(entry) for entry in DAMAGED.values()]
    for data in (b"", b"PK\x03\x04junk", b"\x93NUMPY\x01\x00v\x00{}", *of_damaged):
        path.write_bytes(data)
        assert "not an .npz of arrays, or damaged" in refused(
            log_file.load, str(path), robot, config
        )
    np.save(path.with_suffix(".npy"), np.zeros(3))
    line = refused(log_file.load, str(path.with_suffix(".npy")), robot, config)
    assert "not an .npz of arrays" in line
    assert "cannot be read" in refused(log_file.load, str(tmp_path / "none.npz"), robot, config)
    np.savez(path, about=json.dumps(["joint_names"]))
    assert "lacks joint_names, default_pose" in refused(log_file.load, str(path), robot, config)
    np.savez(path, about="{joint_names: soft}")
    assert "its text `about` is not JSON; robots/" in refused(
        log_file.load, str(path), robot, config
    )
    good = write()
    log_file.load(good, robot, config, log_file.digest(good))
    assert "another file" in refused(log_file.load, good, robot, config, "0" * 16)


@pytest.mark.parametrize(
    ("variant", "fields", "said"),
    [
        ("best", {}, "an iteration has no tail"),
        ("ppo16", {}, "an iteration has no tail"),
        ("logs", {"task.heading": True}, "rough ground, headings, a gait clock"),
    ],
)
def test_a_schedule_or_a_task_without_use_for_a_log_is_refused(variant, fields, said):
    config = config_lib.load(f"configs/go1.py:{variant}")
    config.run.logs = "walked.npz"
    for name, value in fields.items():
        config_lib.override(config, name, str(value))
    line = refused(config_lib.validate, config)
    assert line.startswith("run.logs is 'walked.npz', expected ''") and said in line


MINE = {  # terms that add a number to the observation
    "tall": "@terms.observation(size=1)\ndef tall(qpos):\n    return qpos[2:3]",
    "ever": "@terms.known(start=(0.0,))\ndef ever(ever):\n    return ever + 1",
    "level": "@terms.curriculum(start=0.0)\ndef level(level):\n    return level + 1",
}


@pytest.mark.parametrize("name", MINE)
def test_an_observation_that_no_log_tells_is_refused(tmp_path, write, name):
    """What a log tells of it would be shorter than what networks see; a reward may stay."""
    paid = "from dynappo import terms\n@terms.reward(weight=-1.0)\ndef high(qpos):\n    return qpos[2]\n"
    for text in (paid, paid + MINE[name]):
        (tmp_path / "mine.py").write_text(text)
        config = config_lib.load("configs/go1.py:logs")
        config.run.logs = write()
        terms.use(config, terms.read(tmp_path / "mine.py"))
        config, robot = motors.fitted(config_lib.validate(config), robot_lib.load("go1"))
        if text == paid:
            assert "it does not tell high" in of_robots.about_log(config, robot)
    line = refused(of_robots.about_log, config, robot)
    assert line.startswith(
        f"run.logs is {config.run.logs!r}, expected '' where task.terms = mine.py"
    )
    assert f"adds {name} to the observation, which no log tells" in line
