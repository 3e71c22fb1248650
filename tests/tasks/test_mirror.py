"""The mirror images of the robots, by physics: the mirrored robot makes the mirrored step."""

from types import SimpleNamespace

import jax
import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.config import ConfigError, files
from dynappo.description import robot as robot_lib
from dynappo.program import build
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import mirror, view
from dynappo.types import Mirror

ROBOTS = 16
# of position and quaternion (w, x, y, z), and of linear and angular velocity
QPOS, QVEL = np.array([1, -1, 1, 1, -1, 1, -1]), np.array([1, -1, 1, -1, 1, -1])
OTHER_FOOT = np.array([1, 0, 3, 2])  # front left, front right, hind left, hind right
CLOCKS = ("air_steps", "contact_steps", "last_air_steps", "peak", "last_peak")
# of a step: Go1's base has its centre of mass 2 mm to the left, the others' sides are more alike
UNLIKE = {"go1": 0.05, "go2": 0.002, "anymal_c": 0.01, "anymal_d": 0.01}


def turned(table, x):
    """The mirror image of `x` by a table."""
    return np.asarray(table.sign, np.float32) * np.asarray(x)[..., table.index]


# the four have the same joints: two of them by default
SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("go2", "anymal_c")]


@pytest.fixture(scope="module", params=["go1", "anymal_d", *SLOW])
def world(request):
    """Robots that stumble, and `step(state, action) -> Outcome` of all of them."""
    config = config_lib.load(f"configs/{request.param}.py")
    config.physics.update(iterations=20, ls_iterations=20)
    config.task.randomize.base_com = (0.0, 0.0, 0.0)
    for name in config.task.noise:
        config.task.noise[name] = 0.0
    config = config_lib.validate(config)
    robot, hyper = robot_lib.load(request.param), config_lib.split(config)[1]
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    bodies = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, bodies, keys)
    step = jax.jit(jax.vmap(env.step, (None, 0, 0, 0, 0)))
    rng = np.random.default_rng(0)
    for action in rng.normal(0, 1, (15, ROBOTS, 12)).astype(np.float32):
        state, _ = step(hyper, bodies, state, action, keys)
    state = jax.device_get(state)
    state = state.replace(qacc_warmstart=state.qacc_warmstart * 0)
    call = lambda state, action: jax.device_get(step(hyper, bodies, state, action, keys)[1])  # noqa: E731
    action = rng.normal(0, 1, (ROBOTS, 12)).astype(np.float32)
    return SimpleNamespace(name=request.param, env=env, state=state, action=action, step=call)


def image(state, obs, joints):
    """The mirror image of robots, by hand but for the two tables."""
    base = (state.qpos[:, :7] * QPOS, state.qvel[:, :6] * QVEL)
    qpos, qvel = (
        np.concatenate([flipped, turned(joints, x[:, flipped.shape[1] :])], -1)
        for flipped, x in zip(base, (state.qpos, state.qvel), strict=True)
    )
    flipped = {name: getattr(state, name)[:, OTHER_FOOT] for name in CLOCKS}
    flipped |= {"qpos": qpos, "qvel": qvel, "obs": turned(obs, state.obs)}
    flipped |= {"command": state.command * [1, -1, -1]}
    flipped |= {"last_action": turned(joints, state.last_action)}
    new = {name: x.astype(getattr(state, name).dtype) for name, x in flipped.items()}
    return state.replace(**new)


def unlike(world, obs, joints):
    """How far the mirrored robots' steps are from mirrored steps, as a share of the step; and the
    differences of reward and discount."""
    one = world.step(world.state, world.action)
    other = world.step(image(world.state, obs, joints), turned(joints, world.action))
    apart = np.linalg.norm(other.next_obs - turned(obs, one.next_obs), axis=-1)
    step = np.linalg.norm(one.next_obs - world.state.obs, axis=-1)
    return apart / step, other.reward - one.reward, other.discount - one.discount


def test_a_mirrored_robot_makes_the_mirrored_step_for_the_same_reward(world):
    apart, reward, discount = unlike(world, *world.env.mirror)
    assert apart.max() < UNLIKE[world.name] and not discount.any()
    assert np.abs(reward).max() < 0.03 * UNLIKE[world.name] + 1e-4


def test_with_a_wrong_sign_it_does_not(world):
    """So the test above would see one."""
    obs, joints = world.env.mirror
    for i in range(3):
        sign = joints.sign * np.where(np.arange(12) % 3 == i, -1, 1)
        whole = np.concatenate([sign, sign, obs.sign[24:36], sign])
        apart, *_ = unlike(world, Mirror(obs.index, whole), Mirror(joints.index, sign))
        assert apart.min() > 4 * UNLIKE[world.name]


def test_a_robot_with_two_sides_that_differ_has_no_mirror_image(tmp_path):
    text = files.find("robots", "go1/go1.xml").read_text()
    assert 'name="FL_hip" pos="0.1881 0.04675 0"' in text
    (tmp_path / "lame.xml").write_text(text.replace("0.1881 0.04675 0", "0.1881 0.06 0"))
    robot = robot_lib.load_xml(tmp_path / "lame.xml")
    assert mirror.images(robot, view.make("full", 1, 12)) is None
    with pytest.raises(ConfigError, match="robot lame is not its own mirror image: .*FL_hip_joint"):
        mirror.joints(robot)


def test_a_robot_without_a_mirror_image_is_refused_before_anything_is_compiled(
    tmp_path, monkeypatch
):
    """Where `ppo.symmetry` asks for one; else it trains."""
    folder = tmp_path / "robots" / "lame"
    folder.mkdir(parents=True)
    text = files.find("robots", "go1/go1.xml").read_text()
    (folder / "lame.xml").write_text(text.replace("0.1881 0.04675 0", "0.1881 0.06 0"))
    monkeypatch.chdir(tmp_path)
    config = config_lib.load("configs/go1.py:laptop")
    config.robot = "lame"
    with pytest.raises(ConfigError, match="robot lame is not its own mirror image"):
        build.check(config_lib.validate(config))
    config.ppo.symmetry = False
    build.check(config_lib.validate(config))
