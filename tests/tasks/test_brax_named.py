"""brax's environments by their names: one robot to be looked at, its file for a controller, and refusals."""

import base64
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import mistake, refused, status
from brax import kinematics

from dynappo import config as config_lib
from dynappo.evaluate import task_steps
from dynappo.export import command as export
from dynappo.learner import networks
from dynappo.page import episode_page
from dynappo.play import command as play
from dynappo.policy import policy_file, recorded, render, task_player
from dynappo.program import build
from dynappo.tasks import brax_named, by_name, names, single
from dynappo.train import command as train

NAME = "inverted_pendulum"  # a cart on a rail, 2 joints and a motor: compiled soonest
ENV = f"brax:{NAME}"
NOTHING, STILL = np.zeros(3), np.zeros(1)


@pytest.fixture(scope="module")
def cart():
    return by_name.single(ENV)


def moved(robot, state, action=STILL, push=NOTHING, force=NOTHING):
    return robot.step(state, np.full(3, np.nan), push, force, action)


def rotated(quat, vector):
    """A vector turned by a quaternion, in NumPy."""
    w, xyz = quat[0], quat[1:]
    return vector + 2 * np.cross(xyz, np.cross(xyz, vector) + w * vector)


def test_mujocos_warnings_are_dropped_only_while_brax_reads_its_files():
    """Those of everything else in the process are told as before."""
    before = mujoco.get_mju_user_warning()
    heard = []
    mujoco.set_mju_user_warning(heard.append)
    try:
        mine = mujoco.get_mju_user_warning()
        brax_named.bare.__wrapped__(NAME)
        assert mujoco.get_mju_user_warning() is mine and not heard
    finally:
        mujoco.set_mju_user_warning(before)


def test_it_moves_as_brax_does_by_hand(cart):
    """From the same state: rounding cannot grow. The motor gets 3 times the action, as brax scales it."""
    by_hand = jax.jit(brax_named.bare(NAME).step)
    state, seen = cart.first(3)
    assert np.abs(seen.obs).max() < 0.02 and seen.qpos.shape == (2,)
    for action in ([0.4], [-0.9], [7.0]):
        theirs = by_hand(state.brax, jnp.clip(jnp.array(action), -1, 1))
        state, seen = moved(cart, state, np.array(action))
        np.testing.assert_allclose(seen.obs, theirs.obs, atol=1e-5)
        np.testing.assert_allclose(seen.qpos, theirs.pipeline_state.q, atol=1e-5)
        assert (float(seen.reward), float(seen.ok)) == (1.0, 1.0)
        np.testing.assert_allclose(seen.ctrl, 3 * np.clip(action, -1, 1), rtol=1e-5)
    other = cart.first(4)[1].obs
    assert np.abs(other - cart.first(3)[1].obs).max() > 1e-3
    np.testing.assert_array_equal(other, cart.first(4)[1].obs)
    for _ in range(40):  # the pole falls over
        state, seen = moved(cart, state, np.ones(1))
    assert float(seen.fell) == 1 and abs(seen.obs[1]) > 0.2


def test_limbs_are_drawn_where_brax_has_them(cart):
    """Its joints are springs, so MuJoCo would put them elsewhere by q."""
    state, seen = cart.first(0)
    for _ in range(4):
        state, seen = moved(cart, state, np.ones(1))
    x, model = state.brax.pipeline_state.x, cart.model
    data = mujoco.MjData(model)
    data.qpos[:] = seen.qpos
    mujoco.mj_forward(model, data)
    assert 1e-3 < np.abs(data.xpos[1:] - x.pos).max() < 0.1
    render.place(model, data, seen.pose)
    for geom, body in enumerate(model.geom_bodyid):
        if body:
            at = np.asarray(x.pos[body - 1], float)
            at = at + rotated(np.asarray(x.rot[body - 1], float), model.geom_pos[geom])
            np.testing.assert_allclose(data.geom_xpos[geom], at, atol=1e-5)
    pole = model.geom("cpole").id
    local = rotated(model.geom_quat[pole], np.array([0.0, 0, 1]))
    local = rotated(np.asarray(x.rot[1], float), local)
    np.testing.assert_allclose(data.geom_xmat[pole].reshape(3, 3)[:, 2], local, atol=1e-5)
    assert abs(local[0]) > 0.01  # it leans
    # and so they are on a page
    player = SimpleNamespace(
        model=model, base_body=single.base(model), ground=model.body_weldid[model.geom_bodyid] == 0
    )
    rows = dict(qpos=[seen.qpos], pose=[seen.pose], command=[NOTHING], velocity=[NOTHING])
    rows = {name: np.array(values) for name, values in rows.items()}
    scene = episode_page.scene(player, rows | {"fell": np.zeros(1, bool), "dt": np.array(cart.dt)})
    root = np.frombuffer(base64.b64decode(scene["root"]), "<f4")
    np.testing.assert_allclose(root, x.pos[0], atol=1e-6)
    relative = np.frombuffer(base64.b64decode(scene["position"]), "<i2").reshape(2, 3)[1]
    np.testing.assert_allclose(relative * scene["unit"], x.pos[1] - x.pos[0], atol=1e-4)


def test_a_push_is_a_velocity_and_a_pull_a_force_along_the_rail(cart):
    """And across the rail neither moves it. The cart pulls its pole along: F dt = m dv of both is the least
    that they take up, for a pole that stays behind."""
    state, _ = cart.first(0)
    for _ in range(3):
        state, _ = moved(cart, state)

    def faster(**given):
        quiet, loud = (moved(cart, state, **more)[1] for more in ({}, given))
        return loud.qvel - quiet.qvel

    along, across = np.array([0.5, 0, 0]), np.array([0, 0.5, 0.5])
    assert faster(push=along)[0] == pytest.approx(0.5, rel=0.15)
    assert np.abs(faster(push=across)).max() < 1e-6
    pulled = faster(force=20 * along)[0]
    heavy, light = cart.model.body_subtreemass[1], cart.model.body_mass[1]
    assert 10 * cart.dt / heavy < pulled < 1.3 * 10 * cart.dt / light
    assert np.abs(faster(force=20 * across)).max() < 1e-6


def test_velocities_of_a_free_base_are_mujocos():
    """Of an ant that turns: the angular one is in the body's frame."""
    model, system = brax_named.model("ant"), brax_named.bare("ant").sys
    draw, data = np.random.default_rng(0), mujoco.MjData(model)
    qpos, qd = np.array(model.qpos0), draw.normal(size=model.nv)
    qpos[3:7] = [0.8, 0.36, 0.0, 0.48]
    qpos[7:] += draw.normal(0, 0.3, model.nq - 7)
    x, xd = jax.device_get(jax.jit(lambda *of: kinematics.forward(system, *of))(qpos, qd))
    data.qpos[:], data.qvel[:] = qpos, qd
    mujoco.mj_forward(model, data)
    found = np.zeros(6)
    for body in (1, 3, 9):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body, found, 0)
        np.testing.assert_allclose(found[3:], xd.vel[body - 1], atol=1e-4)
        np.testing.assert_allclose(found[:3], xd.ang[body - 1], atol=1e-4)
        np.testing.assert_allclose(data.xpos[body], x.pos[body - 1], atol=1e-4)
    # what a film draws an arrow of: the trunk's own, in its frame
    told = task_steps._velocity(model, data, data.qpos.copy(), data.qvel.copy())
    back = rotated(qpos[3:7] * [1, -1, -1, -1], qd[:3])
    np.testing.assert_allclose(told, [*back[:2], data.qvel[5]], atol=1e-6)


def policy(config, size=0.7):
    """Networks whose actions are beyond the motors' range as often as not."""
    draw, sizes = np.random.default_rng(0), (4, 8, 1)
    layers = {
        f"Dense_{i}": {
            "kernel": size * draw.normal(size=sizes[i : i + 2]),
            "bias": 0.1 * draw.normal(size=sizes[i + 1]),
        }
        for i in range(2)
    }
    config.ppo.hidden = (8,)
    inputs = {"actor": {"count": 9.0, "mean": np.ones(4), "m2": np.full(4, 18.0)}}
    params = {"actor": {"params": layers}, "std": np.ones(1), "inputs": inputs}
    return jax.tree.map(np.float32, params)


@pytest.fixture
def saved(tmp_path):
    config = config_lib.load(ENV)
    config.ppo.normalize = True
    path = tmp_path / "policy.npz"
    policy_file.save(path, policy(config), config_lib.validate(config), None)
    return path


def test_an_onnx_file_acts_as_the_policy_in_jax(saved, tmp_path, capsys, monkeypatch):
    """The scaling of observations is in it, and the clip with which the environment takes an action."""
    runtime = pytest.importorskip("onnxruntime")

    def here(path, out):  # not in a process of its own, which the slow test below starts
        out.write_text(json.dumps(by_name.facts(ENV)))
        return 0

    monkeypatch.setattr(recorded, "facts", here)
    assert status(export.main, str(saved), f"--out={tmp_path}/p.onnx") == 0
    told = capsys.readouterr().out
    assert "obs [batch, 4]" in told and "slider" in told
    net = runtime.InferenceSession(str(tmp_path / "p.onnx"))
    obs = np.random.default_rng(1).normal(size=(50, 4)).astype(np.float32)
    other = policy_file.load_other(saved)
    assert other is not None
    static = config_lib.split(config_lib.validate(other.config))[0]
    params = policy(other.config)  # of the training, where scaling is apart
    by_jax = np.clip(networks.policy(static, params, jnp.array(obs)), -1, 1)
    found = net.run(None, {"obs": obs})[0]
    np.testing.assert_allclose(found, by_jax, atol=1e-5)
    assert 5 < (np.abs(found) == 1).sum() < 45
    about = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    assert (about["task"], about["control_dt"], about["joint_names"]) == (ENV, 0.02, ["slider"])
    assert about["squash"] == "clip" and about["brax"] and about["actuator_gear"] == [100.0]


def test_an_environment_that_cannot_be_trained_or_seen_says_why_in_one_line(tmp_path, capsys):
    """Before anything is compiled, or a folder made."""
    run = f"--workdir={tmp_path}/run"
    for given, said in (
        (["--config=brax:swimmer"], "brax:swimmer cannot be trained: brax has it on other physics"),
        ([f"--config={ENV}", "--config.ppo.symmetry=True"], "ppo.symmetry is True, expected False"),
        ([f"--config={ENV}", "--config.ppo.scale_inputs=True"], "ppo.scale_inputs is True"),
        (
            [f"--config={ENV}", "--config.physics.impl=c"],
            "physics.impl is c, expected jax for brax",
        ),
        (["--config=brax:hoper"], "there is hopper"),
    ):
        assert said in mistake(train.main, [*given, run], capsys)
    assert not (tmp_path / "run").exists()
    assert "swimmer" not in refused(names.check, "brax:")
    for make in (by_name.single, by_name.facts):
        assert refused(make, "brax:fast").startswith("brax:fast: no film, no page, no ONNX: it has")
        assert "expected playground:TASK or brax:NAME" in refused(make, "gym:Ant")
    for env in (NAME, "fast"):  # that one is not drawn, but trained
        build.check(config_lib.validate(config_lib.load(f"brax:{env}")))


def test_gears_are_those_with_which_brax_moves_it():
    """It gives a humanoid others than its file has."""
    model = brax_named.model("humanoid")
    np.testing.assert_array_equal(model.actuator_gear[:3, 0], [350, 350, 350])
    assert brax_named.bare("humanoid").sys.mj_model.actuator_gear[0, 0] == 100


@pytest.mark.slow  # a process for each command, of ten seconds and more
def test_a_policy_is_seen_from_the_command_line(saved, tmp_path, capsys):
    """Page, picture, and who pushes it live; what a process cannot draw is its one line."""
    for out in ("a.html", "a.png"):
        assert status(play.main, str(saved), f"--out={tmp_path}/{out}", "--seconds=0.5") == 0
        assert (tmp_path / out).stat().st_size > 10_000
    told = capsys.readouterr().out
    assert "brax's spring physics" in told and "command" not in told
    assert status(export.main, str(saved), f"--out={tmp_path}/a.onnx") == 0
    assert status(play.main, str(saved), f"--out={tmp_path}/b.html", "--command=1,0,0") == 2
    assert f"--command: {ENV} has no command to follow" in capsys.readouterr().err
    with task_player.playing(ENV) as player:
        data = mujoco.MjData(player.model)
        every = task_player.rows(player, data, task_player.still(player))
        next(every)
        task_player.push(player, data, [0.5, 0.5, 0.0])
        assert next(every)["velocity"][0] == pytest.approx(0.5, abs=0.1)
        assert abs(data.xpos[player.base_body][0] - data.qpos[0]) < 0.02
    assert "no MuJoCo model" in refused(task_player.start, "brax:fast")
