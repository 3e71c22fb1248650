"""docs/task.md: its terms are taken from the page, and used as a reader would, with the package as it is.

Reward term, observations, command and termination against C MuJoCo and NumPy, one iteration with a tail, and
an episode of the policy in NumPy. The slow test does what the page says in an empty folder, with the wheel.
"""

import functools
import json
import os
import re
import shlex
import subprocess
import sys
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest
from answers import ROOT

from dynappo import algorithm, schedule, terms
from dynappo import config as config_lib
from dynappo.config import ConfigError, flags
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.export import joint_order, onnx_file
from dynappo.physics import actuators, randomize
from dynappo.policy import episode, policy_file, policy_source
from dynappo.program import build
from dynappo.tasks import of_robots
from dynappo.tasks.velocity import observe, reward_sum

PAGE = (ROOT / "docs" / "task.md").read_text()
ROBOTS, ROWS, DT = 16, 30, 0.02
SMALL = {
    "rollout": dict(num_envs=ROBOTS, horizon=4),
    "schedule": dict(start_iteration=0, end_iteration=0, start_steps=2, end_steps=2),
    "model": dict(hidden=(16,), epochs=1, late_epochs=None, minibatches=2),
    "ppo": dict(hidden=(16,), epochs=1, minibatches=1, shuffle_blocks=1),
}


def blocks(kind):
    """`{title of the section: its blocks of this kind}` of the page."""
    sections = re.split(r"^## ", PAGE, flags=re.M)[1:]
    found = {
        s.split("\n")[0]: re.findall(rf"^```{kind}\n(.*?)^```", s, re.M | re.S) for s in sections
    }
    return {title: texts for title, texts in found.items() if texts}


CODE = blocks("python")
FOUR = ["A reward term", "An observation", "A command", "A termination"]


def write(folder, titles=FOUR, name="my_terms.py"):
    path = folder / name
    path.write_text("\n".join(text for title in titles for text in CODE[title]))
    return path


def test_the_page_has_an_example_of_each_kind():
    assert list(CODE) == [*FOUR, "A curriculum"]
    kinds = set(re.findall(r"@terms\.(\w+)", "".join(sum(CODE.values(), []))))
    assert kinds == {"reward", "observation", "known", "command", "termination", "curriculum"}


@pytest.mark.parametrize("title", [*FOUR, "A curriculum"])
def test_each_example_works_alone(title, tmp_path):
    """It is found, named in the config, and passes the check of a run."""
    path = write(tmp_path, [title])
    config = flags.load("go1:laptop", [f"--config.task.terms={path}"])
    build.check(config_lib.validate(config))
    names = re.findall(r"^def (\w+)", "".join(CODE[title]), re.M)
    assert sorted(term.name for term in terms.of(config.task).every()) == sorted(names)
    own = {"An observation": "velocity-own-51"}.get(title, "velocity-48")
    robot = robot_lib.load("go1")
    if title != "A curriculum":  # whose number no policy sees
        assert policy_file.describe(config, robot).observation == own


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """A tiny run with the page's four on C MuJoCo, and rows of random actions."""
    path = write(tmp_path_factory.mktemp("mine"))
    (command,) = blocks("sh")["A command"]
    words = [w for w in shlex.split(command) if w.startswith("--config.")]
    assert words[1:] == ["--config.task.command_x=(0.0,2.0)"]
    config = flags.load("go1:laptop", [f"--config.task.terms={path}", words[1]])
    for group, fields in SMALL.items():
        config[group].update(fields)
    config = config_lib.validate(config)
    build.check(config)
    config, robot = motors.fitted(config, robot_lib.load("go1"))
    static, hyper = config_lib.split(config)
    env = of_robots.make(config, robot, impl="c")
    one = np.ones(ROBOTS, np.float32)
    com = robot.mj_model.body_ipos[robot.base_body].astype(np.float32)
    body = randomize.Body(one, np.tile(com, (ROBOTS, 1)), one * 0.8, one, one)
    step = jax.jit(jax.vmap(env.step, (None, 0, 0, 0, 0)))
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    state = jax.device_get(jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys))
    rng, rows = np.random.default_rng(0), []
    for _ in range(ROWS):
        action = rng.normal(0, 0.5, (ROBOTS, 12)).astype(np.float32)
        after, outcome = jax.device_get(step(hyper, body, state, action, keys))
        rows.append(SimpleNamespace(before=state, action=action, after=after, outcome=outcome))
        state = after
    own = observe.own(config.task.terms_about)
    return SimpleNamespace(
        path=path, config=config, robot=robot, env=env, static=static, hyper=hyper, rows=rows,
        places=observe.slices(12, own=own), own=own,
        step=lambda hyper: jax.device_get(step(hyper, body, rows[-1].before, rows[-1].action, keys)),
    )  # fmt: skip


def power_of(world, model, row, i):
    """Of the last physics step of a control step, by C MuJoCo: W."""
    data, task = mujoco.MjData(model), world.config.task
    for field in ("qpos", "qvel", "qacc_warmstart"):
        getattr(data, field)[:] = getattr(row.before, field)[i]
    target = world.robot.default_pose + task.action_scale * row.action[i]
    names = "effort_limit", "saturation_effort", "velocity_limit"
    limits = {name: np.array(task[name]) for name in names}  # one number, or one a joint
    for _ in range(4):
        qd = data.qvel[6:].copy()
        torque = actuators.clip_dc_motor(
            task.kp * (target - data.qpos[7:]) - task.kd * qd, qd, **limits
        )
        data.ctrl[:] = torque
        mujoco.mj_step(model, data)
    return sum(max(float(t) * float(v), 0) for t, v in zip(torque, data.qvel[6:], strict=True))


def test_the_reward_term_is_what_c_mujoco_says(world):
    model = robot_lib.physics_model(world.robot, world.config.physics)
    off = []
    for row in world.rows[::3]:
        found = row.outcome.metrics["reward_motor_work"]
        for i in range(0, ROBOTS, 5):
            expected = -1e-3 * power_of(world, model, row, i)
            off.append(abs(found[i] - expected) / abs(expected))
        parts = [v for name, v in row.outcome.metrics.items() if name.startswith("reward_")]
        np.testing.assert_allclose(row.outcome.reward, DT * np.sum(parts, axis=0), atol=1e-5)
    assert np.median(off) < 1e-3
    known = reward_sum.known(reward_sum.terms_of(world.config.task), world.config.task)
    assert "motor_work" not in known and "action_rate" in known


def test_lifted_feet_are_as_high_above_the_lowest_one_as_c_mujoco_says(world):
    """In training, and computed in the tail: 0 where all stand, whatever the base's height and tilt."""
    model, lifted = world.robot.mj_model, []
    data, feet = mujoco.MjData(model), world.robot.feet
    assert len(feet) == 4  # a sphere each, so its middle is the foot's
    for row in world.rows[::3]:
        for i in range(0, ROBOTS, 3):
            data.qpos[:] = row.after.qpos[i]
            mujoco.mj_kinematics(model, data)
            up = data.geom_xpos[feet, 2]
            walks = np.linalg.norm(row.before.command[i]) > 0.1
            expected = np.clip(up - up.min(), 0, 0.08).sum() * walks
            found = row.outcome.metrics["reward_lift_feet"][i]
            assert found == pytest.approx(expected, abs=1e-5)
            lifted.append(found)
    assert 0.01 < np.mean(lifted) < 0.2
    known = reward_sum.known(reward_sum.terms_of(world.config.task), world.config.task)
    assert "lift_feet" in known


def test_the_observations_are_where_the_base_is_and_what_the_clock_says(world):
    height, clock = world.places["base_height"], world.places["gait_clock"]
    assert (world.env.obs_size, world.env.prop_size) == (51, 34) and height == slice(33, 34)
    noise = []
    for k, row in enumerate(world.rows):
        after, size = row.after, world.env.prop_size
        np.testing.assert_allclose(after.prop[:, height], after.qpos[:, 2:3])
        noise.append(after.obs[:, height] - after.qpos[:, 2:3])
        angle = 2 * np.pi * 2.0 * DT * (k + 1)
        expected = np.tile([np.sin(angle), np.cos(angle)], (ROBOTS, 1))
        np.testing.assert_allclose(after.obs[:, clock], expected, atol=1e-5)
        # what the model's tail is given
        advance = jax.vmap(world.env.advance, (None, 0, 0, 0, 0))
        before = row.before.obs[:, size:], row.before.prop
        known = advance(world.hyper, *before, row.action, after.prop)
        np.testing.assert_allclose(known, after.obs[:, size:], atol=1e-5)
    assert 0.01 < np.abs(noise).max() <= 0.02 and np.min(noise) < 0 < np.max(noise)
    index, sign = world.env.mirror[0]
    assert sign[clock].tolist() == [-1, -1] and sign[33] == 1
    assert index[33] == 33 and index[clock].tolist() == [49, 50] and sorted(index) == [*range(51)]


def test_the_command_walks_or_turns(world):
    command = world.rows[0].before.command
    walks = command[:, 0] != 0
    assert walks.any() and not walks.all() and not command[:, 1].any()
    np.testing.assert_array_equal(walks, command[:, 2] == 0)
    assert 0 <= command[:, 0].min() and 1 < command[:, 0].max() <= 2
    assert -1 <= command[:, 2].min() < 0 < command[:, 2].max() <= 1
    told = jax.vmap(world.env.retell, (None, 0, 0))
    keys = jax.random.split(jax.random.key(3), 400)
    context = np.tile(world.rows[0].before.obs[:1, world.env.prop_size :], (400, 1))
    fresh = np.asarray(told(world.hyper, context, keys))
    np.testing.assert_array_equal(fresh[:, 3:], context[:, 3:])
    assert 0.4 < (fresh[:, 0] != 0).mean() < 0.6 and (fresh[:, 0] * fresh[:, 2] == 0).all()


def test_a_robot_that_is_lower_falls_and_no_other_does(world):
    def at(height):
        task = world.hyper.task
        hyper = task._replace(own=task.own._replace(min_height=np.float32(height)))
        return world.step(world.hyper._replace(task=hyper))[1]

    before, height = at(0.0), world.places["base_height"]
    limit = np.float32(np.median(before.next_prop[:, height]))
    after, low = at(limit), before.next_prop[:, height][:, 0] < limit
    assert low.any() and not low.all() and before.discount.any()
    np.testing.assert_array_equal(after.discount, np.where(low, 0.0, before.discount))
    np.testing.assert_array_equal(after.metrics["falls"], 1 - after.discount)
    np.testing.assert_array_equal(after.metrics["ended_too_low"], low)


@pytest.fixture(scope="module")
def params(world):
    """Untrained networks."""
    init = functools.partial(algorithm.init, world.env, static=world.static)
    return jax.device_get(jax.jit(init)(world.hyper, jax.random.key(1)))


def test_an_iteration_with_a_tail_has_them_all(world, params):
    columns = {name: column[:1] for name, column in schedule.columns(world.config).items()}
    assert int(columns["n_real"][0]) == 2
    run = functools.partial(algorithm.run, world.env, static=world.static)
    after, metrics = jax.eval_shape(run, world.hyper, params, columns)
    assert {"reward_motor_work", "model_loss", "ended_too_low"} <= set(metrics)
    assert jax.tree.structure(after) == jax.tree.structure(params)


def test_the_policy_plays_and_is_exported(world, params, tmp_path, monkeypatch):
    path = tmp_path / "policy.npz"
    policy_file.save(path, params.learner.params, world.config, world.robot)
    policy = policy_file.load(path)
    assert policy.observation == "velocity-own-51" and policy.own == world.own
    text = np.load(path)["about"].item()
    assert "def " not in text and "return" not in json.dumps(json.loads(text)["config"]["task"])
    act, seen = policy_file.actor(policy.params, policy.activation), []

    def looked(obs):
        seen.append(obs)
        return act(obs)

    body, note = policy_source.player(policy)
    assert not note
    played = episode.play(body, looked, lambda t: np.array([2.0, 0.0, 0.0]), 0.6)
    angle = 2 * np.pi * 2.0 * DT * np.arange(len(seen))
    clock = np.stack([np.sin(angle), np.cos(angle)], -1)
    np.testing.assert_allclose(np.array(seen)[:, world.places["gait_clock"]], clock, atol=1e-6)
    heights = np.array(seen)[1:, world.places["base_height"]][:, 0]
    np.testing.assert_allclose(heights, played["qpos"][:-1, 2])
    high = body._replace(given={**body.given, "min_height": 1.0})
    fell = [episode.play(p, act, lambda t: np.zeros(3), 0.02)["fell"].any() for p in (body, high)]
    assert fell == [False, True]

    monkeypatch.setattr(terms, "_READ", {})  # as in another process: nobody has named the file
    rows = {row["name"]: row for row in onnx_file.observation_table(policy)}
    sizes = {name: row["stop"] - row["start"] for name, row in rows.items()}
    assert sizes["gait_clock"] == 2 and sizes["base_height"] == 1 and sum(sizes.values()) == 51
    assert rows["base_height"]["noise"] == 0.02 and rows["base_height"]["unit"] == "m"
    assert rows["base_height"]["content"] == "Of the base's frame above the floor."
    turned = joint_order.permute(policy, policy.joint_names[::-1])
    first = [p.params["actor"]["params"]["Dense_0"]["kernel"] for p in (policy, turned)]
    for name in ("base_height", "gait_clock"):
        where = world.places[name]
        np.testing.assert_array_equal(first[0][where], first[1][where])
    with pytest.raises(ConfigError, match="sees base_height, gait_clock: .* --terms=FILE"):
        policy_source.player(policy)
    again, named = policy_source.with_terms(policy, world.path)
    assert named == ", with my_terms.py" and policy_source.player(again)[1] == ""


SHORT = """
--config.rollout.num_envs=16 --config.run.log_every=2 --config.run.eval_envs=2 --config.run.eval_steps=20
--config.run.video_seconds=0 --config.ppo.hidden=(16,) --config.model.hidden=(16,) --config.model.epochs=1
""".split()


@pytest.mark.slow
@pytest.mark.timeout(3600)  # two minutes of two idle cores
def test_the_wheel_does_what_the_page_says_in_an_empty_folder(tmp_path):
    """Train, go on, sweep, evaluate, play, export: only the wheel and the reader's own file are there."""
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", tmp_path, ROOT], check=True)
    (wheel,) = tmp_path.glob("dynappo-*.whl")
    site, folder = tmp_path / "site", tmp_path / "empty"
    folder.mkdir()
    subprocess.run([*pip, "install", "--no-deps", "--target", site, wheel], check=True)
    write(folder)
    write(folder, ["A curriculum"], "level.py")
    around = os.environ | {"PYTHONPATH": str(site), "JAX_PLATFORMS": "cpu"}
    train, play, evaluate, export = blocks("sh")["A run, a policy, and the file"][0].splitlines()
    (command,) = blocks("sh")["A command"]

    def run(line, *more, status=0):
        _, name, *words = shlex.split(line)
        words = [name, *words] if name == "-c" else ["-m", f"dynappo.{name}", *words]
        done = subprocess.run(
            [sys.executable, *words, *more], cwd=folder, env=around, text=True, capture_output=True
        )
        assert done.returncode == status, f"{line}\n{done.stdout[-3000:]}\n{done.stderr[-5000:]}"
        return done.stdout + done.stderr

    four = "motor_work, lift_feet, base_height, gait_clock, too_low, ahead_or_turn"
    assert f"with terms of my_terms.py: {four}" in run(
        command, *SHORT, "--config.run.num_iterations=2", "--workdir=runs/terms"
    )
    longer = "--config.run.num_iterations=4"
    told = "--config.task.command_x=(0.0,2.0)"
    assert "goes on from iteration 2" in run(train, told, *SHORT, longer)
    assert "--terms=FILE" in run("dynappo train --workdir=runs/terms", status=2)
    head = (folder / "runs/terms/metrics.csv").read_text().split("\n")[0].split(",")
    assert {"reward_motor_work", "ended_too_low"} <= set(head)
    assert "with my_terms.py" in run(play, "--seconds=1")
    assert "name the file" in run("dynappo play runs/terms --out=walk.html", status=2)
    run(export)
    assert "with my_terms.py" in run(evaluate, "--fast")
    found = json.loads((folder / "runs/terms/evaluation/evaluation.json").read_text())
    assert len(found["sweep"]["commands"]) > 9
    # the task's episodes alone: all of `evaluate` takes minutes on two busy cores
    code = "from pathlib import Path; from dynappo.evaluate import episodes; "
    code += "from dynappo.policy import policy_source as s; policy = s.load('runs/terms')[0]; "
    code += "policy = s.with_terms(policy, Path('my_terms.py'))[0]; "
    code += "print(episodes.run(policy, 2)['episodes'], 'episodes')"
    assert "2 episodes" in run("dynappo " + shlex.join(["-c", code]))
    swept = "--sweep=task.weights.motor_work=-1e-3,-2e-3"
    out = run(train.replace("runs/terms", "runs/sweep"), swept, *SHORT, longer)
    assert "1 program to compile" in out and "--terms=my_terms.py" in out
    (folder / "my_terms.py").write_text((folder / "my_terms.py").read_text() + "# other\n")
    assert "the code of its terms, my_terms.py, is another now" in run(
        train, told, *SHORT, longer, status=2
    )
    assert "which has changed since the training" in run(play, "--seconds=1")
    level = "dynappo train --config=go1:laptop --config.task.terms=level.py --workdir=runs/level"
    assert "with terms of level.py: level, faster" in run(level, *SHORT, longer)
    rows = (folder / "runs/level/metrics.csv").read_text().split("\n")
    place = rows[0].split(",").index("curriculum_level")
    assert 0.1 <= float(rows[-2].split(",")[place]) <= 1.0
