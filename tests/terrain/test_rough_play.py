"""A policy that sees a height scan: its file, C MuJoCo's episodes on a tile, its page, its export."""

import base64

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from answers import mistake, status

from dynappo import config as config_lib
from dynappo.config import ConfigError
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.export import deploy_yaml, joint_order, onnx_file
from dynappo.page import episode_page
from dynappo.play import command as play_command
from dynappo.policy import episode, policy_file, policy_source, render
from dynappo.terrain import height_map, map_file, scan, tiles
from dynappo.web import live as live_lib
from dynappo.web import policies

INPUTS = 48 + 187


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The file of an untrained Go2 with a scan."""
    return untrained("go2", "rough", INPUTS, tmp_path_factory.mktemp("rough"))


def untrained(name, variant, inputs, folder):
    """The file of a policy with random weights."""
    config = config_lib.load(f"configs/{name}.py:{variant}")
    config, robot = motors.fitted(config_lib.validate(config), robot_lib.load(name))
    joints = len(robot.joint_names)
    rng, sizes = np.random.default_rng(0), (inputs, 8, joints)
    layers = {
        f"Dense_{i}": dict(
            kernel=rng.normal(0, 0.1, (n, m)).astype(np.float32), bias=np.zeros(m, np.float32)
        )
        for i, (n, m) in enumerate(zip(sizes, sizes[1:], strict=False))
    }
    params = {"actor": {"params": layers}, "std": np.ones(joints, np.float32)}
    out = folder / "policy.npz"
    policy_file.save(out, params, config, robot)
    return out


def test_a_file_says_that_its_policy_sees_a_scan(written):
    policy = policy_file.load(written)
    assert policy.scan == "grid" and policy.observation == "velocity-48"
    assert policy_file.about(policy)["format"] == 5
    assert "scan" not in policy_file.about(policy._replace(scan="none"))


def test_a_policy_is_shown_the_ground_around_it_step_after_step(written):
    """On stairs, as a loop over points looks it up; with a map that is off; and without a ground, a floor."""
    policy = policy_file.load(written)
    field = policy_source.ground(policy, "pyramid_stairs:0.5")
    np.testing.assert_array_equal(
        field.heights, tiles.single(policy_source.tiles(policy), "pyramid_stairs", 0.5).heights
    )
    for ground, shift in (
        (field, (0.0, 0.0, 0.0)),
        (field, (0.1, -0.2, 0.05)),
        (None, (0.1, 0, 0)),
    ):
        player, _ = policy_source.player(policy, field=ground)
        seen, data = [], mujoco.MjData(player.model)
        act = lambda obs, seen=seen: seen.append(obs.copy()) or np.zeros(12)  # noqa: E731
        rows = episode.rows(player, data, act, lambda t: np.zeros(3), shift=shift)
        for _ in range(3):
            before = data.qpos.copy()
            next(rows)
        assert seen[-1].shape == (INPUTS,)
        x, y, z = before[:3]
        yaw = np.arctan2(
            2 * (before[4] * before[5] + before[3] * before[6]),
            1 - 2 * (before[5] ** 2 + before[6] ** 2),
        )
        expected = []
        for dx, dy in scan.points() + shift[:2]:
            at = x + np.cos(yaw) * dx - np.sin(yaw) * dy, y + np.sin(yaw) * dx + np.cos(yaw) * dy
            below = 0.0 if ground is None else float(height_map.height(*ground, *map(np.array, at)))
            expected.append(np.clip(z - below - 0.5 + shift[2], -1, 1))
        np.testing.assert_allclose(seen[-1][48:], expected, atol=1e-6)
        assert abs(seen[-1][:12]).max() < 0.5  # the reading of its joints comes first


def test_a_robot_begins_on_the_platform_and_stands_on_the_ground(written):
    policy = policy_file.load(written)
    flat, _ = policy_source.player(policy)
    for text in ("pyramid_stairs:1", "pit_stairs:1", "random:0"):
        player, _ = policy_source.player(policy, field=policy_source.ground(policy, text))
        heights = []
        for one in (flat, player):
            data = mujoco.MjData(one.model)
            episode.reset(one, data)
            heights.append(data.qpos[2])
        ground = height_map.height(*player.field, np.zeros(1), np.zeros(1))[0]
        assert heights[1] - heights[0] == pytest.approx(
            ground, abs=0.06 if "random" in text else 1e-6
        )
        played = episode.play(player, lambda obs: np.zeros(12), lambda t: np.zeros(3), 1.0)
        assert not played["fell"].any()  # it stands, it does not sink in


@pytest.mark.parametrize("text, most", [("pit_stairs:1", 1000), ("random:1", 27_000)])
def test_a_page_has_the_ground_as_heights_and_no_plane_above_it(written, text, most):
    """Without rows and columns that change nothing; of 410,881 points so many are left."""
    policy = policy_file.load(written)
    player, _ = policy_source.player(policy, field=policy_source.ground(policy, text))
    played = episode.play(player, lambda obs: np.zeros(12), lambda t: np.zeros(3), 0.1)
    shown = episode_page.scene(player, played)
    (field,) = [geom for geom in shown["geoms"] if shown["meshes"][geom.get("mesh", 0)].get("heights")
                and geom["type"] == "mesh" and geom["body"] == -1]  # fmt: skip
    mesh = shown["meshes"][field["mesh"]]
    heights = np.frombuffer(base64.b64decode(mesh["heights"]), "<i2") * mesh["unit"]
    heights = heights.reshape(len(mesh["y"]), len(mesh["x"])).T + field["pos"][2]
    ground = player.field
    x, y = (
        c + ground.cell * np.arange(n)
        for c, n in zip(ground.corner, ground.heights.shape, strict=True)
    )
    along_y = np.stack([np.interp(y, mesh["y"], line) for line in heights])
    every = np.stack([np.interp(x, mesh["x"], line) for line in along_y.T], 1)
    np.testing.assert_allclose(every, ground.heights, atol=1e-4)
    assert ground.heights.size == 410_881 and heights.size < most and shown["floor"] < heights.min()


def test_the_pages_camera_is_above_the_steepest_stairs(written):
    """Wherever the robot is on its way ahead; page.js looks from 38 degrees to its right, 4.6 radii away."""
    policy = policy_file.load(written)
    player, _ = policy_source.player(policy, field=policy_source.ground(policy, "pit_stairs:1"))
    played = episode.play(player, lambda obs: np.zeros(12), lambda t: np.zeros(3), 0.1)
    shown, x = episode_page.scene(player, played), np.linspace(0, 4, 81)
    away, up = 4.6 * shown["radius"], shown["elevation"]
    base = 0.3 + height_map.height(*player.field, x, 0 * x)
    beside = away * np.cos(up) * np.array([np.cos(-0.66), np.sin(-0.66)])
    below = height_map.height(*player.field, x + beside[0], 0 * x + beside[1])
    assert (base + away * np.sin(up) - below > 0.2).all()


def test_an_exported_network_takes_the_scan_last_in_any_order_of_joints(written):
    pytest.importorskip("onnxruntime")
    import onnxruntime

    policy, robot = policy_file.load(written), robot_lib.load("go2")
    obs = np.random.default_rng(1).normal(size=(3, INPUTS)).astype(np.float32)
    expected = policy_file.actor(policy.params, policy.activation)(obs)
    facts = onnx_file.about(policy, robot)
    last = facts["observation_table"][-1]
    assert (last["name"], last["start"], last["stop"], last["noise"]) == (
        "height_scan",
        48,
        235,
        0.1,
    )
    model = onnx_file.onnx_model(policy, facts)
    session = onnxruntime.InferenceSession(model.SerializeToString())
    found = session.run(["action"], {"obs": obs[:, onnx_file.order(policy)]})[0]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    names = policy.joint_names[::-1]
    other = joint_order.permute(policy, names)
    back = np.arange(INPUTS)
    for part in (slice(0, 12), slice(12, 24), slice(36, 48)):
        back[part] = back[part][::-1]
    turned = policy_file.actor(other.params, policy.activation)(obs[:, back])
    np.testing.assert_allclose(turned, expected[:, ::-1], atol=1e-5)
    with pytest.raises(ConfigError, match="height scan"):
        deploy_yaml.text(policy, robot)


@pytest.mark.parametrize("variant, history", [("rough", 1), ("rough_deploy", 5)])
def test_a_bipeds_network_takes_the_scan_after_its_clock(variant, history, tmp_path):
    """Which stands still for a command that is zero, as in training."""
    onnxruntime = pytest.importorskip("onnxruntime")
    reading = 98 if history > 1 else 101
    inputs = history * reading + 187
    policy = policy_file.load(untrained("g1", variant, inputs, tmp_path))
    parts = dict(onnx_file.table(policy))
    assert [*parts][-2:] == ["gait_phase", "height_scan"] and parts["height_scan"].stop == inputs
    model = onnx_file.onnx_model(policy, onnx_file.about(policy, robot_lib.load("g1")))
    session = onnxruntime.InferenceSession(model.SerializeToString())
    obs = np.random.default_rng(1).normal(size=(3, inputs)).astype(np.float32)
    act, order = policy_file.actor(policy.params, policy.activation), onnx_file.order(policy)
    found = session.run(["action"], {"obs": obs[:, order]})[0]
    np.testing.assert_allclose(found, act(obs), atol=1e-5)
    still = obs[:, order]
    still[:, parts["command"]] = 0
    found = session.run(["action"], {"obs": still})[0]
    still[:, parts["gait_phase"]] = 0
    np.testing.assert_allclose(found, act(still[:, np.argsort(order)]), atol=1e-5)


def test_play_puts_a_robot_on_a_tile(written, tmp_path, capsys):
    out = tmp_path / "stairs.html"
    play = [str(written), "--seconds=0.2", f"--out={out}", "--command=0,0,0"]
    assert status(play_command.main, *play, "--ground=boxes:0.2") == 0 and out.stat().st_size > 5e4
    assert ", on boxes:0.2; " in capsys.readouterr().out
    for text in ("lava", "boxes", "boxes:"):
        said = mistake(play_command.main, [*play, f"--ground={text}"], capsys)
        assert f"--ground={text}: expected a kind and its difficulty" in said
        assert "pit_stairs" in said
    np.save(tmp_path / "small.npy", np.zeros((20, 300)))  # no tile of 8 m fits: it would fall off
    said = mistake(play_command.main, [*play, f"--ground={tmp_path / 'small.npy'}"], capsys)
    assert "--ground: task.tiles.size is 8, expected at most 0.95: " in said
    assert "0.95 x 14.95 m" in said
    flat = tmp_path / "flat.html"
    play[2] = f"--out={flat}"
    assert status(play_command.main, *play, "--ground=floor") == 0
    assert '"heights"' in out.read_text() and '"heights"' not in flat.read_text()
    assert ", on " not in capsys.readouterr().out
    # as in the training, unless the robot is from another file
    play[2] = f"--out={tmp_path / 'own.html'}"
    assert status(play_command.main, *play) == 0
    assert '"heights"' in (tmp_path / "own.html").read_text()
    assert ", on pit_stairs:0.3; " in capsys.readouterr().out
    xml = f"--robot-xml={robot_lib.load('go2').xml}"
    assert status(play_command.main, *play, xml) == 0
    assert '"heights"' not in (tmp_path / "own.html").read_text()
    assert "note: trained on rough ground, here it is on the floor of " in capsys.readouterr().out
    for ground in ("lava", "none.png"):  # before a server starts
        serve = [str(written), "--serve", f"--ground={ground}", "--seconds=0.1"]
        said = mistake(play_command.main, serve, capsys)
        assert f"--ground={ground}" in said or f"--ground: {ground}" in said


def test_on_the_live_page_it_sees_and_walks_as_in_an_episode(written):
    """The same commands on the same stairs give the same states, bit for bit."""
    policy = policy_file.load(written)
    act = policy_file.actor(policy.params, policy.activation)
    field, _ = policies.ground(policy, "pyramid_stairs:1")
    player, _ = policy_source.player(policy, field=field)
    live = live_lib.Live(player, act, lambda t: np.array([0.5, 0.0, 0.0]))
    for _ in range(30):
        live_lib.step(live)
    whole, _ = policy_source.player(policy, field=policy_source.ground(policy, "pyramid_stairs:1"))
    expected = episode.play(whole, act, live.given, 31 * 0.02)
    np.testing.assert_array_equal(live.row["qpos"], expected["qpos"][-1])


def test_the_live_page_takes_the_ground_of_the_training(written, tmp_path):
    policy = policy_file.load(written)
    field, on = policies.ground(policy, None)
    kind, hard = render.FILMED
    expected = tiles.single(policy_source.tiles(policy), kind, hard)
    np.testing.assert_array_equal(field.heights, expected.heights)
    assert on == f", on {kind}:{hard}"
    assert policies.ground(policy, "floor") == (None, "")
    np.save(tmp_path / "own.npy", np.linspace(0, 1, 900).reshape(30, 30))
    task = policy.config["task"]
    file = str(tmp_path / "own.npy")
    own = task["tiles"] | {"map": file, "map_hash": map_file.digest(file)}
    mine = policy._replace(config=policy.config | {"task": task | {"tiles": own}})
    field, on = policies.ground(mine, None)
    assert field.heights.shape == (30, 30)
    assert on == ", on own.npy (1.45 x 1.45 m, cells of 0.05 m)"
    assert policies.ground(mine, "boxes:1")[1] == ", on boxes:1"
    flat = policy._replace(config=policy.config | {"task": task | {"terrain": "flat"}})
    assert policies.ground(flat, None) == (None, "")
    (tmp_path / "own.npy").unlink()
    with pytest.raises(ConfigError, match="own.npy cannot be read .*; --ground=floor takes"):
        policies.ground(mine, None)


def test_jax_and_numpy_see_the_same(written):
    """`scan.scan` and `height_map.height` of both."""
    field = policy_source.ground(policy_file.load(written), "boxes:1")
    pose = np.array([0.7, -1.2, 0.4, 0.8])
    found = [
        scan.scan(lambda x, y: height_map.height(*field, x, y), xp.asarray(pose), xp.zeros(3))
        for xp in (np, jnp)
    ]
    off = abs(np.asarray(found[0]) - np.asarray(jax.device_get(found[1])))
    assert off.max() < 1e-4
