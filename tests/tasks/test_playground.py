"""Playground's tasks under our trainer: the same numbers as the task's own step, without network or meshes.

To compile MJX takes longest, so most of these tests trace the tasks with C MuJoCo's physics
(c_physics.py); one compiles our step on MJX.
"""

import functools
import importlib.util
import json
import sys
import types as python_types
from unittest import mock

import answers
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import mistake, refused, status

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import files, shell
from dynappo.evaluate import command as evaluate
from dynappo.evaluate import task_episodes
from dynappo.export import command as export
from dynappo.play import command as play
from dynappo.policy import policy_file, recorded, render, task_player
from dynappo.program import build
from dynappo.run import overflow
from dynappo.tasks import by_name
from dynappo.types import Outcome

pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")

from dynappo.tasks.playground import (  # noqa: E402
    assets,
    c_physics,
    commands,
    env,
    loading,
    mirrored,
    parts,
    room,
    settings,
    swapped,
)
from dynappo.train import command  # noqa: E402

ROBOTS, ROWS = 3, 6
# two observations; phases too; one observation, with a history; a reset that settles
GO1, BIPED, SPOT, GETUP = (
    "Go1JoystickFlatTerrain BerkeleyHumanoidJoystickFlatTerrain SpotJoystickGaitTracking "
    "Go1Getup".split()
)
EVERY = [name for name in loading.names() if name != "BarkourJoystick"]  # a robot of Menagerie's


pytestmark = pytest.mark.usefixtures("stand_ins")


@functools.cache
def task(name):
    return loading.load(name).task


@functools.cache
def explored(name):
    """`(layout, what it was found by)`."""
    return parts.layout(task(name))


@functools.cache
def made(name):
    return made_with(name, random_clock=False)


def made_with(name, **options):
    found = explored(name)
    with mock.patch.object(parts, "layout", lambda _: found):
        return env.make(task(name), **options)


def actor(of):
    """The columns of obs that are the task's own `state`."""
    assert of.views is not None
    return of.views.actor


def const(of):
    return of.step.args[0]


def in_c(name, function):
    """`jax.jit(function)`, traced with C MuJoCo's physics."""

    def traced(*arguments):
        with c_physics.physics(task(name)):
            return function(*arguments)

    return jax.jit(traced)


def every(function):
    """A function of an `Env` for all robots, without hyper and body."""
    return jax.vmap(functools.partial(function, None, None))


@functools.cache
def restarted(name=GO1):
    """`f(states, fell, timed out, keys) -> states` of a task's robots; one program for all tests."""

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
        return every(made(name).autoreset)(states, outcome, keys)

    return in_c(name, some)


def started(name):
    """First states, by `autoreset` of empty ones: to compile `reset` takes as long again. It draws spares in
    the row 0, and starts from them when it is called again."""
    keys = jax.random.split(jax.random.key(3), ROBOTS)
    shapes = jax.eval_shape(every(made(name).reset), keys)
    states = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes)
    for _ in range(2):
        states = restarted(name)(states, jnp.ones(ROBOTS), jnp.zeros(ROBOTS), keys)
    return states


def drawn_actions(name):
    shape = ROWS, ROBOTS, made(name).action_size
    return 0.3 * np.random.default_rng(0).normal(size=shape).astype(np.float32)


def side_by_side(name, compiled):
    """`(states before, actions, states after, outcomes, Playground's own states)`, all [ROWS, ROBOTS].

    Playground's states go on from its own data, which are never rebuilt. `compiled(function)` jits it.
    """
    of, keys = made(name), jax.random.split(jax.random.key(3), ROBOTS)

    def both(ours, own, action):
        after, outcome = every(of.step)(ours, action, keys)
        return after, outcome, jax.vmap(task(name).step)(own, jnp.tanh(action))

    ours, both, rows = started(name), compiled(both), []
    own = jax.jit(jax.vmap(functools.partial(env.before_step, const(of))))(ours)
    for action in drawn_actions(name):
        after, outcome, theirs = both(ours, own, action)
        # what it begins with has other types: the first step would be a program of its own
        theirs = jax.tree.map(lambda x, like: jnp.asarray(x, like.dtype), theirs, own)
        rows.append((ours, action, after, outcome, theirs))
        ours, own = after, theirs
    return jax.tree.map(lambda *x: np.stack(x), *rows)


@functools.cache
def rollout(name):
    """`side_by_side` in C MuJoCo."""
    return side_by_side(name, functools.partial(in_c, name))


def same_as_own(name, rows):
    """Reward, observations, end, random keys and terms are those of the task's own step."""
    _, _, after, outcome, own = rows
    of = made(name)
    np.testing.assert_allclose(outcome.reward, own.reward, atol=1e-5)
    np.testing.assert_array_equal(1 - outcome.discount, own.done)
    np.testing.assert_allclose(after.qpos, own.data.qpos, atol=1e-4)
    seen = outcome.next_obs[..., actor(of)]
    np.testing.assert_allclose(seen, own.obs["state"], rtol=1e-3, atol=2e-3)
    privileged = raw(of, outcome)["privileged_state"]
    np.testing.assert_allclose(privileged, own.obs["privileged_state"], rtol=1e-3, atol=2e-3)
    np.testing.assert_array_equal(after.info["rng"], own.info["rng"])
    for term, value in own.metrics.items():
        told = outcome.metrics[env.column_name(term)]
        np.testing.assert_allclose(told, value, rtol=1e-3, atol=1e-4)


BOTH = [GO1, pytest.param(BIPED, marks=pytest.mark.slow)]


@pytest.mark.parametrize("name", BOTH)
def test_reward_observation_and_end_are_those_of_the_tasks_own_step(name):
    """Although MJX's data are rebuilt before each step; and no key of random numbers is another."""
    same_as_own(name, rollout(name))


@pytest.mark.slow
def test_they_are_on_mjx_too():
    same_as_own(GO1, side_by_side(GO1, jax.jit))


def raw(of, outcome):
    """Playground's observations, of ours."""
    layout, like = const(of).layout, const(of).like

    def one(obs, prop):
        return parts.unvector(layout.names, parts.unpack(layout, obs, prop), like).obs

    return jax.vmap(jax.vmap(one))(outcome.next_obs, outcome.next_prop)


@pytest.mark.slow  # MJX against C MuJoCo: tasks/test_env.py; the step, by the test above in C
def test_physics_of_mjx_are_those_of_c_mujoco():
    """Of one control step of our `step`, from the last row in C: the robot has landed."""
    before, action, after, outcome, _ = jax.tree.map(lambda x: x[-1, 0], rollout(GO1))
    step = jax.jit(functools.partial(made(GO1).step, None, None))
    found, told = step(before, action, jax.random.key(0))
    np.testing.assert_allclose(found.qpos, after.qpos, atol=2e-3)
    np.testing.assert_allclose(told.reward, outcome.reward, atol=2e-3)
    np.testing.assert_allclose(found.qvel, after.qvel, atol=0.2)


@pytest.mark.parametrize("name", BOTH)
def test_what_is_known_is_computed_exactly(name):
    """The next row's context, all that the model does not predict, from the row's own numbers."""
    before, action, _, outcome, _ = rollout(name)
    of = made(name)
    advance = jax.jit(jax.vmap(jax.vmap(functools.partial(of.advance, None))))
    size = of.prop_size
    found = advance(before.obs[..., size:], before.obs[..., :size], action, outcome.next_prop)
    assert (outcome.discount == 1).all()
    np.testing.assert_allclose(found, outcome.next_obs[..., size:], atol=1e-5)


@pytest.mark.slow  # its rollout is that of the tests above
def test_phases_are_known():
    """The biped's clock of the gait: cosine and sine of both feet."""
    of = made(BIPED)
    phases = actor(of)[-4:]
    assert (phases >= of.prop_size).all() and actor(of).size == 52
    seen = rollout(BIPED)[3].next_obs[..., phases]
    np.testing.assert_allclose(seen[..., :2] ** 2 + seen[..., 2:] ** 2, 1.0, atol=1e-5)


def test_noise_is_on_what_the_policy_senses_as_wide_as_the_task_says():
    """Uniform, of the five kinds of sensors; `prop` has none, and `sense` adds it."""
    before, *_ = rollout(GO1)
    of, scales = made(GO1), task(GO1)._config.noise_config.scales
    noise = const(of).layout.noise
    wide = np.repeat(
        [scales.linvel, scales.gyro, scales.gravity, scales.joint_pos, scales.joint_vel],
        [3, 3, 3, 12, 12],
    )
    np.testing.assert_allclose(noise[actor(of)[:33]], wide, rtol=1e-5)
    assert (noise[33:] == 0).all() and of.prop_size == 80
    off = np.abs(before.obs[..., : of.prop_size] - before.prop)
    assert (off <= noise + 1e-4).all() and (off[..., :33].max((0, 1)) > noise[:33] / 10).all()
    sensed = of.sense(None, jnp.zeros(80), None, jax.random.key(1))
    assert (np.abs(sensed) <= noise).all() and (sensed[:33] != 0).all()


def in_row(states, row):
    return states.replace(spare=states.spare.replace(rows=jnp.full(ROBOTS, row)))


def test_those_that_ended_start_from_their_spares_and_no_others():
    """Each from its own, with a random key of its own; the spares stay as they are in a row like this."""
    states = jax.tree.map(lambda x: jnp.asarray(x[-1]), rollout(GO1)[2])
    keys = jax.random.split(jax.random.key(9), ROBOTS)
    fell, late = np.array([1.0, 0, 0]), np.array([0.0, 0, 1])
    after, ended = restarted()(in_row(states, 5), fell, late, keys), (fell + late) > 0
    for old, new in zip(
        jax.tree.leaves(states.replace(spare=None)),
        jax.tree.leaves(after.replace(spare=None)),
        strict=True,
    ):
        np.testing.assert_array_equal(old[~ended], new[~ended])
    spares = states.spare.state
    np.testing.assert_array_equal(after.spare.state.qpos, spares.qpos)
    for name in ("qpos", "qvel", "obs", "prop"):
        np.testing.assert_array_equal(getattr(after, name)[ended], getattr(spares, name)[ended])
    assert (after.clock[ended] == 0).all() and (after.episode_return[ended] == 0).all()
    assert (after.info["rng"][ended] != spares.info["rng"][ended]).any(-1).all()
    assert len(np.unique(np.asarray(after.info["rng"]), axis=0)) == ROBOTS
    places = np.asarray(after.qpos[ended])
    assert len(np.unique(places[:, 0])) == ended.sum() and (np.abs(places[:, :2]) <= 0.5).all()


def test_all_spares_are_drawn_anew_when_their_time_has_come():
    """Every 10 resets' worth of rows: Go1Getup settles for 125 steps after a call, 5 a control step."""
    assert const(made(GO1)).every == 10 and const(made(GETUP)).every == 260
    states = jax.tree.map(lambda x: jnp.asarray(x[-1]), rollout(GO1)[2])
    keys, nobody = jax.random.split(jax.random.key(9), ROBOTS), jnp.zeros(ROBOTS)
    for row in (9, 11):
        after = restarted()(in_row(states, row), nobody, nobody, keys)
        np.testing.assert_array_equal(after.spare.state.qpos, states.spare.state.qpos)
    after = restarted()(in_row(states, 20), nobody, nobody, keys)
    assert (np.abs(after.spare.state.qpos - states.spare.state.qpos).max(-1) > 1e-3).all()
    assert len(np.unique(np.asarray(after.spare.state.qpos)[:, 0])) == ROBOTS
    np.testing.assert_array_equal(after.qpos, states.qpos)
    # who ends in this row starts from the old one, and the new one has another key
    after = restarted()(in_row(states, 20), jnp.ones(ROBOTS), nobody, keys)
    np.testing.assert_array_equal(after.qpos, states.spare.state.qpos)
    assert (after.info["rng"] != after.spare.state.info["rng"]).any(-1).all()


def test_a_reset_that_settles_is_made_ahead_too():
    """At first the spare is the first state itself, which lies on the ground."""
    states = in_c(GETUP, every(made(GETUP).reset))(jax.random.split(jax.random.key(3), ROBOTS))
    np.testing.assert_array_equal(states.spare.state.qpos, states.qpos)
    np.testing.assert_array_equal(states.spare.rows, np.zeros(ROBOTS))
    height = np.asarray(states.qpos)[:, 2]
    assert len(np.unique(height)) == ROBOTS and (height < 0.35).all()


def test_spares_of_several_seeds_are_drawn_in_the_same_rows():
    """Under their `vmap`; and one that is not finite is not taken."""
    keys = jax.random.split(jax.random.key(0), (2, 8))
    of = const(made(GO1))

    def one_state(x):
        x = x * jnp.ones(1)
        zero = jnp.zeros((), jnp.int32)
        return env.State(x, x, x, None, {}, x, x, zero, zero, x[0])

    def new(_, key):
        x = jax.random.uniform(key)
        return one_state(jnp.where(x > 0.8, jnp.nan, x))

    @jax.jit
    def drawn(ended, keys, states):
        with mock.patch.object(env, "first", new):
            restart = jax.vmap(jax.vmap(env.restart(of)))
            return restart(ended, jax.random.key_data(keys), states)

    start = jax.vmap(jax.vmap(lambda _: one_state(0.0)))(keys)
    nobody = jnp.zeros((2, 8), bool)
    for row, some in ((9, False), (10, True), (11, False), (20, True)):
        rows = jnp.full((2, 8), row)
        after = drawn(nobody, keys, start.replace(spare=env.Spare(start, rows)))
        spares = np.asarray(after.spare.state.qpos)[..., 0]
        assert np.isfinite(spares).all() and not np.asarray(after.qpos).any()
        assert len(np.unique(spares)) == (16 - (spares == 0).sum() + 1 if some else 1)
        assert 0 < (spares == 0).sum() < 8 if some else not spares.any()


@pytest.mark.parametrize("name", [SPOT])
def test_a_history_is_known_but_for_what_is_new(name):
    """Three steps of 12 errors: the newest is predicted, the others are those before, moved on."""
    of = made(name)
    layout = const(of).layout
    predicted = layout.source[: of.prop_size]
    assert layout.names == ("",) and actor(of).size == 69
    assert set(range(30)) <= set(predicted) and not set(range(30, 54)) & set(predicted)
    obs = jnp.arange(69.0) / 100
    like = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), const(of).like)
    info = like.info | {"qpos_error_history": obs[18:54]}
    numbers = parts.vector(layout.names, like._replace(obs=obs, info=info))
    before, size = numbers[layout.source], of.prop_size
    advance = jax.jit(functools.partial(of.advance, None))
    after = advance(before[size:], before[:size], jnp.zeros(of.action_size), None)
    seen = jnp.concatenate([before[:size], after])[actor(of)]
    np.testing.assert_allclose(seen[30:54], obs[18:42], atol=1e-6)


def test_a_mirror_image_is_found_where_there_is_one():
    """The biped's: velocities and joints of the other side, its command, the other foot's phase. Not Go1's,
    whose velocities are those of an IMU that sits 7 cm to the right."""
    of, (layout, probed) = made(BIPED), explored(BIPED)
    found = mirrored.find(task(BIPED), layout, probed)
    assert not isinstance(found, str)
    obs, action = found
    assert action.index.tolist() == [6, 7, 8, 9, 10, 11, 0, 1, 2, 3, 4, 5]
    seen = actor(of)
    one = np.arange(1.0, of.obs_size + 1)
    image = (obs.sign * one[obs.index])[seen]
    one = one[seen]
    places = dict(linvel=0, gyro=3, gravity=6, command=9, joints=12, velocities=24, last=36)
    for name, signs in (("linvel", [1, -1, 1]), ("gyro", [-1, 1, -1]), ("gravity", [1, -1, 1])):
        at = slice(places[name], places[name] + 3)
        np.testing.assert_array_equal(image[at], signs * one[at])
    at = slice(places["command"], places["command"] + 3)
    np.testing.assert_array_equal(image[at], [1, -1, -1] * one[at])
    for name in ("joints", "velocities", "last"):
        at = slice(places[name], places[name] + 12)
        np.testing.assert_array_equal(image[at], action.sign * one[at][action.index])
    np.testing.assert_array_equal(image[-4:], one[[-3, -4, -1, -2]])
    reason = mirrored.find(task(GO1), *explored(GO1))
    assert reason == "reward/lin_vel_z tells left from right"


def test_symmetry_is_refused_where_there_is_no_mirror_image():
    text = refused(functools.partial(made_with, symmetry=True), GO1)
    assert "ppo.symmetry is True, but this task has no mirror image: reward/lin_vel_z" in text
    assert set(settings.SYMMETRIC) <= set(loading.names())
    for name in (GO1, BIPED):
        config = config_lib.load(f"playground:{name}")
        assert config.ppo.symmetry == (name in settings.SYMMETRIC) == (name == BIPED)


@pytest.mark.parametrize("field", ["ppo.symmetry", "model.symmetry", "ppo.scale_inputs"])
def test_what_a_task_lacks_is_refused_before_a_word_of_compiling(
    field, tmp_path, monkeypatch, capsys
):
    """In one line, and no folder is left."""
    found = explored(GO1)
    monkeypatch.setattr(parts, "layout", lambda _: found)
    flags = [f"--config=playground:{GO1}", f"--workdir={tmp_path}/run", f"--config.{field}=True"]
    why = "ppo.scale_inputs is True, expected False: "
    if "symmetry" in field:
        flags.append("--config.ppo.symmetry=True")
        why = "this task has no mirror image: reward/lin_vel_z tells left from right"
    else:  # its own settings have a scale that is learned
        flags.append("--config.ppo.normalize=False")
    assert why in mistake(command.main, flags, capsys)
    assert not (tmp_path / "run").exists()


def test_a_task_that_is_checked_for_a_mirror_image_is_the_one_that_is_trained(monkeypatch):
    """It is probed once, which takes seconds."""
    probed = mock.Mock(return_value=explored(BIPED))
    monkeypatch.setattr(parts, "layout", probed)
    by_name._playground_task.cache_clear()
    config = config_lib.load(f"playground:{BIPED}")
    config.physics.impl = "jax"
    config = config_lib.validate(config)
    build.check(config)
    assert probed.call_count == 1
    found = by_name.make(config, impl="jax", platform="cpu")
    assert found.env.mirror is not None and probed.call_count == 1
    by_name._playground_task.cache_clear()  # with what only this test has


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_the_tasks_with_a_mirror_image_are_those_named(name):
    found = mirrored.find(task(name), *explored(name))
    assert isinstance(found, str) == (name not in settings.SYMMETRIC), found


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


def test_a_film_shows_shapes_where_meshes_are_missing():
    """The trunk an ellipsoid; thighs and calves are capsules from joint to joint and to the foot."""
    model = task(GO1).mj_model
    drawn, kinds = assets.shown(model), mujoco.mjtGeom
    assert (model.geom_type == kinds.mjGEOM_MESH).sum() >= 13, "the model is as it was"

    def shape(body):
        seen = (drawn.geom_bodyid == model.body(body).id) & (drawn.geom_rgba[:, 3] > 0)
        (geom,) = np.flatnonzero(seen & (drawn.geom_group < 3))
        return geom, drawn.geom_type[geom], drawn.geom_size[geom]

    _, kind, size = shape("trunk")
    assert kind == kinds.mjGEOM_ELLIPSOID and 0.15 < size.max() < 0.4 and size.min() > 0.02
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(task(GO1)._init_q)
    mujoco.mj_kinematics(model, data)
    seen = mujoco.MjData(drawn)
    seen.qpos[:] = data.qpos
    mujoco.mj_kinematics(drawn, seen)
    for leg in ("FR", "RL"):
        ends = [data.body(f"{leg}_{part}").xpos for part in ("thigh", "calf")]
        ends.append(data.geom(leg).xpos)
        for part, one, other in zip(("thigh", "calf"), ends, ends[1:], strict=False):
            geom, kind, size = shape(f"{leg}_{part}")
            assert kind == kinds.mjGEOM_CAPSULE and 0.01 < size[0] < 0.05
            np.testing.assert_allclose(seen.geom_xpos[geom], (one + other) / 2, atol=1e-6)
            along = seen.geom_xmat[geom].reshape(3, 3)[:, 2] * 2 * size[1]
            np.testing.assert_allclose(along, other - one, atol=1e-6)


def test_the_error_is_that_of_the_velocity_in_the_bases_frame():
    """The row's command less what MuJoCo says of the data after it; getting up has none."""
    before, _, after, outcome, _ = rollout(GO1)
    model = task(GO1).mj_model
    data = mujoco.MjData(model)
    for at in np.ndindex(ROWS, ROBOTS):
        data.qpos[:], data.qvel[:] = after.qpos[at], after.qvel[at]
        mujoco.mj_forward(model, data)
        moves = np.zeros(6)
        kind = mujoco.mjtObj.mjOBJ_XBODY
        mujoco.mj_objectVelocity(model, data, kind, model.body("trunk").id, moves, 1)
        off = np.array([moves[3], moves[4], moves[2]]) - before.info["command"][at]
        errors = [outcome.metrics[name][at] for name in env.ERRORS]
        np.testing.assert_allclose(
            errors, [(off[:2] ** 2).sum(), off[2] ** 2], rtol=1e-3, atol=1e-5
        )
    assert np.asarray(before.info["command"]).any()
    assert set(env.ERRORS) <= set(made(GO1).metrics)
    assert not set(env.ERRORS) & set(made(GETUP).metrics)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        (GO1, [1.5, 0.8, 1.2]),
        ("G1JoystickFlatTerrain", [1.0, 0.5, 1.0]),
        ("ApolloJoystickFlatTerrain", [1.5, 0.8, 1.5]),
        (SPOT, [1.0, 0.5, 1.0]),
        (GETUP, None),
    ],
)
def test_ranges_of_commands_are_those_that_the_task_draws_from(name, expected):
    """As the task's own config has them, each in its way."""
    reset = functools.partial(reset_without_physics, task(name))
    found = commands.ranges(task(name), jax.eval_shape(reset, jax.random.PRNGKey(0)))
    if expected is None:
        assert found is None
        return
    assert found is not None
    np.testing.assert_allclose(found, np.outer(expected, [-1, 1]), atol=1e-6)


def reset_without_physics(of, key):
    with swapped.physics(lambda data, ctrl, n: data):
        return of.reset(key).info


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


@pytest.mark.parametrize("name", loading.names())
def test_ppo_is_exactly_playgrounds_settings(name):
    """Number by number, of each task; what no row names has no counterpart (settings.py)."""
    theirs = loading.ppo_config(name)
    config = config_lib.validate(config_lib.load(f"playground:{name}:ppo"))
    ppo, networks = config.ppo, theirs.network_factory
    assert config.rollout.num_envs == theirs.num_envs == theirs.batch_size * theirs.num_minibatches
    assert config.rollout.horizon == theirs.unroll_length and theirs.action_repeat == 1
    assert (ppo.minibatches, ppo.epochs) == (theirs.num_minibatches, theirs.num_updates_per_batch)
    assert (ppo.gamma, ppo.lambda_) == (theirs.discounting, 0.95)
    assert (ppo.learning_rate, ppo.entropy_coef) == (theirs.learning_rate, theirs.entropy_cost)
    assert ppo.clip_epsilon == theirs.get("clipping_epsilon", 0.3)
    assert ppo.max_grad_norm == theirs.max_grad_norm == 1.0 and theirs.reward_scaling == 1
    assert (
        ppo.normalize == theirs.normalize_observations and not ppo.adaptive and not ppo.clip_value
    )
    assert ppo.hidden == networks.policy_hidden_layer_sizes and ppo.activation == "swish"
    assert (ppo.critic_hidden or ppo.hidden) == networks.value_hidden_layer_sizes
    assert (ppo.critic == "state") == (networks.value_obs_key == "privileged_state")
    assert networks.policy_obs_key == "state" and not ppo.symmetry
    assert config.task.episode_length == theirs.episode_length
    steps = config.run.num_iterations * theirs.num_envs * theirs.unroll_length
    per_log = config.run.log_every * theirs.num_envs * theirs.unroll_length
    assert theirs.num_timesteps <= steps < theirs.num_timesteps + per_log
    assert config.schedule.end_steps == 0 and not schedule.uses_model(config_lib.split(config)[0])


@pytest.mark.parametrize("name", loading.names())
def test_best_is_valid_for_each_task(name):
    config = config_lib.validate(config_lib.load(f"playground:{name}"))
    assert (config.rollout.num_envs, config.rollout.horizon) == (1024, 24)
    assert (config.schedule.end_steps, config.schedule.rounds) == (20, 3)
    assert config.model.clean and config.model.falls and config.ppo.critic == "state"
    assert config.model.known_reward == (name[:3] in ("Go1", "Spo", "Op3", "Bar"))
    assert config.ppo.normalize and config.run.video_seconds > 0


def test_where_warp_has_no_room_for_contacts_the_run_ends():
    """It flags each world; a step's metrics have the flags, and the host looks at their sums."""
    for flags, constraints, contacts in (
        (0, 0, 0),
        (1 << 9, 0, 0),
        (1, 1, 0),
        (8, 0, 1),
        (2 | 4, 1, 1),
    ):
        data = python_types.SimpleNamespace(
            _impl=python_types.SimpleNamespace(overflow=jnp.array(flags))
        )
        told = env.overflows(data)
        found = told["overflow_constraints"], told["overflow_contacts"]
        assert found == (constraints, contacts), flags
    nothing = python_types.SimpleNamespace(_impl=python_types.SimpleNamespace())
    assert env.overflows(nothing) == {}
    metrics = {"iteration": np.array([4, 5]), "overflow_contacts": np.array([0.0, 0.0])}
    overflow.check(metrics)
    metrics["overflow_contacts"][1] = 0.25
    with pytest.raises(
        FloatingPointError, match=r"no room for all contacts in iteration 5, in 25.00%"
    ):
        overflow.check(metrics)
    several = np.array([[0.0, 0.0], [0.0, 0.5]])  # seeds
    with pytest.raises(FloatingPointError, match="constraints in iteration 5"):
        overflow.check({"iteration": np.array([4, 5]), "overflow_constraints": several})


def test_warps_flags_are_those_that_are_looked_at():
    """Of its own names; a solver that stops at its limit is no overflow."""
    kinds = pytest.importorskip("mujoco.mjx.third_party.mujoco_warp").OverflowType
    rows, contacts = env.OVERFLOWS["overflow_constraints"], env.OVERFLOWS["overflow_contacts"]
    assert rows == kinds.NEFC | kinds.NJMAX_NNZ
    of_contacts = kinds.BROADPHASE | kinds.NARROWPHASE | kinds.CCD | kinds.HFIELD
    assert contacts == of_contacts | kinds.CONTACT_MATCH


def test_room_for_contacts_is_for_all_robots_and_more_for_few():
    """4 a robot here, one of each foot, which is the task's own number."""
    for worlds, contacts in ((8192, 4 * 8192), (1024, 4096), (128, 2048), (1, 16)):
        assert loading.load(GO1, worlds=worlds).task._config.naconmax == contacts
    assert loading.own_room(loading.made(GO1)[0]) == (40, 4)


@pytest.mark.parametrize(
    ("name", "constraints", "contacts"),
    [
        # 12 frictions, 12 limits, 4 feet with 4 rows of a pyramid
        (GO1, 40, 4),
        # 4 of each foot on a height field
        ("Go1JoystickRoughTerrain", 12 + 12 + 16 * 4, 16),
        # 8 of each box with the plane, 8 of the two boxes, 2 of each hand and thigh, all without friction
        ("G1JoystickFlatTerrain", 29 + 29 + 16 * 4 + 12, 16),
        ("SpotFlatTerrainJoystick", 40, 4),
        # whose shapes could have 276 and 64: it never gets all
        ("Op3Joystick", 200, 16),
        # asks for more
        ("Go1Getup", 250, 30),
    ],
)
def test_a_robot_has_room_for_all_constraints(name, constraints, contacts):
    """Those of its model, by hand; and no task has less than it asks for."""
    config = loading.load(name, worlds=8192).task._config
    assert (config.njmax, config.naconmax) == (constraints, contacts * 8192)
    own = loading.own_room(loading.made(name)[0])
    assert config.njmax >= own[0] and config.naconmax >= own[1] * 8192


@pytest.mark.parametrize("name", ["G1JoystickFlatTerrain", BIPED, "Go1Getup"])
def test_the_shapes_that_may_touch_are_those_that_warp_tries(name):
    """And contacts of robots in poses by chance, mostly inside themselves, have the condim that we name."""
    warp = pytest.importorskip("mujoco.mjx.third_party.mujoco_warp")
    model, draw = task(name).mj_model, np.random.default_rng(0)
    named = {(a, b): dim for a, b, dim in room.pairs(model)}
    tried = warp.put_model(model).nxn_geom_pair_filtered.numpy().tolist()
    assert {tuple(sorted(pair)) for pair in tried} == set(named)
    data, seen = mujoco.MjData(model), set()
    for _ in range(50):
        data.qpos[:] = draw.normal(size=model.nq)
        data.qpos[2] = draw.uniform(0.0, 0.6)
        mujoco.mj_forward(model, data)
        seen |= {(*sorted(map(int, one.geom)), int(one.dim)) for one in data.contact}
    assert seen and all(named[a, b] == dim for a, b, dim in seen)


def test_an_exported_policy_takes_the_tasks_observation(tmp_path, capsys, monkeypatch):
    """ONNX against NumPy: the scaling of inputs is in it, and a tanh at its end."""
    runtime = pytest.importorskip("onnxruntime")
    config = config_lib.validate(config_lib.load(f"playground:{GO1}:ppo"))
    draw = np.random.default_rng(0)
    sizes = (48, 8, 12)
    layers = {
        f"Dense_{i}": {
            "kernel": draw.normal(size=sizes[i : i + 2]),
            "bias": draw.normal(size=sizes[i + 1]),
        }
        for i in range(2)
    }
    inputs = {"actor": {"count": 9.0, "mean": draw.normal(size=48), "m2": draw.uniform(1, 90, 48)}}
    params = jax.tree.map(np.float32, {"actor": {"params": layers}, "inputs": inputs})
    policy_file.save(tmp_path / "policy.npz", params, config, None)
    file = str(tmp_path / "policy.npz")

    def here(policy, out):  # not in a process of its own, which the slow test below starts
        files.write_json(out, by_name.facts(f"playground:{GO1}"))
        return 0

    monkeypatch.setattr(recorded, "facts", here)
    assert status(export.main, file, f"--out={tmp_path}/p.onnx") == 0
    told = capsys.readouterr().out
    assert "obs [batch, 48]" in told and "FR_hip_joint" in told
    net = runtime.InferenceSession(str(tmp_path / "p.onnx"))
    obs = draw.normal(size=(5, 48)).astype(np.float32)
    act = policy_file.load_actor(tmp_path / "policy.npz")
    np.testing.assert_allclose(net.run(None, {"obs": obs})[0], np.tanh(act(obs)), atol=1e-5)
    about = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    assert about["task"] == f"playground:{GO1}" and about["control_dt"] == 0.02
    np.testing.assert_allclose(about["default_pose"], task(GO1)._default_pose)
    assert about["action_scale"] == task(GO1)._config.action_scale
    assert len(about["joint_names"]) == 12 and about["config"]["ppo"]["normalize"]
    for flag, said in (
        (f"--out={tmp_path}/p.yaml", "FILE.onnx alone"),
        ("--targets", "of its own"),
    ):
        flags = (flag,) if "out" in flag else (flag, f"--out={tmp_path}/q.onnx")
        assert status(export.main, file, *flags) == 2 and said in capsys.readouterr().err


def test_an_evaluation_needs_no_flag_and_tells_terms_of_the_reward():
    """Also of a policy that was trained on a GPU, and evaluated every 200 iterations."""
    flags = python_types.SimpleNamespace(
        episodes=None, record="", stress=False, crossing=False, fast=False, randomize=False
    )
    config = config_lib.load(f"playground:{GO1}:ppo")
    config.physics.impl, config.run.eval_every, config.run.num_seeds = "warp", 200, 4
    policy = policy_file.Other(config, {})
    checked = task_episodes.check(policy, flags)
    assert (checked.physics.impl, checked.run.num_seeds) == ("auto", 1)
    flags.fast = flags.stress = True  # as --stress sets both
    assert refused(task_episodes.check, policy, flags).startswith("--stress: ")
    numbers = {"yaw_error": None, "return": 30.694, "fall_rate": 0.25}
    rows = task_episodes.table(numbers, {"pose": 50.0, "torques": -2.0, "alive": None}, 0.02)
    assert rows[:3] == [
        ("return", "30.69"),
        ("fall rate", "0.250 of the episodes"),
        ("yaw error", "-"),
    ]
    terms = {name.strip(): text.split() for name, text in rows[4:]}
    assert terms["pose"] == ["50.00", "1.000"] and terms["torques"] == ["-2.00", "-0.040"]
    assert terms["alive"] == ["-", "-"]


@pytest.mark.parametrize(
    ("impl", "platform", "seeds", "engine"),
    [
        ("jax", "cpu", 1, "c"),
        ("jax", "cpu", 2, "jax"),
        ("jax", "gpu", 1, "jax"),
        ("warp", "gpu", 1, "warp"),
    ],
)
def test_a_cpu_evaluates_in_c_as_evaluate_does(impl, platform, seeds, engine, monkeypatch):
    """So a training on MJX there compiles MJX once. C's physics have one axis of robots, so of one seed."""
    monkeypatch.setattr(by_name, "_playground", lambda config, impl: ("env", "task"))
    monkeypatch.setattr(c_physics, "physics", lambda task: f"C MuJoCo's of {task}")
    config = config_lib.load(f"playground:{GO1}")
    config.run.num_seeds = seeds
    found = by_name.make(config, impl=impl, platform=platform)
    assert (found.env, found.engine) == ("env", engine)
    assert (found.evaluating == "C MuJoCo's of task") == (engine == "c")


@pytest.mark.parametrize("name", [GO1, "G1JoystickFlatTerrain"])
def test_a_films_camera_sees_the_whole_robot_and_its_arrows(name):
    """From floor to the arrows' height, above and below the base that it follows."""
    model = task(name).mj_model
    data = mujoco.MjData(model)
    data.qpos[:] = np.asarray(task(name)._init_q)
    mujoco.mj_forward(model, data)
    base = int(model.jnt_bodyid[0])
    view = render.whole(model, data, base)
    half = view.distance * np.tan(np.deg2rad(model.vis.global_.fovy) / 2)
    assert half > 1.1 * max(data.xpos[base, 2], render.lift(model, data, base))
    assert view.trackbodyid == base and view.distance < 4


def test_mistakes_are_one_line(monkeypatch):
    """A wrong name, variant or engine; a robot that has no stand-in; Playground not installed."""
    assert "there is Go1Joystick" in refused(loading.check, "Go1Joystik")
    assert "'best' is not" not in refused(config_lib.load, f"playground:{GO1}:fast")
    assert "is not one of best, ppo" in refused(config_lib.load, f"playground:{GO1}:fast")
    assert "no locomotion task ''" in refused(config_lib.load, "playground")
    assert assets.VARIABLE in refused(loading.check, "BarkourJoystick")
    config = config_lib.load(f"playground:{GO1}")
    for field in ("task.weights.vertical_velocity", "task.noise.gravity", "physics.timestep"):
        told = refused(config_lib.override, config, field, "0.1")
        assert told.startswith(f"--config.{field}: playground:{GO1} has its own weights, noise")
    config_lib.override(config, "task.episode_length", "500")
    assert config.task.episode_length == 500
    config.physics.impl = "c"
    assert "expected jax or warp" in refused(by_name.check, config)
    config.env = "gym:Ant"
    assert "expected playground:TASK or brax:NAME" in refused(by_name.check, config)
    for name, told in (("", "there is ant, halfcheetah, hopper, "), ("hoper", "there is hopper")):
        config.env = f"brax:{name}"  # its `fast` is for tests
        assert told in refused(by_name.check, config)
    config.robot = "go1"
    assert "expected '' where a robot is named" in refused(config_lib.validate, config)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert refused(loading.names).endswith(shell.install("playground"))


def test_without_playground_each_command_says_in_one_line_how_to_install_it(
    tmp_path, monkeypatch, capsys
):
    """With this Python, in no other process; and what such a process refuses is that one line."""
    config = config_lib.validate(config_lib.load(f"playground:{GO1}:ppo"))
    layers = {"Dense_0": {"kernel": np.ones((48, 12)), "bias": np.ones(12)}}
    params = jax.tree.map(np.float32, {"actor": {"params": layers}})
    policy_file.save(tmp_path / "policy.npz", params, config, None)
    file, find = str(tmp_path / "policy.npz"), importlib.util.find_spec
    started = mock.Mock(side_effect=AssertionError)
    with monkeypatch.context() as m:
        m.setattr(importlib.util, "find_spec", lambda n: None if "playgr" in n else find(n))
        m.setattr(task_player.subprocess, "Popen", started)
        for main, argv in (
            (command.main, [f"--config=playground:{GO1}"]),
            (play.main, [file, f"--out={tmp_path}/a.html"]),
            (play.main, [file, "--serve"]),
            (evaluate.main, [file, f"--out={tmp_path}/e"]),
            (export.main, [file, f"--out={tmp_path}/p.onnx"]),
        ):
            assert "not installed; " + shell.install("playground") in mistake(main, argv, capsys)
    code = f"print('{json.dumps({task_player.REFUSED: 'no such robot'})}')"
    monkeypatch.setattr(task_player.interpreter, "command", lambda _: [sys.executable, "-c", code])
    assert refused(task_player.start, f"playground:{GO1}") == "no such robot"


def test_a_name_is_known_without_the_import_of_its_package():
    """That takes 3 to 40 s."""
    code = "import sys; from dynappo.tasks import names; print(names.registered('brax', 'envs'), "
    code += "names.registered('mujoco_playground', '_src.locomotion'), 'jax' in sys.modules)"
    from brax import envs

    assert answers.shell("-c", code).stdout == f"{sorted(envs._envs)} {loading.names()} False\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", EVERY)
def test_every_task_has_parts_and_a_step(name):
    """One step of each from a tail's side: shapes, and numbers that are finite."""
    of = made(name)
    context = jnp.zeros(of.obs_size - of.prop_size)
    found = of.advance(None, context, jnp.zeros(of.prop_size), jnp.zeros(of.action_size), None)
    assert found.shape == context.shape and bool(jnp.isfinite(found).all())
    assert 0 < of.prop_size < of.obs_size


SMALL = """rollout.num_envs=8 rollout.horizon=6 ppo.minibatches=2 run.log_every=1 model.minibatches=3
    model.hidden=(16,) ppo.hidden=(16,) ppo.critic_hidden=(16,) run.device=cpu model.precision=highest
    ppo.precision=highest""".split()


@pytest.mark.slow  # MJX compiles twice, 100 s of a processor
def test_two_devices_compute_what_one_does():
    """Three iterations on MJX, two of them with a tail, and resets in each but the last: every metric, and
    the robots. Later ones differ as two machines do: feet that just touch magnify rounding. Inputs are not
    scaled, for numbers that have not changed yet are divided by nearly nothing."""
    fields = """schedule.end_steps=4 schedule.start_iteration=1 schedule.end_iteration=1 run.num_iterations=3
        ppo.normalize=False ppo.adaptive=False ppo.learning_rate=1e-4 ppo.min_learning_rate=1e-5
        ppo.max_learning_rate=1e-4 model.bound=3.0 ppo.shuffle_blocks=2 run.eval_envs=0 run.video_seconds=0
        task.episode_length=8""".split()

    def trained(devices):
        config = config_lib.load(f"playground:{GO1}")
        for field in (*SMALL, *fields, f"run.mesh_env={devices}"):
            config_lib.override(config, *field.split("=", 1))
        program = build.program(config_lib.validate(config))
        shards = program.state.env_state.obs.addressable_shards
        assert [x.data.shape[0] for x in shards] == [8 // devices] * devices
        state, found = program.state, []
        for i in range(3):
            row = {name: column[i : i + 1] for name, column in program.columns.items()}
            state, metrics = program.step(program.hyper, state, row)
            found.append(jax.device_get((metrics, state.env_state.qpos)))
        return found

    one, two = trained(1), trained(2)
    assert one[0][0]["timeouts"] > 0 and one[1][0]["timeouts"] > 0
    for i, ((expected, place), (found, moved)) in enumerate(zip(one, two, strict=True)):
        for name, value in expected.items():
            atol = (1e-4, 1e-4, 1e-2)[i]
            np.testing.assert_allclose(found[name], value, 1e-3, atol, err_msg=name)
        np.testing.assert_allclose(moved, place, atol=(1e-5, 1e-3, 1e-2)[i])


@pytest.mark.slow
@pytest.mark.parametrize("spec", [f"playground:{GO1}", f"playground:{GO1}:ppo", "brax:hopper"])
def test_a_run_from_the_command_line_trains_resumes_and_is_evaluated(spec, tmp_path, monkeypatch):
    """As a user gives it, at the least size."""
    monkeypatch.undo()
    more = """run.num_iterations=2 run.eval_envs=2 run.eval_steps=4 ppo.shuffle_blocks=1
        run.video_seconds=0.1""".split()
    flags = [f"--config.{field}" for field in (*SMALL, *more)]
    if not spec.endswith(":ppo"):
        flags += [
            f"--config.schedule.{x}"
            for x in ("end_steps=4", "start_iteration=0", "end_iteration=0")
        ]
    assert status(command.main, f"--config={spec}", f"--workdir={tmp_path}/run", *flags) == 0
    more = "--config.run.num_iterations=3"
    assert status(command.main, f"--workdir={tmp_path}/run", more) == 0
    assert (tmp_path / "run" / "policy.npz").is_file() and "dynappo" in sys.modules
    exported = status(export.main, f"{tmp_path}/run", f"--out={tmp_path}/p.onnx")
    assert exported == 0 and (tmp_path / "run" / "video.mp4").stat().st_size > 1000
