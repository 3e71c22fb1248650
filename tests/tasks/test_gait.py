"""The gait clock against plain loops, in tails, mirrored, in C MuJoCo's episodes; and where there is none."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import other_robots
import pytest

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.description import robot as robot_lib
from dynappo.evaluate import stress
from dynappo.export import deploy_yaml, joint_order, onnx_file
from dynappo.learner import symmetry
from dynappo.policy import episode, policy_file
from dynappo.program import build
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import gait, mirror, observe, reward_sum, view

ROBOTS, ROWS, DT = 16, 40, 0.02
RANGE = (1.25, 1.5)  # Hz
WHERE = observe.slices(12, True)
MOVES, STANDS = np.array([0.5, 0.2, -0.3]), np.array([0.05, 0.0, 0.05])


def settings(**task):
    config = config_lib.load("configs/go1.py:laptop")
    config.physics.threads = 1
    config.task.update(gait_frequency=RANGE, kp=60.0, kd=2.0, **task)
    config.task.weights.update(feet_phase=1.0)
    config.task.noise.update(dict.fromkeys(config.task.noise, 0.0))
    return config


@pytest.fixture(scope="module")
def world():
    """A biped of 12 joints, and rows of random small actions; every sixth robot is told to stand."""
    robot, config = other_robots.biped(), config_lib.validate(settings(standing=0.3))
    hyper = config_lib.split(config)[1]
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    keys, rng = jax.random.split(jax.random.key(0), ROBOTS), np.random.default_rng(0)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    reset = jax.jit(jax.vmap(env.reset, (None, 0, 0)))
    state = jax.device_get(reset(hyper, body, keys))
    step = jax.jit(jax.vmap(env.step, (None, 0, 0, 0, 0)))
    states, actions = [state], rng.normal(0, 0.1, (ROWS, ROBOTS, 12)).astype(np.float32)
    for action in actions:
        states.append(jax.device_get(step(hyper, body, states[-1], action, keys)[0]))
    return SimpleNamespace(
        robot=robot, config=config, hyper=hyper, env=env, body=body, keys=keys, reset=reset,
        step=step, states=states, actions=actions,
    )  # fmt: skip


def by_loops(angle, command):
    """The two numbers, of the first foot's phase."""
    moves = math.sqrt(sum(float(c) ** 2 for c in command)) > 0.1
    return [math.sin(angle), math.cos(angle)] if moves else [0.0, 0.0]


def get_rz(phi, swing_height):
    """MuJoCo Playground's gait.get_rz, a number at a time."""

    def bezier(start, end, x):
        return start + (end - start) * (x**3 + 3 * (x**2 * (1 - x)))

    x = (phi + math.pi) / (2 * math.pi)
    return bezier(0.0, swing_height, 2 * x) if x <= 0.5 else bezier(swing_height, 0.0, 2 * x - 1)


def test_the_wanted_height_of_a_foot_is_playgrounds():
    for phi in np.linspace(-math.pi, math.pi, 101):
        other = (phi + 2 * math.pi) % (2 * math.pi) - math.pi
        phase = np.array([math.sin(phi), math.cos(phi)])
        heights = [get_rz(phi, 0.15), get_rz(other, 0.15)]
        expected = [height - min(heights) for height in heights]
        np.testing.assert_allclose(gait.target(phase, 0.15), expected, atol=1e-12)
        np.testing.assert_allclose(gait.target(jnp.asarray(phase), 0.15), expected, atol=1e-6)
    assert gait.target(np.array([0.0, 1.0]), 0.15).tolist() == [0.15, 0.0]
    assert gait.target(np.array([0.0, -1.0]), 0.15).tolist() == [0.0, 0.15]
    assert gait.target(np.zeros(2), 0.15).tolist() == [0.0, 0.0]


def test_each_robot_has_its_own_frequency_and_start_of_the_ranges(world):
    keys = jax.random.split(jax.random.key(1), 500)
    body = jax.tree.map(lambda x: jnp.repeat(x[:1], 500, 0), world.body)
    found = jax.device_get(world.reset(world.hyper, body, keys)).gait
    frequency = found.turn / (2 * math.pi * DT)
    for values, (low, high) in ((frequency, RANGE), (found.angle, (-math.pi, math.pi))):
        share = (values - low) / (high - low)
        assert (
            0 <= share.min() < 0.02 and 0.98 < share.max() <= 1 and abs(share.mean() - 0.5) < 0.05
        )
    assert abs(np.corrcoef(found.angle, frequency)[0, 1]) < 0.15


def test_every_row_shows_the_phases_of_plain_loops(world):
    """Some stand, and see nothing of the angle."""
    start = world.states[0].gait
    stands = 0
    for t, state in enumerate(world.states):
        for i in range(ROBOTS):
            angle, turn = (float(start.angle[i]) + t * float(start.turn[i]), float(start.turn[i]))
            expected = by_loops(angle, state.command[i])
            np.testing.assert_allclose(state.obs[i, WHERE["gait_phase"]], expected, atol=2e-5)
            np.testing.assert_allclose(state.obs[i, WHERE["gait_turn"]], turn)
            stands += expected == [0.0, 0.0]
    assert 0 < stands < ROBOTS * len(world.states)
    assert (abs(world.states[-1].gait.angle) <= math.pi + 1e-5).all()


def test_a_tail_computes_the_clock_from_its_first_row(world):
    """`Env.advance` again and again, of robots that move and that stand, is what physics writes."""
    advance = jax.jit(jax.vmap(world.env.advance, (None, 0, 0, 0, 0)))
    size = world.env.prop_size
    context = world.states[0].obs[:, size:]
    for before, action, after in zip(world.states, world.actions, world.states[1:], strict=False):
        alive = (after.command == world.states[0].command).all(-1)
        assert alive.all()
        context = advance(world.hyper, context, before.prop, action, after.prop)
        np.testing.assert_allclose(context, after.obs[:, size:], atol=2e-5)


def test_the_networks_see_the_phases_and_the_policy_not_the_frequency(world):
    views, turn = world.env.views, WHERE["gait_turn"].start
    phases = set(range(*WHERE["gait_phase"].indices(100)))
    assert (world.env.obs_size, world.env.prop_size) == (51, 33) and phases == {48, 49}
    assert all(phases <= set(columns.tolist()) for columns in views)
    assert [turn in columns for columns in views] == [False, True, True]


def test_the_clock_goes_on_while_the_robot_stands(world):
    """Playground's phases are both pi then, and after it both feet go on together."""
    told = jnp.asarray(np.tile(STANDS, (ROBOTS, 1)), jnp.float32)
    state = jax.tree.map(jnp.asarray, world.states[-1]).replace(command=told)
    state = state.replace(goal=state.goal.replace(standing=jnp.zeros(ROBOTS)))
    for _ in range(2):
        state = world.step(world.hyper, world.body, state, world.actions[0], world.keys)[0]
    np.testing.assert_array_equal(state.obs[:, WHERE["gait_phase"]], 0)
    state = state.replace(command=told + 0.5)
    state = world.step(world.hyper, world.body, state, world.actions[0], world.keys)[0]
    phase = np.asarray(state.obs[:, WHERE["gait_phase"]])
    angle = world.states[-1].gait.angle + 3 * world.states[-1].gait.turn
    np.testing.assert_allclose(phase, np.stack([np.sin(angle), np.cos(angle)], 1), atol=1e-5)


def test_the_mirror_image_of_an_observation_is_that_of_the_mirrored_robot():
    """Left and right swap: the first foot of the image is where the second was."""
    robot, rng = robot_lib.load("g1"), np.random.default_rng(0)
    joints = len(robot.joint_names)
    images = mirror.images(robot, view.make("full", 1, joints, clock=True))
    assert images is not None
    of_obs, of_joints = images
    other = {"left": "right", "right": "left"}
    names = [name.split("_", 1) for name in robot.joint_names]
    names = ["_".join([other.get(side, side), rest]) for side, rest in names]
    assert [robot.joint_names[i] for i in of_joints.index] == names
    assert [name.split("_")[0] for name in robot.foot_names] == ["left", "right"]

    def image(x):
        return of_joints.sign * x[of_joints.index]

    def see(quat, linear, angular, com, q, v, command, action, angle):
        qpos, qvel = np.concatenate([np.zeros(3), quat, q]), np.concatenate([linear, angular, v])
        pose, clock = robot.default_pose, (angle, 0.17)
        return observe.observe(qpos, qvel, com, pose, command, action, clock)

    for command in (MOVES, STANDS):
        angle, quat = rng.uniform(-3, 3), rng.normal(size=4)
        (q, v, action), (linear, angular, com) = (
            rng.normal(size=(3, joints)),
            rng.normal(size=(3, 3)),
        )
        moves, turns, quat = (
            np.array([1, -1, 1]),
            np.array([-1, 1, -1]),
            quat / np.linalg.norm(quat),
        )
        obs = see(quat, linear, angular, com, q, v, command, action, angle)
        base = (quat * [1, -1, 1, -1], linear * moves, angular * turns, com * moves)
        q, v, action = map(image, (q, v, action))
        flipped = see(*base, q, v, command * [1, -1, -1], action, angle + math.pi)
        found = symmetry.vector(of_obs, obs)
        np.testing.assert_allclose(found, flipped, atol=1e-9)
        np.testing.assert_array_equal(symmetry.vector(of_obs, found), obs)


def policy_of(world, history=1):
    config = world.config
    if history > 1:
        config = config_lib.validate(settings(standing=0.3, history=history))
    sizes, rng = (history * (observe.size(12, True) - 1), 8, 12), np.random.default_rng(0)
    layers = {
        f"Dense_{i}": {
            "kernel": rng.normal(size=sizes[i : i + 2]).astype(np.float32) * 0.1,
            "bias": np.zeros(sizes[i + 1], np.float32),
        }
        for i in range(2)
    }
    params = {"actor": {"params": layers}, "std": np.ones(12, np.float32)}
    return policy_file.describe(config, world.robot, params)


def test_an_episode_of_c_mujoco_shows_what_the_environment_does(world):
    """Moving, standing, moving again, with the same actions; the clock is that of the middle frequency, from
    angle 0."""
    policy = policy_of(world)
    assert policy.observation == "velocity-phase-50" and policy.gait_frequency == RANGE
    body = episode.load(world.robot.xml, policy, policy.timestep, text=world.robot.alone)
    actions, seen = np.random.default_rng(1).normal(0, 0.1, (30, 12)), []

    def told(t):
        return STANDS if 0.195 < t < 0.395 else MOVES

    def act(obs):
        seen.append(obs)
        return actions[len(seen) - 1]

    played = episode.play(body, act, told, 30 * DT)
    turn = 2 * math.pi * 1.375 * DT
    layout = view.make("full", 1, 12, clock=True)
    state = jax.tree.map(lambda x: jnp.asarray(x[0]), world.states[0])
    body_0 = jax.tree.map(lambda x: x[0], world.body)
    com = world.robot.mj_model.body_ipos[world.robot.base_body]
    body_0 = body_0.replace(base_com=jnp.asarray(com, jnp.float32))
    state = state.replace(
        gait=state.gait.replace(angle=jnp.zeros(()), turn=jnp.float32(turn)),
        last_action=jnp.zeros(12),
    )
    data = mujoco.MjData(body.model)
    episode.reset(body, data)
    step = jax.jit(world.env.step)
    for k in range(30):
        qpos, qvel = episode.coordinates(body, data) if k == 0 else (None, None)
        if k == 0:
            state = state.replace(
                qpos=jnp.asarray(qpos, jnp.float32), qvel=jnp.asarray(qvel, jnp.float32)
            )
        state = state.replace(command=jnp.asarray(told(k * DT), jnp.float32))
        expected = view.exact(layout, world.robot, world.hyper, body_0, state)[view.reading(layout)]
        known = slice(world.env.prop_size, None)
        np.testing.assert_allclose(seen[k][known], expected[known], atol=1e-5)
        if k == 0:  # later the solvers' tolerances part the robots
            np.testing.assert_allclose(seen[k], expected, atol=1e-5)
        state, _ = step(
            world.hyper, body_0, state, jnp.asarray(actions[k], jnp.float32), world.keys[0]
        )
    resting = (np.array(seen)[:, 48:] == 0).all(-1)
    assert resting.tolist() == [10 <= k < 20 for k in range(30)]
    assert len(played["qpos"]) == 30


def test_a_policys_file_has_its_clock_and_an_older_one_has_none(world, tmp_path):
    policy, path = policy_of(world), tmp_path / "a.npz"
    about = policy_file.about(policy)
    assert about["format"] == 4 and about["gait_frequency"] == RANGE
    policy_file.save_params(path, policy.params, about=policy_file.to_json(about))
    found = policy_file.load(path)
    assert found.gait_frequency == [*RANGE] and found.observation == policy.observation
    without = policy._replace(gait_frequency=None, observation="velocity-48")
    assert "gait_frequency" not in policy_file.about(without)
    for change, expected in (
        ({"gait_frequency": None, "config": {}}, "'velocity-phase-50'.*without a gait clock"),
        ({"observation": "velocity-48"}, "'velocity-48', but 'velocity-phase-50' in config.task"),
        ({"gait_frequency": [1.0]}, r"gait_frequency is \[1.0\], expected \(low, high\)"),
        ({"gait_frequency": [0.0, 1.0]}, "gait_frequency is 0.0, expected 0.01 to 10 Hz"),
        ({"gait_frequency": [1.0, 1.5]}, "gait_frequency is .*in config.task"),
    ):
        policy_file.save_params(path, policy.params, about=policy_file.to_json(about | change))
        with pytest.raises(ConfigError, match=expected):
            policy_file.load(path)


def test_on_a_robot_the_phase_is_part_of_an_onnx_files_obs_and_a_deploy_yaml_has_its_period(world):
    policy = policy_of(world)
    order = tuple(reversed(policy.joint_names))
    facts = onnx_file.about(joint_order.permute(policy, order), world.robot)
    row = facts["observation_table"][-1]
    assert (row["name"], row["start"], row["stop"]) == ("gait_phase", 48, 50)
    assert facts["gait_frequency"] == RANGE and "2 pi f t" in facts["gait_clock"]
    assert "gait_clock" not in onnx_file.about(other_robots.policy(world.robot), world.robot)
    size = len(onnx_file.order(policy))
    assert (
        onnx_file.onnx_model(policy, facts).graph.input[0].type.tensor_type.shape.dim[1].dim_value
        == size
        == 50
    )
    first = [
        p.params["actor"]["params"]["Dense_0"]["kernel"]
        for p in (policy, joint_order.permute(policy, order))
    ]
    np.testing.assert_array_equal(first[0][48:], first[1][48:])
    seen = policy._replace(observation="onboard-phase-47")
    written = deploy_yaml.text(seen, world.robot).splitlines()
    assert written[-5:] == [
        "  gait_phase:",
        f'    params: {{"period": {1 / 1.375}}}',
        "    clip: null",
        "    scale: [1.0, 1.0]",
        "    history_length: 1",
    ]


@pytest.mark.parametrize("history", [1, 3])
def test_an_onnx_file_sets_the_clock_to_zero_where_each_reading_is_to_stand(world, history):
    """A robot's clock goes on. The actor of JAX, which saw zeros there, does the same."""
    runtime, policy = pytest.importorskip("onnxruntime"), policy_of(world, history)
    model = onnx_file.onnx_model(policy, onnx_file.about(policy, world.robot))
    session = runtime.InferenceSession(model.SerializeToString())
    rng, actor = np.random.default_rng(0), policy_file.actor(policy.params, policy.activation)
    order, told = onnx_file.order(policy), set()
    for _ in range(20):
        newest_first = rng.normal(size=(history, 50)).astype(np.float32)
        for reading in newest_first:
            reading[WHERE["command"]] = MOVES if rng.random() < 0.5 else STANDS
        seen = newest_first.copy()
        for reading in seen:
            stands = np.linalg.norm(reading[WHERE["command"]]) <= 0.1
            reading[48:] *= not stands
            told.add(bool(stands))
        action = session.run(["action"], {"obs": newest_first.reshape(-1)[order][None]})[0]
        np.testing.assert_allclose(action[0], actor(seen.reshape(-1)), atol=1e-5)
    assert told == {True, False}


def test_a_late_sensor_makes_no_late_clock(world):
    """The robot computes the phases itself; what it senses may be 40 ms old."""
    policy = policy_of(world)
    body = episode.load(world.robot.xml, policy, policy.timestep, text=world.robot.alone)
    seen = {}
    for late in (0.0, 0.04):
        rows = seen[late] = []
        stress.play(
            body,
            lambda obs, rows=rows: rows.append(obs) or np.zeros(12),
            MOVES,
            stress.Stress("late", sensor_delay=late),
            seconds=0.2,
        )
    count = min(map(len, seen.values()))
    phases = [np.array(rows)[:count, 48:] for rows in seen.values()]
    expected = [by_loops(2 * math.pi * 1.375 * DT * k, MOVES) for k in range(count)]
    assert count > 5
    for found in phases:
        np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_robot_of_four_feet_and_a_term_without_its_clock_are_one_line_each(world):
    config = config_lib.validate(settings())
    expected = r"task.gait_frequency is \(1.25, 1.5\), expected None: go1 has 4 feet"
    with pytest.raises(ConfigError, match=expected):
        build.check(config)
    with pytest.raises(ConfigError, match=expected):
        env_lib.make(robot_lib.load("go1"), config.task, config.physics, impl="c")
    config = config_lib.load("configs/go1.py:laptop")
    config.task.weights.feet_phase = 1.0
    with pytest.raises(ConfigError, match="task.gait_frequency is None.*task.weights.feet_phase"):
        reward_sum.terms_of(config_lib.validate(config).task)


def test_without_a_frequency_nothing_of_it_is_there(world):
    """No array in the state, no column, and the same draws as with a clock for all that both have."""
    config = config_lib.validate(config_lib.load("configs/go1.py:laptop"))
    assert config_lib.split(config)[1].task.gait_frequency is None
    env = env_lib.make(world.robot, config.task, config.physics, impl="c")
    assert env.views is None and env.obs_size == 48 and "reward_feet_phase" not in env.metrics
    hyper = config_lib.split(config)[1]
    body = jax.eval_shape(env.randomize, hyper, world.keys[0])
    state = jax.eval_shape(env.reset, hyper, body, world.keys[0])
    assert state.gait is None
    with_clock = jax.tree.leaves(world.states[0])
    assert len(with_clock) == len(jax.tree.leaves(state)) + 2
    assert observe.slices(12) == {k: v for k, v in WHERE.items() if not k.startswith("gait")}
