"""Playground's tasks under our trainer: the same numbers as the task's own step, without network or meshes.

Compiling MJX takes most of the time, so one program has all that one task's steps are compared with.
"""

import functools
import sys
import types as python_types

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import refused, status

from dynappo import config as config_lib
from dynappo.tasks import by_name
from dynappo.types import Outcome

pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")

from dynappo.tasks.playground import assets, env, loading, parts, settings, swapped  # noqa: E402
from dynappo.train import command  # noqa: E402

ROBOTS, ROWS = 3, 6
GO1, SPOT = (
    "Go1JoystickFlatTerrain",
    "SpotJoystickGaitTracking",
)  # a dict of observations, one with a history
EVERY = [
    name for name in loading.names() if name != "BarkourJoystick"
]  # whose robot is Menagerie's


@pytest.fixture(autouse=True)
def no_menagerie(monkeypatch, tmp_path_factory):
    """Stand-ins in a folder of these tests, also where the machine has meshes."""
    folder = tmp_path_factory.getbasetemp() / "stand_ins"
    folder.mkdir(exist_ok=True)
    monkeypatch.setattr(assets.tempfile, "gettempdir", lambda: str(folder))
    monkeypatch.setattr(assets, "_places", lambda playground: iter(()))


@functools.cache
def task(name):
    return loading.load(name).task


@functools.cache
def made(name):
    return env.make(task(name), random_clock=False)


def const(of):
    return of.step.args[0]


@functools.cache
def restarted():
    """`f(states, fell, timed out, keys) -> states` of Go1's robots; one program for all tests."""
    of = made(GO1)

    def some(states, fell, late, keys):
        zeros = jnp.zeros(ROBOTS)
        outcome = Outcome(
            reward=zeros,
            discount=1.0 - fell,
            truncation=late,
            next_obs=states.obs,
            next_prop=states.prop,
            episode_return=zeros,
            episode_length=zeros,
            valid=zeros + 1,
        )
        return jax.vmap(functools.partial(of.autoreset, None, None))(states, outcome, keys)

    return jax.jit(some)


@functools.cache
def rollout():
    """`(states before, actions, states after, outcomes, Playground's own states)` of Go1, all [ROWS, ROBOTS].

    Playground's states go on from its own data, which are never rebuilt.
    """
    of, keys = made(GO1), jax.random.split(jax.random.key(3), ROBOTS)
    shapes = jax.eval_shape(jax.vmap(functools.partial(of.reset, None, None)), keys)
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    ours = restarted()(nothing, jnp.ones(ROBOTS), jnp.zeros(ROBOTS), keys)
    actions = np.random.default_rng(0).normal(size=(ROWS, ROBOTS, of.action_size))

    def both(ours, own, action):
        after, outcome = jax.vmap(functools.partial(of.step, None, None))(ours, action, keys)
        return after, outcome, jax.vmap(task(GO1).step)(own, jnp.tanh(action))

    own = jax.jit(jax.vmap(functools.partial(env.before_step, const(of))))(ours)
    shapes = jax.eval_shape(both, ours, own, actions[0])[
        2
    ]  # else the first step is a program of its own
    own = jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), own, shapes)
    both, rows = jax.jit(both), []
    for action in 0.3 * actions.astype(np.float32):
        after, outcome, theirs = both(ours, own, action)
        rows.append((ours, action, after, outcome, theirs))
        ours, own = after, theirs
    return jax.tree.map(lambda *x: np.stack(x), *rows)


def test_reward_observation_and_end_are_those_of_the_tasks_own_step():
    """Although MJX's data are rebuilt before each step; and no key of random numbers is another."""
    _, _, after, outcome, own = rollout()
    of = made(GO1)
    np.testing.assert_allclose(outcome.reward, own.reward, atol=1e-5)
    np.testing.assert_array_equal(1 - outcome.discount, own.done)
    np.testing.assert_allclose(after.qpos, own.data.qpos, atol=1e-4)
    for name, columns in (("state", of.views.actor), ("privileged_state", None)):
        numbers = outcome.next_obs[..., columns] if columns is not None else raw(of, outcome)[name]
        np.testing.assert_allclose(numbers, own.obs[name], rtol=1e-3, atol=2e-3)
    np.testing.assert_array_equal(after.info["rng"], own.info["rng"])
    for name in ("reward/tracking_lin_vel", "reward/torques"):
        told = outcome.metrics[env.column_name(name)]
        np.testing.assert_allclose(told, own.metrics[name], rtol=1e-3, atol=1e-4)


def raw(of, outcome):
    """Playground's observations, of ours."""
    layout, like = const(of).layout, const(of).like

    def one(obs, prop):
        return parts.unvector(layout.names, parts.unpack(layout, obs, prop), like).obs

    return jax.vmap(jax.vmap(one))(outcome.next_obs, outcome.next_prop)


def test_physics_are_those_of_c_mujoco():
    """Of one control step, from a state of the rollout; contacts too: the robot has landed."""
    before, action, after, *_ = rollout()
    model, row = task(GO1).mj_model, ROWS - 1
    data = mujoco.MjData(model)
    for robot in range(ROBOTS):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = before.qpos[row, robot], before.qvel[row, robot]
        data.qacc_warmstart[:] = before.qacc_warmstart[row, robot]
        pose = task(GO1)._default_pose
        data.ctrl[:] = pose + np.tanh(action[row, robot]) * task(GO1)._config.action_scale
        for _ in range(task(GO1).n_substeps):
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(after.qpos[row, robot], data.qpos, atol=2e-3)


def test_what_is_known_is_computed_exactly():
    """The next row's context, all that the model does not predict, from the row's own numbers."""
    before, action, _, outcome, _ = rollout()
    of = made(GO1)
    advance = jax.jit(jax.vmap(jax.vmap(functools.partial(of.advance, None))))
    size = of.prop_size
    found = advance(before.obs[..., size:], before.obs[..., :size], action, outcome.next_prop)
    assert (outcome.discount == 1).all()
    np.testing.assert_allclose(found, outcome.next_obs[..., size:], atol=1e-5)


def test_noise_is_on_what_the_policy_senses_as_wide_as_the_task_says():
    """Uniform, of the five kinds of sensors; `prop` has none, and `sense` adds it."""
    before, *_ = rollout()
    of, scales = made(GO1), task(GO1)._config.noise_config.scales
    noise = const(of).layout.noise
    wide = np.repeat(
        [scales.linvel, scales.gyro, scales.gravity, scales.joint_pos, scales.joint_vel],
        [3, 3, 3, 12, 12],
    )
    np.testing.assert_allclose(noise[of.views.actor[:33]], wide, rtol=1e-5)
    assert (noise[33:] == 0).all() and of.prop_size == 80
    off = np.abs(before.obs[..., : of.prop_size] - before.prop)
    assert (off <= noise + 1e-4).all() and (off[..., :33].max((0, 1)) > noise[:33] / 10).all()
    sensed = of.sense(None, jnp.zeros(80), None, jax.random.key(1))
    assert (np.abs(sensed) <= noise).all() and (sensed[:33] != 0).all()


def test_those_that_ended_start_anew_and_no_others():
    """Under vmap they are gathered, a few at a time; each gets the state of its own key, and all differ."""
    states = jax.tree.map(lambda x: jnp.asarray(x[-1]), rollout()[2])
    keys = jax.random.split(jax.random.key(9), ROBOTS)
    fell, late = np.array([1.0, 0, 0]), np.array([0.0, 0, 1])
    after, ended = restarted()(states, fell, late, keys), (fell + late) > 0
    for old, new in zip(jax.tree.leaves(states), jax.tree.leaves(after), strict=True):
        np.testing.assert_array_equal(old[~ended], new[~ended])
    assert (after.clock[ended] == 0).all() and (after.episode_return[ended] == 0).all()
    places = np.asarray(after.qpos[ended])
    assert len(np.unique(places[:, 0])) == ended.sum() and (np.abs(places[:, :2]) <= 0.5).all()
    alone = restarted()(
        states, np.zeros(ROBOTS), late, keys
    )  # whoever else ends, a robot starts as its key says
    np.testing.assert_array_equal(alone.qpos[2], after.qpos[2])


@pytest.mark.parametrize("name", [SPOT])
def test_a_history_is_known_but_for_what_is_new(name):
    """Three steps of 12 errors: the newest is predicted, the others are those before, moved on."""
    of = made(name)
    layout = const(of).layout
    predicted = layout.source[: of.prop_size]
    assert layout.names == ("",) and of.views.actor.size == 69
    assert set(range(30)) <= set(predicted) and not set(range(30, 54)) & set(predicted)
    obs = jnp.arange(69.0) / 100
    like = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), const(of).like)
    info = like.info | {"qpos_error_history": obs[18:54]}
    numbers = parts.vector(layout.names, like._replace(obs=obs, info=info))
    before, size = numbers[layout.source], of.prop_size
    after = of.advance(None, before[size:], before[:size], jnp.zeros(of.action_size), None)
    seen = jnp.concatenate([before[:size], after])[of.views.actor]
    np.testing.assert_allclose(seen[30:54], obs[18:42], atol=1e-6)


def test_draws_in_a_tail_differ_from_row_to_row():
    """Where a command ends in a tail, the next one is drawn by a key made of the row's numbers."""
    numbers = jnp.arange(40, dtype=jnp.float32)
    keys = [parts.key_of(numbers, numbers + i) for i in range(50)]
    assert len({tuple(np.asarray(key)) for key in keys}) == 50
    draws = [float(jax.random.uniform(key)) for key in keys]
    assert abs(np.mean(draws) - 0.5) < 0.15 and np.std(draws) > 0.2


def test_noise_is_off_in_the_middle_and_largest_at_the_end():
    def noise():
        return jax.random.uniform(
            jax.random.key(0), (2,), minval=jnp.array([-1.0, 0.0]), maxval=3.0
        )

    with swapped.uniform(0.5):
        np.testing.assert_array_equal(noise(), [1.0, 1.5])
    with swapped.uniform(1.0):
        np.testing.assert_array_equal(noise(), [3.0, 3.0])
    assert (noise() != 3.0).all()


def test_only_a_task_that_does_not_clip_its_rewards_has_a_known_one_of_a_fall():
    """G1's -100 a second; Go1 clips at 0, where a fall's cost is what is left of the reward."""
    scales = {"reward_config": python_types.SimpleNamespace(scales={"termination": -100.0})}
    g1 = python_types.SimpleNamespace(_config=scales, dt=0.02)
    for clipped, cost in ((False, -2.0), (True, None)):
        layout = const(made(GO1)).layout._replace(clipped=clipped)
        assert env._fall_reward(g1, layout) == cost
    assert const(made(GO1)).layout.clipped and made(GO1).fall_reward is None


@pytest.mark.parametrize("name", ["Go1Getup", "G1JoystickFlatTerrain", "Op3Joystick"])
def test_stand_ins_change_no_physics(name, monkeypatch, tmp_path):
    """Masses and inertias are the files', so meshes of another size give the same; no mesh collides."""
    one = task(name).mj_model
    small = assets._tetrahedron
    monkeypatch.setattr(assets.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(assets, "_tetrahedron", lambda suffix: small(suffix, 0.3))
    other = loading.load(name).task.mj_model
    mesh = one.geom_type == mujoco.mjtGeom.mjGEOM_MESH
    assert mesh.any() and not (one.geom_contype[mesh] | one.geom_conaffinity[mesh]).any()
    for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_M0"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field), field)


def test_a_film_shows_ellipsoids_where_meshes_are_missing():
    """Of the bodies' masses and inertias, so about as large as the robot; the model itself is as it was."""
    model = task(GO1).mj_model
    drawn = assets.shown(model)
    round_ones = drawn.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID
    assert round_ones.sum() >= 13 and not (model.geom_type == mujoco.mjtGeom.mjGEOM_ELLIPSOID).any()
    trunk = drawn.geom_size[round_ones & (drawn.geom_bodyid == model.body("trunk").id)][0]
    assert 0.1 < max(trunk) < 0.5


def test_meshes_come_from_where_they_are(monkeypatch, tmp_path):
    """From the folder that the variable names, also before a clone; a wrong one is an error."""
    monkeypatch.undo()
    (tmp_path / "unitree_go1").mkdir()
    monkeypatch.setenv(assets.VARIABLE, str(tmp_path))
    folder, text = assets.find("go1", tmp_path)
    assert folder == tmp_path and text == f"meshes of {assets.VARIABLE}={tmp_path}"
    monkeypatch.setenv(assets.VARIABLE, str(tmp_path / "none"))
    assert "expected a folder: a clone of Menagerie" in refused(assets.find, "go1", tmp_path)


def test_settings_are_playgrounds():
    """Of brax's PPO: 8192 robots, 20 rows, 32 minibatches, 4 updates, gamma 0.97; a privileged critic."""
    config = config_lib.validate(config_lib.load(f"playground:{GO1}:ppo"))
    assert (config.rollout.num_envs, config.rollout.horizon) == (8192, 20)
    assert (config.ppo.minibatches, config.ppo.epochs, config.ppo.gamma) == (32, 4, 0.97)
    assert config.ppo.critic == "state" and config.ppo.normalize and not config.ppo.adaptive
    assert config.run.num_iterations * 8192 * 20 >= 200e6
    assert config.env == f"playground:{GO1}" and config.robot == ""
    best = config_lib.validate(config_lib.load(f"playground:{GO1}"))
    assert best.schedule.end_steps > 0 and best.task.episode_length == 1000
    for name in loading.names():
        assert settings.of_task(name).rollout["num_envs"] == 8192


def test_mistakes_are_one_line(monkeypatch):
    """A wrong name, variant or engine; a robot that has no stand-in; Playground not installed."""
    assert GO1 in refused(loading.check, "Go1Joystick")
    assert "'best' is not" not in refused(config_lib.load, f"playground:{GO1}:fast")
    assert "is not one of best, ppo" in refused(config_lib.load, f"playground:{GO1}:fast")
    assert "no locomotion task ''" in refused(config_lib.load, "playground")
    assert assets.VARIABLE in refused(loading.check, "BarkourJoystick")
    config = config_lib.load(f"playground:{GO1}")
    config.physics.impl = "c"
    assert "expected jax or warp" in refused(by_name.check, config)
    config.env = "gym:Ant"
    assert "expected playground:TASK or brax:NAME" in refused(by_name.check, config)
    config.robot = "go1"
    assert "expected '' where a robot is named" in refused(config_lib.validate, config)
    monkeypatch.setattr(loading.importlib.util, "find_spec", lambda name: None)
    assert "pip install 'dynappo[playground]'" in refused(loading.names)


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_every_task_has_parts_and_a_step(name):
    """One step of each from a tail's side: shapes, and numbers that are finite."""
    of = made(name)
    context = jnp.zeros(of.obs_size - of.prop_size)
    found = of.advance(None, context, jnp.zeros(of.prop_size), jnp.zeros(of.action_size), None)
    assert found.shape == context.shape and bool(jnp.isfinite(found).all())
    assert 0 < of.prop_size < of.obs_size


@pytest.mark.slow
@pytest.mark.parametrize("spec", [f"playground:{GO1}", f"playground:{GO1}:ppo", "brax:hopper"])
def test_a_run_from_the_command_line_trains_resumes_and_is_evaluated(spec, tmp_path, monkeypatch):
    """As a user gives it, at the least size."""
    monkeypatch.undo()
    small = """rollout.num_envs=8 rollout.horizon=6 ppo.minibatches=2 run.num_iterations=2 run.log_every=1
        model.minibatches=3 model.hidden=(16,) ppo.hidden=(16,) ppo.critic_hidden=(16,) run.eval_envs=2
        run.eval_steps=4 run.device=cpu model.precision=highest ppo.precision=highest
        ppo.shuffle_blocks=1""".split()
    flags = [f"--config.{field}" for field in small]
    if not spec.endswith(":ppo"):
        flags += ["--config.schedule.end_steps=4", "--config.schedule.end_iteration=0"]
    assert status(command.main, f"--config={spec}", f"--workdir={tmp_path}/run", *flags) == 0
    more = "--config.run.num_iterations=3"
    assert status(command.main, f"--workdir={tmp_path}/run", more) == 0
    assert (tmp_path / "run" / "policy.npz").is_file() and "dynappo" in sys.modules
