"""The ONNX network: the actions of JAX, plain operators, and all that a robot needs beside it."""

import json

import jax.numpy as jnp
import mujoco
import numpy as np
import onnx
import pytest
from answers import refused
from toy_onnx import described, infer, observations, onnx_file, session
from toy_policy import ROBOTS

from dynappo import config as config_lib
from dynappo.config import versions
from dynappo.export import joint_order
from dynappo.learner import networks
from dynappo.physics import actuators
from dynappo.policy import policy_file
from dynappo.tasks.velocity import observe


@pytest.mark.parametrize("activation", list(policy_file.ACTIVATIONS))
def test_onnx_gives_the_actions_of_jax(activation):
    """To 1e-5, for a batch and for one, with and without the targets; the NumPy actor agrees."""
    policy, robot, static = described("go1", activation, (128, 128, 128))
    obs = 3 * observations(policy.joint_names)
    obs[-1] *= 1e4  # beyond the limit of the mean
    expected = np.asarray(networks.policy(static, policy.params, jnp.asarray(obs)))
    assert np.abs(expected[:-1]).max() > 0.3
    assert activation == "tanh" or np.abs(expected[-1]).max() == policy_file.MAX_MEAN
    net, wider = session(policy, robot), session(policy, robot, targets=True)
    actor = policy_file.actor(policy.params, activation)
    for found in (infer(net, obs), infer(wider, obs), actor(obs)):
        np.testing.assert_allclose(found, expected, atol=1e-5)
    np.testing.assert_allclose(infer(net, obs[:1]), expected[:1], atol=1e-5)
    targets = actuators.target(expected, policy.default_pose, policy.action_scale)
    np.testing.assert_allclose(infer(wider, obs, "targets"), targets, atol=1e-5)
    assert [o.name for o in net.get_outputs()] == ["action"]


@pytest.mark.parametrize("hidden", [(8,), (16, 8, 4, 6)])
def test_any_number_of_layers(hidden):
    policy, robot, _ = described("go1", "elu", hidden)
    obs = observations(policy.joint_names)
    expected = policy_file.actor(policy.params, "elu")(obs)
    np.testing.assert_allclose(infer(session(policy, robot), obs), expected, atol=1e-5)


def test_the_file_is_plain_onnx_that_old_runtimes_read():
    """Checked in full; opset 17 at most, float32, a free batch, and no operator newer than opset 14."""
    for activation in policy_file.ACTIVATIONS:
        policy, robot, _ = described("go1", activation)
        model = onnx_file.onnx_model(policy, onnx_file.about(policy, robot), targets=True)
        onnx.checker.check_model(model, full_check=True)
        assert model.ir_version <= 8 and [o.domain for o in model.opset_import] == [""]
        assert model.opset_import[0].version <= 17
        since = [onnx.defs.get_schema(n.op_type, 17).since_version for n in model.graph.node]
        assert max(since) <= 14
        values = [*model.graph.input, *model.graph.output]
        for value, size in zip(values, (48, 12, 12), strict=True):
            batch, width = value.type.tensor_type.shape.dim
            assert (batch.dim_param, width.dim_value) == ("batch", size) and value.doc_string
            assert value.type.tensor_type.elem_type == onnx.TensorProto.FLOAT
        assert "0-11 joint_position (rad)" in model.graph.input[0].doc_string


def test_the_same_policy_gives_the_same_bytes_in_one_whole_file(tmp_path):
    policy, robot, _ = described("go2")
    for name in ("one.onnx", "two.onnx"):
        onnx_file.save(policy, robot, tmp_path / name)
    assert (tmp_path / "one.onnx").read_bytes() == (tmp_path / "two.onnx").read_bytes()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.onnx", "two.onnx"]


WRONG = {  # what is put into a policy, what the line must say of an ONNX file, and of an npz
    "kp": (lambda p: p._replace(kp=np.nan), "description of the policy is not finite", True),
    "a pose": (lambda p: p._replace(default_pose=p.default_pose + np.inf), "is not finite", True),
    "the config": (lambda p: p._replace(config={"task": {"x": -np.inf}}), "is not finite", True),
    "a weight": (lambda p: with_weight(p, np.nan), "is not finite", True),
    "a weight beyond float32": (lambda p: with_weight(p, 1e300), "not finite in float32", False),
}


def with_weight(policy, value):
    """The policy with one weight of its actor in float64."""
    layers = policy.params["actor"]["params"]
    kernel = layers["Dense_0"]["kernel"].astype(np.float64)
    kernel[3, 4] = value
    layers = layers | {"Dense_0": layers["Dense_0"] | {"kernel": kernel}}
    return policy._replace(params=policy.params | {"actor": {"params": layers}})


@pytest.mark.parametrize("name", WRONG)
def test_nothing_that_is_not_finite_is_written(tmp_path, name):
    """Whatever came so far; no file is left. float64, as an npz may hold it, can be finite there alone."""
    change, expected, both = WRONG[name]
    policy, robot, _ = described("go1")
    for file in ("a.onnx", "a.npz") if both else ("a.onnx",):
        assert expected in refused(onnx_file.save, change(policy), robot, tmp_path / file)
    assert not list(tmp_path.iterdir())


# ---- what is beside the network


@pytest.mark.parametrize("name", ROBOTS)
def test_metadata_hold_all_that_a_robot_needs(name):
    """Each value against the config and the compiled MJCF, as JSON that ONNX Runtime gives back."""
    policy, robot, _ = described(name)
    names, _ = joint_order.parse("isaaclab", robot.joint_names, robot)
    net = session(joint_order.permute(policy, names), robot)
    facts = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    config = config_lib.load(f"configs/{name}.py:dyna4")
    model = mujoco.MjModel.from_xml_path(str(robot.xml))
    home = model.key("home").qpos
    beside = {"observation_table", "history_order", "units", "dynappo", "licence"}
    of_a_run = {"seed", *policy_file.TRAINED}
    fields = {*policy_file.Policy._fields, *onnx_file.UNITS} - {"params", "mjcf", *of_a_run}
    assert set(facts) == fields | beside
    assert facts["robot"] == name and facts["joint_names"] == list(names)
    for joint, pose, limits in zip(names, facts["default_pose"], facts["joint_range"], strict=True):
        assert pose == home[model.joint(joint).qposadr[0]], joint
        assert limits == model.joint(joint).range.tolist(), joint
    assert facts["joint_damping"] == [policy.joint_names.index(joint) for joint in names]
    assert facts["joint_friction"] == [0.0] * 12
    for field, own in policy_file.TASK.items():
        value = config.task[field]
        assert facts[own] == (list(value) if isinstance(value, tuple) else value), field
    assert facts["timestep"] * facts["substeps"] == facts["control_dt"] == 0.02
    assert facts["control_rate"] == pytest.approx(50)
    assert facts["base_com"] == model.body(1).ipos.tolist()
    assert facts["activation"] == "elu" and facts["observation"] == "velocity-48"
    assert facts["config"] == json.loads(json.dumps(policy.config))
    assert facts["dynappo"] == versions.of("dynappo") and "Apache-2.0" in facts["licence"]
    assert net.get_modelmeta().producer_name == "dynappo"
    assert name in net.get_modelmeta().description
    numbers = {k for k, v in facts.items() if isinstance(v, float)}
    assert numbers <= set(facts["units"]) <= set(facts)


def test_the_observation_table_is_that_of_observe():
    """Every number once, in order; each part and its noise where `observe` puts them."""
    policy, robot, _ = described("anymal_d")
    rows = onnx_file.about(policy, robot)["observation_table"]
    assert [row["start"] for row in rows] == [0, *(row["stop"] for row in rows[:-1])]
    assert rows[-1]["stop"] == 48
    noise = np.concatenate([[row["noise"]] * (row["stop"] - row["start"]) for row in rows])
    group = config_lib.load("configs/anymal_d.py").task.noise
    np.testing.assert_array_equal(noise, observe.noise_scale(group, np, 12))

    # one quantity at a time, through `observe` itself
    data = {name: np.zeros(12) for name in ("joint_position", "joint_velocity", "previous_action")}
    data |= {name: np.zeros(3) for name in ("linear_velocity", "angular_velocity", "command")}

    def vector(data):
        qpos = np.concatenate([[0, 0, 0.5, 1, 0, 0, 0], data["joint_position"]])
        base = data["linear_velocity"], data["angular_velocity"]
        qvel = np.concatenate([*base, data["joint_velocity"]])
        rest = data["command"], data["previous_action"]
        return observe.observe(qpos, qvel, np.zeros(3), np.zeros(12), *rest)

    at_rest, parts = vector(data), {row["name"]: slice(row["start"], row["stop"]) for row in rows}
    for name, zero in data.items():
        changed = vector(data | {name: np.ones_like(zero)}) - at_rest
        there = np.arange(parts[name].start, parts[name].stop)
        np.testing.assert_array_equal(np.flatnonzero(changed), there, name)
    np.testing.assert_array_equal(at_rest[parts["gravity"]], [0, 0, -1])
    assert parts.keys() == data.keys() | {"gravity"}


def test_a_run_of_before_without_noise_in_its_config_can_be_exported():
    """The noise is said to be unknown."""
    policy, robot, _ = described("go2")
    config = json.loads(json.dumps(policy.config))
    del config["task"]["noise"]
    old = policy._replace(config=config)
    noise = [row["noise"] for row in onnx_file.observation_table(old)]
    assert noise == [None] * 5 + [0.0] * 2
    session(old, robot)
