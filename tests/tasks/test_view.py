"""What each network sees: readings, readings before, errors of sensors, bodies; late and lagging motors.

The rows of the task are compared with those of a loop that remembers by itself, the tail with the rows of
physics, and the NumPy player with the trainer.
"""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo import fast
from dynappo.description import robot as robot_lib
from dynappo.learner import networks, symmetry
from dynappo.model import dynamics
from dynappo.physics import randomize
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import observe, view

ROBOTS, STEPS, HISTORY = 3, 6, 3
READING = np.r_[0:27, 30:48]  # all but the linear velocity
FIELDS = {
    "task.observation": "onboard",
    "task.history": HISTORY,
    "task.randomize.delay": (0.0, 0.04),
    "task.randomize.strength": (0.8, 1.2),
    "task.randomize.encoder_bias": 0.05,
    "task.randomize.imu_tilt": 0.05,
    "task.episode_length": 4,
    "task.random_clock": False,
    "task.carry_on": False,
    "ppo.critic": "state",
    "physics.impl": "c",
    "physics.threads": 1,
}


def configured(**fields):
    config = config_lib.load("configs/go1.py:best")
    for name, value in (FIELDS | fields).items():
        config_lib.override(config, name, str(value))
    return config_lib.validate(config)


def quiet(hyper):
    """Without noise, so that what is sensed can be computed."""
    return hyper._replace(
        task=hyper.task._replace(noise=jax.tree.map(lambda x: 0.0, hyper.task.noise))
    )


@pytest.fixture(scope="module")
def world():
    """Rows of three Go1s under random actions, without noise, with resets where an episode ends."""
    config = configured()
    static, hyper = config_lib.split(config)
    hyper, robot = quiet(hyper), robot_lib.load("go1")
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    step = jax.jit(jax.vmap(partial(env.step, hyper)))
    again = jax.jit(jax.vmap(partial(env.autoreset, hyper)))
    actions = np.random.default_rng(0).normal(size=(STEPS, ROBOTS, 12)).astype(np.float32)
    rows = []
    for t in range(STEPS):
        draw = jax.random.split(jax.random.key(t + 1), ROBOTS)
        after, outcome = step(body, state, actions[t], draw)
        rows.append(jax.device_get((state, after, outcome)))
        state = again(body, after, outcome, draw)
    layout = view.make("onboard", HISTORY, 12, randomize.varied(config.task.randomize))
    made = dict(static=static, hyper=hyper, env=env, body=body, rows=rows, actions=actions)
    return SimpleNamespace(**made, config=config, robot=robot, layout=layout)


def sensed(world, i, prop, command, last_action):
    """The 48 numbers as the sensors of robot `i` give them: encoders off, an IMU that is turned."""
    tilt, out = np.asarray(world.body.imu_tilt)[i], np.array(prop, float)
    out[:12] += np.asarray(world.body.encoder_bias)[i]
    for part in (slice(24, 27), slice(30, 33)):
        out[part] += np.cross(tilt, prop[part])
    return np.concatenate([out, command, last_action])


def test_an_observation_is_what_is_sensed_then_readings_before_then_the_body(world):
    """Each episode begins with its first reading instead of those before it."""
    varied = world.layout.varied
    for i in range(ROBOTS):
        body = jax.tree.map(lambda x, i=i: x[i], world.body)
        com = world.robot.mj_model.body_ipos[world.robot.base_body]
        told, past, begins = randomize.numbers(body, com, varied), [], 0
        for before, after, outcome in world.rows:
            for state, place in ((before, "before"), (after, "after")):
                if place == "before" and state.episode_steps[i] == 0:
                    past, begins = [], begins + 1
                if place == "before" and state.episode_steps[i] > 0:
                    continue  # it is the `after` of the row before
                seen = sensed(world, i, state.prop[i], state.command[i], state.last_action[i])
                past = [seen[READING], *(past or [seen[READING]] * (HISTORY - 1))][:HISTORY]
                expected = np.concatenate([seen, *past[1:], told])
                np.testing.assert_allclose(state.obs[i], expected, 1e-5, 1e-5, err_msg=place)
            np.testing.assert_array_equal(outcome.next_obs[i], after.obs[i])
        assert begins >= 2


def test_what_is_known_follows_from_the_row_before(world):
    """`Env.advance` is all of the next observation but what is predicted, while the command stays."""
    for t, (before, after, _) in enumerate(world.rows):
        obs = jnp.asarray(before.obs)
        found = world.env.advance(world.hyper, obs[:, 33:], obs[:, :33], world.actions[t], None)
        np.testing.assert_allclose(found, after.obs[:, 33:], 1e-6, 1e-6)


def test_a_tail_shows_the_policy_what_physics_would(world):
    """A model that knows the next state gives the observation of the task, readings and errors included."""
    env, rows = world.env, world.rows
    static = world.static._replace(
        model=world.static.model._replace(clean=True, known_reward=False, falls=False)
    )
    model = jax.jit(partial(dynamics.init, static, env))(jax.random.key(0))
    for t, (before, after, _) in enumerate(rows):
        truth = jnp.asarray(after.prop)

        def predict(static, hyper, env, model, obs, action, truth=truth):
            return jnp.concatenate([truth, 0 * obs[:, 33:]], -1), truth[:, 0], truth[:, 0]

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(dynamics, "predict", predict)
            start = dynamics.tail(static, env, jax.tree.map(jnp.asarray, before))
            keys = jax.random.split(jax.random.key(9), ROBOTS)
            step = dynamics.step(static, world.hyper, env, model)
            state, told = step(start, jnp.asarray(world.actions[t]), keys)
        np.testing.assert_allclose(state.obs, after.obs, 1e-5, 1e-5)
        np.testing.assert_array_equal(state.prop, after.prop)
        np.testing.assert_array_equal(told.next_obs, state.obs)


def test_each_network_sees_its_columns(world):
    """The policy no velocity and no body; the value function both, without errors, and no readings before."""
    obs, prop = (jnp.asarray(getattr(world.rows[3][0], name)) for name in ("obs", "prop"))
    past, body = obs[:, 48 : 48 + (HISTORY - 1) * 45], obs[:, 48 + (HISTORY - 1) * 45 :]
    shown, state = networks.inputs(world.static, world.env, obs, prop)
    np.testing.assert_array_equal(shown, jnp.concatenate([obs[:, READING], past], -1))
    np.testing.assert_array_equal(state, jnp.concatenate([prop, obs[:, 33:48], body], -1))
    assert networks.input_sizes(world.static, world.env) == (shown.shape[1], state.shape[1])
    alike = world.static._replace(ppo=world.static.ppo._replace(critic="obs"))
    one, other = networks.inputs(alike, world.env, obs, prop)
    assert one is other


def test_two_inputs_at_once_give_what_each_network_gives_alone(world):
    static = world.static._replace(ppo=world.static.ppo._replace(precision="highest"))
    sizes = networks.input_sizes(static, world.env)
    params = networks.init_policy(
        static, world.hyper, sizes[0], 12, jax.random.key(1), critic_size=sizes[1]
    )
    rng = np.random.default_rng(2)
    obs, critic_obs = (jnp.asarray(rng.normal(size=(5, n)), jnp.float32) for n in sizes)
    for actor_critic in (networks.actor_critic, fast.actor_critic):
        mean, value = actor_critic(static, params)(obs, critic_obs)
        np.testing.assert_allclose(mean, networks.policy(static, params, obs), 1e-5, 1e-5)
        np.testing.assert_allclose(value, networks.value(static, params, critic_obs), 1e-5, 1e-5)


def test_the_mirror_image_of_an_observation_is_that_of_the_mirrored_robot(world):
    """Mirrored state, command, action and body give the mirrored 48 numbers, readings and body."""
    obs, joints = world.env.mirror
    assert sorted(obs.index) == list(range(world.env.obs_size))
    x = np.arange(world.env.obs_size, dtype=float)
    image = lambda m, x: m.sign * x[m.index]  # noqa: E731
    np.testing.assert_array_equal(image(obs, image(obs, x)), x)
    one = image(obs, x)
    for start in (48, 48 + 45):  # each reading before is mirrored as the newest is
        reading = np.zeros(world.env.obs_size)
        reading[:48][READING] = x[start : start + 45]
        expected = image(obs, reading)[:48][READING]
        np.testing.assert_array_equal(one[start : start + 45], expected)
    bias = slice(world.env.obs_size - 15, world.env.obs_size - 3)
    np.testing.assert_array_equal(one[bias], image(joints, x[bias]))
    for columns in (world.env.views.actor, world.env.views.critic):
        part = symmetry.part(obs, columns)
        np.testing.assert_array_equal(image(part, x[columns]), one[columns])


def test_the_player_in_numpy_remembers_as_the_task_does():
    """`observe.memory`, one observation after another, is the policy's columns of `view`."""
    layout, rng = view.make("onboard", HISTORY, 12), np.random.default_rng(0)
    rows, see = rng.normal(size=(5, 48)), observe.memory("onboard-45", HISTORY)
    past = view.rest_at_start(layout, rows[0], np.zeros(layout.body))
    for row in rows:
        obs = np.concatenate([row, past])
        np.testing.assert_array_equal(see(row), obs[view.views(layout).actor])
        past = view.rest_after(layout, obs)
    np.testing.assert_array_equal(observe.memory("velocity-48", 1)(rows[0]), rows[0])


def test_the_benchmark_has_none_of_it():
    """48 numbers for all, no extra arrays in a body or a state: nothing in the compiled program."""
    config = config_lib.validate(config_lib.load("configs/go1.py:ppo16"))
    env = env_lib.make(robot_lib.load("go1"), config.task, config.physics)
    hyper = config_lib.split(config)[1]
    assert env.obs_size == 48 and env.views is None
    body = jax.eval_shape(env.randomize, hyper, jax.random.key(0))
    assert len(jax.tree.leaves(body)) == 5
    state = jax.eval_shape(env.reset, hyper, body, jax.random.key(0))
    assert state.torque is None


# of MJX: physics/test_warp_call.py compares it with Warp
@pytest.mark.parametrize("impl", ["warp", pytest.param("jax", marks=pytest.mark.slow)])
def test_a_lagging_torque_approaches_what_is_wanted_with_its_time_constant(impl):
    """Against C MuJoCo a physics step at a time: tau' = (wanted - tau) / T, kept from row to row."""
    pytest.importorskip("warp" if impl == "warp" else "mujoco")
    fields = {"task.actuator": "lag", "task.randomize.lag": (0.01, 0.03), "physics.impl": impl}
    config = configured(**fields, **{"task.randomize.base_mass": (0.0, 0.0)})
    robot, hyper = robot_lib.load("go1"), quiet(config_lib.split(config)[1])
    env = env_lib.make(robot, config.task, config.physics, impl=impl)
    key = jax.random.key(3)
    body = jax.jit(env.randomize)(hyper, key)
    state, step = jax.jit(env.reset)(hyper, body, key), jax.jit(env.step)
    task, model = config.task, robot_lib.physics_model(robot, config.physics)
    limit = np.array(task.effort_limit)
    data, torque = mujoco.MjData(model), np.zeros(12)
    data.qpos[:], data.qvel[:] = state.qpos, state.qvel
    share = 1 - np.exp(-0.005 / float(body.lag))
    late, told = round(float(body.delay) / 0.005), [np.zeros(12)] * 2
    for t in range(3):
        action = np.random.default_rng(t).normal(size=12).astype(np.float32)
        told.append(action)
        state, _ = step(hyper, body, state, action, jax.random.key(t))
        for k in range(4):
            arrived = told[2 + max((t * 4 + k - late) // 4, t - 2)]
            target = robot.default_pose + 0.25 * arrived - np.asarray(body.encoder_bias)
            wanted = task.kp * (target - data.qpos[7:]) - task.kd * data.qvel[6:]
            wanted = np.clip(wanted, -limit, limit) * float(body.strength)
            torque = torque + share * (wanted - torque)
            data.ctrl[:] = torque
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(state.torque, torque, 1e-3, 2e-3)
        np.testing.assert_allclose(state.qpos, data.qpos, 1e-4, 1e-4)


BAD = {
    "history": ({"task.history": 0}, "task.history is 0, expected 1 to 100"),
    "late": (
        {"task.randomize.delay": (0.0, 0.05)},
        r"task.randomize.delay is \(0.0, 0.05\), expected at most two control steps, 0.04 s",
    ),
    "sensors": (
        {"task.observation": "full"},
        "task.randomize.encoder_bias is 0.05, expected 0 where task.observation is full",
    ),
    "lag": (
        {"task.randomize.lag": (0.0, 0.01)},
        "task.randomize.lag is .*, expected .* where task.actuator is pd",
    ),
    "no lag": ({"task.actuator": "lag"}, "task.randomize.lag is .*, expected above 0"),
    "lag in C": (
        {"task.actuator": "lag", "task.randomize.lag": (0.0, 0.01)},
        "physics.impl is .c., expected jax or warp where torques lag",
    ),
    "critic": ({"ppo.critic": "privileged"}, "ppo.critic is 'privileged', expected one of obs"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_setting_that_cannot_be_is_one_line(name):
    fields, line = BAD[name]
    with pytest.raises(config_lib.ConfigError, match=line):
        configured(**fields)
