"""Export: the ONNX network against JAX and NumPy, joint orders, metadata, walking, every mistake."""

import json
import re
import shlex
import sys
import time
import types
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import onnx
import onnxruntime
import pytest
from test_console import ROOT, shell

from dynappo import config as config_lib
from dynappo.config import ConfigError, versions
from dynappo.export import command as export_command
from dynappo.export import joint_order
from dynappo.learner import networks
from dynappo.physics import actuators
from dynappo.physics import robot as robot_lib
from dynappo.play import command as play_command
from dynappo.policy import episode, policy_file
from dynappo.task import observe

ROBOTS = ("go1", "go2", "anymal_c", "anymal_d")
PAGE = (ROOT / "robots" / "DEPLOY.md").read_text()
AHEAD = np.array([0.6, 0.0, 0.0])  # m/s, m/s, rad/s
LEGS = "{0}_hip_joint {0}_thigh_joint {0}_calf_joint"
# unitree_sdk2, dds_wrapper/robots/go2/defines.h: FR_Hip = 0 ... RL_Calf = 11
MOTORS = tuple(" ".join(LEGS.format(leg) for leg in ("FR", "FL", "RR", "RL")).split())
# unitree_rl_lab's deploy.yaml of a Go2 trained in Isaac Lab, `joint_ids_map`
GO2_IN_ISAACLAB = tuple(MOTORS[i] for i in (3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8))
# isaac-sim/IsaacLab, .../velocity/mdp/symmetry/anymal.py
ANYMAL_IN_ISAACLAB = tuple(
    "LF_HAA LH_HAA RF_HAA RH_HAA LF_HFE LH_HFE RF_HFE RH_HFE LF_KFE LH_KFE RF_KFE RH_KFE".split()
)
SHUFFLED = tuple(np.random.default_rng(5).permutation(MOTORS).tolist())


def described(name, settings, activation="elu", hidden=(32, 24), seed=0):
    """`(policy, robot, static)`: of a bundled robot's config, with random networks."""
    changes = {"ppo.activation": activation, "ppo.hidden": hidden}
    static, hyper = settings(changes, f"configs/{name}.py:dyna4")
    config = config_lib.load(f"configs/{name}.py:dyna4")
    for field, value in changes.items():
        config.ppo[field.partition(".")[2]] = value
    robot = robot_lib.load(name)
    policy = policy_file.describe(config_lib.validate(config), robot, parameters(hidden, seed))
    # as if each joint had its own, so that a wrong order shows
    return policy._replace(joint_damping=tuple(range(12))), robot, static


def parameters(hidden, seed):
    """Of an actor and a critic with layers of these sizes, with the names of `networks.init_policy`."""
    rng = np.random.default_rng(seed)

    def network(outputs):
        sizes = (48, *hidden, outputs)
        layers = {
            f"Dense_{i}": {
                "kernel": rng.normal(size=pair).astype(np.float32) / np.float32(pair[0] ** 0.5),
                "bias": 0.3 * rng.normal(size=pair[1]).astype(np.float32),
            }
            for i, pair in enumerate(zip(sizes[:-1], sizes[1:], strict=True))
        }
        return {"params": layers}

    std = np.linspace(0.2, 0.9, 12, dtype=np.float32)
    params: dict[str, Any] = {"actor": network(12), "critic": network(1), "std": std}
    return params


def session(policy, robot, targets=False):
    """The exported network in ONNX Runtime, as a file would be read."""
    model = export_command.onnx_model(policy, export_command.about(policy, robot), targets)
    return onnxruntime.InferenceSession(model.SerializeToString())


def infer(net, obs, output="action"):
    """One output for observations [B, 48]."""
    return net.run([output], {"obs": np.asarray(obs, np.float32)})[0]


def observations(names, batch=64, seed=1):
    """Observations `[B, 48]` of the same situations, joints in the order `names`."""
    rng = np.random.default_rng(seed)
    parts = {name: rng.normal(size=(batch, 3)) for name in sorted(names)}  # q, qd, previous action
    stacked = np.stack([parts[name] for name in names])  # [12, B, 3]
    q, qd, action = (stacked[..., i].T for i in range(3))
    body = rng.normal(size=(batch, 12))  # gravity, velocities, command
    return np.concatenate([q, 5 * qd, body, action], axis=1).astype(np.float32)


@pytest.fixture(scope="module")
def bundled():
    """The policy that comes with the Go1."""
    return policy_file.find("go1")[0]


@pytest.fixture
def small(tmp_path, settings):
    """The policy.npz of fresh networks of a Go2, and its policy and robot."""
    policy, robot, _ = described("go2", settings)
    path = tmp_path / "small" / "policy.npz"
    path.parent.mkdir()
    export_command.save(policy, robot, path)
    return path, policy, robot


# ---- the network


@pytest.mark.parametrize("activation", list(policy_file.ACTIVATIONS))
def test_onnx_gives_the_actions_of_jax(settings, activation):
    """To 1e-5, for a batch and for one, with and without the targets; the NumPy actor agrees."""
    policy, robot, static = described("go1", settings, activation, (128, 128, 128))
    obs = 3 * observations(policy.joint_names)
    expected = np.asarray(networks.policy(static.ppo, policy.params, jnp.asarray(obs)))
    assert np.abs(expected).max() > 0.3
    net, wider = session(policy, robot), session(policy, robot, targets=True)
    np.testing.assert_allclose(infer(net, obs), expected, atol=1e-5)
    np.testing.assert_allclose(infer(wider, obs), expected, atol=1e-5)
    np.testing.assert_allclose(infer(net, obs[:1]), expected[:1], atol=1e-5)
    np.testing.assert_allclose(
        policy_file.actor(policy.params, activation)(obs), expected, atol=1e-5
    )
    targets = actuators.target(expected, policy.default_pose, policy.action_scale)
    np.testing.assert_allclose(infer(wider, obs, "targets"), targets, atol=1e-5)
    assert [o.name for o in net.get_outputs()] == ["action"]


@pytest.mark.parametrize("hidden", [(8,), (16, 8, 4, 6)])
def test_any_number_of_layers(settings, hidden):
    policy, robot, _ = described("go1", settings, "elu", hidden)
    obs = observations(policy.joint_names)
    expected = policy_file.actor(policy.params, "elu")(obs)
    np.testing.assert_allclose(infer(session(policy, robot), obs), expected, atol=1e-5)


def test_the_file_is_plain_onnx_that_old_runtimes_read(settings):
    """Checked in full; opset 17 at most, float32, a free batch, and no operator newer than opset 14."""
    for activation in policy_file.ACTIVATIONS:
        policy, robot, _ = described("go1", settings, activation)
        model = export_command.onnx_model(policy, export_command.about(policy, robot), targets=True)
        onnx.checker.check_model(model, full_check=True)
        assert model.ir_version <= 8 and [o.domain for o in model.opset_import] == [""]
        assert model.opset_import[0].version <= 17
        since = [onnx.defs.get_schema(n.op_type, 17).since_version for n in model.graph.node]
        assert max(since) <= 14
        for value, size in zip(
            [*model.graph.input, *model.graph.output], (48, 12, 12), strict=True
        ):
            batch, width = value.type.tensor_type.shape.dim
            assert (batch.dim_param, width.dim_value) == ("batch", size) and value.doc_string
            assert value.type.tensor_type.elem_type == onnx.TensorProto.FLOAT
        assert "0-11 joint_position (rad)" in model.graph.input[0].doc_string


# ---- joint orders


def order_of(text, name):
    """The names that `--joint-order=TEXT` means for a robot's policy in MJCF order."""
    robot = robot_lib.load(name)
    return joint_order.find(text, robot.joint_names, robot)[0]


def test_named_orders_are_those_of_their_sources():
    assert order_of("unitree", "go1") == order_of("unitree", "go2") == MOTORS
    assert order_of("isaaclab", "go1") == order_of("isaaclab", "go2") == GO2_IN_ISAACLAB
    for name in ("anymal_c", "anymal_d"):
        assert order_of("isaaclab", name) == ANYMAL_IN_ISAACLAB
    for name in ROBOTS:
        assert order_of(None, name) == order_of("mjcf", name) == robot_lib.load(name).joint_names
    assert order_of(", ".join(SHUFFLED), "go1") == SHUFFLED


@pytest.mark.parametrize(
    ("name", "names"),
    [
        ("go1", MOTORS),
        ("go2", GO2_IN_ISAACLAB),
        ("anymal_c", ANYMAL_IN_ISAACLAB),
        ("go1", SHUFFLED),
    ],
)
def test_another_order_is_the_same_policy(settings, name, names):
    """Observations of the same situations, joints reordered by name, give the reordered actions."""
    policy, robot, static = described(name, settings)
    other = joint_order.permute(policy, names)
    there = [policy.joint_names.index(joint) for joint in names]
    assert there != list(range(12))
    obs, reordered = observations(policy.joint_names), observations(names)
    expected = infer(session(policy, robot), obs)
    net = session(other, robot, targets=True)
    np.testing.assert_allclose(infer(net, reordered), expected[:, there], atol=1e-6)
    targets = actuators.target(expected, policy.default_pose, policy.action_scale)
    np.testing.assert_allclose(infer(net, reordered, "targets"), targets[:, there], atol=1e-6)
    one, same = (
        networks.value(static.ppo, p.params, jnp.asarray(x))
        for p, x in ((policy, obs), (other, reordered))
    )
    np.testing.assert_allclose(one, same, atol=1e-5)
    np.testing.assert_array_equal(other.params["std"], policy.params["std"][there])
    assert other.joint_names == names
    for field in ("default_pose", "joint_damping", "joint_friction"):
        by_name = [
            dict(zip(p.joint_names, getattr(p, field), strict=True)) for p in (policy, other)
        ]
        assert by_name[0] == by_name[1], field
    back = joint_order.permute(other, policy.joint_names)
    jax.tree.map(np.testing.assert_array_equal, back.params, policy.params)


def test_permuting_leaves_the_policy_that_was_given_alone(settings):
    policy, _, _ = described("go1", settings)
    before = jax.tree.map(np.copy, policy.params)
    joint_order.permute(policy, MOTORS)
    jax.tree.map(np.testing.assert_array_equal, policy.params, before)
    assert policy.joint_names == robot_lib.load("go1").joint_names


# ---- what is beside the network


@pytest.mark.parametrize("name", ROBOTS)
def test_metadata_hold_all_that_a_robot_needs(settings, name):
    """Each value against the config and the compiled MJCF, as JSON that ONNX Runtime gives back."""
    policy, robot, _ = described(name, settings)
    names = order_of("isaaclab", name)
    net = session(joint_order.permute(policy, names), robot)
    facts = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    config = config_lib.validate(config_lib.load(f"configs/{name}.py:dyna4"))
    model = mujoco.MjModel.from_xml_path(str(robot.xml))
    home = model.key("home").qpos
    assert set(facts) == {*policy_file.Policy._fields, *export_command.UNITS} - {"params"} | {
        "observation_table",
        "units",
        "dynappo",
        "licence",
    }
    assert facts["robot"] == name and facts["joint_names"] == list(names)
    for joint, pose, limits in zip(names, facts["default_pose"], facts["joint_range"], strict=True):
        assert pose == home[model.joint(joint).qposadr[0]], joint
        assert limits == model.joint(joint).range.tolist(), joint
    assert facts["joint_damping"] == [policy.joint_names.index(joint) for joint in names]
    assert facts["joint_friction"] == [0.0] * 12
    for field in policy_file.TASK:
        value = config.task[field]
        assert facts[field] == (list(value) if isinstance(value, tuple) else value), field
    assert facts["timestep"] * facts["substeps"] == facts["control_dt"] == 0.02
    assert facts["control_rate"] == pytest.approx(50)
    assert facts["base_com"] == model.body(1).ipos.tolist()
    assert facts["activation"] == "elu" and facts["observation"] == "velocity-48"
    assert facts["config"]["task"] == json.loads(config_lib.to_json(config))["task"]
    assert facts["dynappo"] == versions.of("dynappo") and "Apache-2.0" in facts["licence"]
    assert net.get_modelmeta().producer_name == "dynappo"
    assert name in net.get_modelmeta().description
    numbers = {k for k, v in facts.items() if isinstance(v, float)}
    assert numbers <= set(facts["units"]) <= set(facts)


def test_the_observation_table_is_that_of_observe(settings):
    """Every number once, in order; each part and its noise where `observe` puts them."""
    policy, robot, _ = described("anymal_d", settings)
    rows = export_command.about(policy, robot)["observation_table"]
    assert [row["start"] for row in rows] == [0, *(row["stop"] for row in rows[:-1])]
    assert rows[-1]["stop"] == 48
    noise = np.concatenate([[row["noise"]] * (row["stop"] - row["start"]) for row in rows])
    group = config_lib.load("configs/anymal_d.py").task.noise
    np.testing.assert_array_equal(noise, observe.noise_scale(group, np))

    # one quantity at a time, through `observe` itself
    data = dict(q=np.zeros(12), qd=np.zeros(12), v=np.zeros(3), w=np.zeros(3), c=np.zeros(3))
    data |= dict(a=np.zeros(12))
    names = dict(q="joint_position", qd="joint_velocity", v="linear_velocity")
    names |= dict(w="angular_velocity", c="command", a="previous_action")

    def vector(q, qd, v, w, c, a):
        qpos = np.concatenate([[0, 0, 0.5, 1, 0, 0, 0], q])
        return observe.observe(qpos, np.concatenate([v, w, qd]), np.zeros(3), np.zeros(12), c, a)

    rest = vector(**data)
    for key, name in names.items():
        (row,) = [row for row in rows if row["name"] == name]
        changed = vector(**data | {key: np.ones_like(data[key])}) - rest
        np.testing.assert_array_equal(
            np.flatnonzero(changed), np.arange(row["start"], row["stop"]), name
        )
    (row,) = [row for row in rows if row["name"] == "gravity"]
    np.testing.assert_array_equal(rest[row["start"] : row["stop"]], [0, 0, -1])


def test_the_page_for_robots_says_the_same():
    """The tables of robots/DEPLOY.md: indices, units, noise; gains, limits and scales of the configs."""
    rows = [line.split(" | ") for line in PAGE.splitlines() if re.match(r"\| \d+-\d+ \|", line)]
    noise = config_lib.load("configs/go1.py").task.noise
    for cells, (_, part, unit, _, field) in zip(rows, export_command.TABLE, strict=True):
        assert cells[0] == f"| {part.start}-{part.stop - 1}" and cells[2] == unit
        assert cells[4] == (f"+-{noise[field]:g}" if field else "none")
    for column, robots in ((1, ["go1"]), (2, ["go2"]), (3, ["anymal_c", "anymal_d"])):
        for name in robots:
            task = config_lib.load(f"configs/{name}.py:dyna4").task
            cell = {
                line.split(" | ")[0].strip("| "): line.strip("| ").split(" | ")[column]
                for line in PAGE.splitlines()
                if line.startswith(("| `kp`", "| `effort", "| `action_scale`"))
            }
            gains, limits, scale = cell.values()
            assert gains.split(", and")[0] == f"{task.kp:g}, {task.kd:g}"
            assert limits == f"{task.effort_limit:g}, {task.velocity_limit:g}"
            assert scale == f"{task.action_scale:g}"


def test_an_npz_in_another_order_is_a_policy_file(small, tmp_path, capsys):
    """It says its order, and moves the robot as the first did, in its own file and by the same loader."""
    path, policy, _ = small
    out = tmp_path / "other.npz"
    export_command.main([str(path), f"--out={out}", "--joint-order=isaaclab"])
    other = policy_file.load(out)
    assert other.joint_names == GO2_IN_ISAACLAB
    joints = {"joint_names", "default_pose", "joint_damping", "joint_friction"}
    for field in set(policy._fields) - joints - {"params", "config"}:
        assert np.array_equal(getattr(other, field), getattr(policy, field)), field
    assert json.dumps(other.config) == json.dumps(policy.config)
    walks = []
    for p in (policy, other):
        body = play_command.body_of(p, None)
        act = policy_file.actor(p.params, p.activation)
        walks.append(episode.play(body, act, lambda t: AHEAD, 0.4)["qpos"])
    assert np.abs(walks[0] - walks[0][0]).max() > 0.05
    np.testing.assert_allclose(*walks, atol=1e-4)
    export_command.main([str(out), f"--out={tmp_path}/back.npz", "--joint-order=mjcf"])
    back = policy_file.load(tmp_path / "back.npz")
    jax.tree.map(np.testing.assert_array_equal, back.params, policy.params)


# ---- walking


@pytest.mark.parametrize("order", ["mjcf", "isaaclab"])
def test_the_onnx_file_walks_for_ten_seconds_in_c_mujoco(bundled, order, tmp_path):
    """0.6 m/s ahead: no fall, the distance that was asked for, close to the command."""
    out = tmp_path / "policy.onnx"
    export_command.main(["go1", f"--out={out}", f"--joint-order={order}"])
    net = onnxruntime.InferenceSession(out)
    facts = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    # the body is read and driven in the order that the file says
    policy = joint_order.permute(bundled, tuple(facts["joint_names"]))
    body = play_command.body_of(policy, None)
    walked = episode.play(body, lambda obs: infer(net, obs[None])[0], lambda t: AHEAD, 10.0)
    m = episode.measures(body, walked)
    assert m["fall"] is None and m["seconds"] == 10.0
    assert walked["qpos"][-1, 0] > 5.0  # m ahead, of 6
    assert m["tracking_error"] is not None and m["tracking_error"] < 0.15  # m/s


@pytest.fixture
def loop(bundled, tmp_path, monkeypatch):
    """`loop(steps, broken)`: the code of robots/DEPLOY.md as it stands there, with C MuJoCo for a robot.

    The button is pressed after `steps`; before, `broken(step)` is called. Returns where the base was
    [steps, 3], whether the robot fell, and how often it was told to damp.
    """
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    assert len(code.splitlines()) <= 40
    export_command.main(["go1", f"--out={tmp_path}/policy.onnx", "--joint-order=unitree"])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    policy = joint_order.permute(bundled, MOTORS)
    body = play_command.body_of(policy, None)

    def run(steps, broken=lambda step: None):
        data = mujoco.MjData(body.model)
        episode.reset(body, data)
        path, fell, damped = [], [], []

        def read():
            qpos, qvel = episode.coordinates(body, data)
            com = body.model.body_ipos[body.base_body]
            _, velocity, gyro = observe.base_motion(qpos, qvel, com)
            return types.SimpleNamespace(
                q=qpos[7:], qd=qvel[6:], quat=qpos[3:7], gyro=gyro, velocity=velocity
            )

        def send(target, kp, kd):
            assert (kp, kd) == (policy.kp, policy.kd) and not damped
            torque = actuators.pd(target, data.qpos[body.joint_q], data.qvel[body.joint_v], kp, kd)
            assert np.abs(torque).max() <= policy.effort_limit + 1e-9
            broken(len(path))
            action = (target - policy.default_pose) / policy.action_scale
            fell.append(episode.step(body, data, action)[1])
            path.append(data.qpos[:3].copy())

        robot = types.ModuleType("my_robot")
        robot.__dict__.update(
            read=read,
            send=send,
            stick=lambda: AHEAD,
            stop=lambda: len(path) >= steps,
            damp=lambda: damped.append(True),
        )
        monkeypatch.setitem(sys.modules, "my_robot", robot)
        try:
            exec(code, {})
        except InterruptedError:
            damped.append(False)
        return np.array(path), any(fell), damped

    return run


def test_the_loop_for_robots_walks_in_c_mujoco(loop):
    """It ramps in for 3 s, walks ahead for 10 s, and damps when the button is pressed."""
    path, fell, damped = loop(650)
    assert len(path) == 650 and not fell and damped == [True]
    assert np.abs(path[149][:2]).max() < 0.05  # m: it stands where it was
    assert path[-1][0] > 5.0


def test_the_loop_for_robots_damps_whatever_happens(loop):
    """An error of the SDK in the middle of a step: damped, then raised."""

    def broken(step):
        if step == 20:
            raise InterruptedError("no answer")

    path, _, damped = loop(30, broken)
    assert len(path) == 20 and damped == [True, False]


# ---- the command


def run(*arguments):
    """The exit status of the command."""
    try:
        export_command.main(list(arguments))
    except SystemExit as stop:
        return stop.code
    return 0


def test_the_command_tells_what_it_wrote_and_the_line_to_try_works(
    small, tmp_path, monkeypatch, capsys
):
    path, _, _ = small
    monkeypatch.chdir(tmp_path)
    assert run(str(path), "--out=policy.onnx", "--joint-order=unitree", "--targets") == 0
    first, *lines = capsys.readouterr().out.splitlines()
    assert first == "dynappo exports go2: small/policy.npz"
    told = {line[:12].strip(): line[12:] for line in lines}
    assert list(told) == ["written", "input", "output", "joints", "try", "on a robot"]
    kib = Path("policy.onnx").stat().st_size / 1024
    assert told["written"] == f"policy.onnx ({kib:.0f} KiB, ONNX, float32, opset 17)"
    assert told["input"].startswith("obs [batch, 48]")
    assert told["output"] == "action [batch, 12], targets [batch, 12] (rad)"
    assert told["joints"] == f"{' '.join(MOTORS)} (unitree)"
    assert (ROOT / told["on a robot"]).is_file()
    program, *arguments = shlex.split(told["try"])
    assert program == "python"
    done = shell(*arguments, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("array(") == 2
    assert sorted(p.name for p in tmp_path.iterdir()) == ["policy.onnx", "small"]


def test_the_same_policy_gives_the_same_bytes(small, tmp_path):
    path, _, _ = small
    for name in ("one.onnx", "two.onnx"):
        assert run(str(path), f"--out={tmp_path / name}") == 0
    assert (tmp_path / "one.onnx").read_bytes() == (tmp_path / "two.onnx").read_bytes()


def test_the_targets_of_a_run_of_before_can_be_exported(small, tmp_path):
    """A workdir whose config has no noise: exported, and the noise is said to be unknown."""
    _, policy, robot = small
    config = json.loads(json.dumps(policy.config))
    del config["task"]["noise"]
    rows = export_command.observation_table(policy._replace(config=config))
    assert [row["noise"] for row in rows] == [None] * 5 + [0.0] * 2
    session(policy._replace(config=config), robot)


MISTAKES = {
    "nothing": ([], "nothing to export is named; try a workdir"),
    "unknown": (["wlk", "--out=a.onnx"], "wlk: no such file or folder; expected a workdir"),
    "two names": (["small", "go2", "--out=a.onnx"], "go2: no such flag"),
    "unknown flag": (["small", "--out=a.onnx", "--opset=9"], "--opset=9: no such flag"),
    "abbreviated": (["small", "--out=a.onnx", "--joint=mjcf"], "--joint=mjcf: no such flag"),
    "value missing": (["small", "--out", "--targets"], "--out: expected one argument"),
    "no out": (["small"], "--out is missing; try --out=policy.onnx"),
    "suffix": (["small", "--out=a.pt"], "--out=a.pt: expected a file named .onnx or .npz"),
    "no suffix": (["small", "--out=a"], "--out=a: expected a file named .onnx or .npz"),
    "targets": (["small", "--out=a.npz", "--targets"], "--targets: only an .onnx has outputs"),
    "no folder": (["small", "--out=no/a.onnx"], "--out=no/a.onnx: cannot write there (No such"),
    "a folder": (["small", "--out=taken.npz"], "--out=taken.npz: cannot write there (Is a dir"),
    "itself": (["small", "--out=small/policy.npz"], "--out=small/policy.npz: is the policy itself"),
    "joints": (
        ["small", "--out=a.onnx", "--joint-order=x,FL_hip_joint"],
        "go2 has no joint x; exp",
    ),
    "no order": (
        ["small", "--out=a.onnx", "--joint-order="],
        "expected mjcf, isaaclab, unitree or",
    ),
    "few joints": (
        ["small", "--out=a.onnx", f"--joint-order={','.join(MOTORS[:11])}"],
        "lacks RL_calf_joint",
    ),
    "joint twice": (
        ["small", "--out=a.onnx", f"--joint-order={','.join(MOTORS + MOTORS[:1])}"],
        "FR_hip_joint is there more than once",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_one_line_and_status_2(small, tmp_path, monkeypatch, capsys, name):
    """Nothing is written, nothing printed but the line, which names the flag."""
    arguments, expected = MISTAKES[name]
    monkeypatch.chdir(tmp_path)
    Path("taken.npz").mkdir()
    before = small[0].read_bytes()
    assert run(*arguments) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert said.err.startswith("dynappo: ") and expected in said.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["small", "taken.npz"]
    assert small[0].read_bytes() == before and len(list(Path("small").iterdir())) == 1


def test_without_onnx_the_line_says_what_to_install(small, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "onnx", None)
    assert run(str(small[0]), f"--out={tmp_path}/a.onnx") == 2
    said = capsys.readouterr().err
    assert "onnx is not installed; pip install 'dynappo[export]'" in said and said.count("\n") == 1
    assert run(str(small[0]), f"--out={tmp_path}/a.npz") == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "small"]


def test_a_disk_that_is_full_is_one_line(small, tmp_path, monkeypatch, capsys):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", full)
    for name in ("a.onnx", "a.npz"):
        assert run(str(small[0]), f"--out={tmp_path / name}") == 2
        assert f"{name}: cannot be written (No space left" in capsys.readouterr().err
        assert not (tmp_path / name).exists()


def test_a_policy_of_other_joints_than_its_robot_is_refused(settings, tmp_path, capsys):
    """ANYmal's joints under the name of a Go1."""
    policy, robot, _ = described("anymal_c", settings)
    path = tmp_path / "policy.npz"
    export_command.save(policy._replace(robot="go1"), robot, path)
    assert run(str(path), f"--out={tmp_path}/a.onnx") == 2
    assert "its joints are LF_HAA" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="anymal_c has the legs LF RF LH RH"):
        joint_order.find("unitree", robot.joint_names, robot)


def test_export_needs_neither_jax_nor_torch(small, tmp_path):
    path, _, _ = small
    code = (
        f"import sys; from dynappo import export; "
        f"export.main([{str(path)!r}, '--out={tmp_path}/a.onnx']); "
        "print(sorted({'jax', 'flax', 'orbax', 'torch', 'onnxruntime'} & set(sys.modules)))"
    )
    done = shell("-c", code)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == "[]"


def test_help_explains_the_joint_orders(capsys):
    assert run("--help") == 0
    text = capsys.readouterr().out
    for word in ("--joint-order", "isaaclab", "unitree", "FR FL RR RL", "policy.npz", "DEPLOY.md"):
        assert word in text
