"""Policies with random networks, exported, and the same situations in any order of the joints."""

from typing import Any

import numpy as np
import onnxruntime

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.export import onnx_file
from dynappo.policy import policy_file

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


def described(name, activation="elu", hidden=(32, 24)):
    """`(policy, robot, static)`: of a bundled robot's config, with random networks."""
    config = config_lib.load(f"configs/{name}.py:dyna4")
    config.ppo.update(activation=activation, hidden=hidden)
    config, robot = config_lib.validate(config), robot_lib.load(name)
    policy = policy_file.describe(config, robot, parameters(hidden))
    # as if each joint had its own, so that a wrong order shows
    return policy._replace(joint_damping=tuple(range(12))), robot, config_lib.split(config)[0]


def parameters(hidden):
    """Of an actor and a critic with layers of these sizes, with the names of `networks.init_policy`."""
    rng = np.random.default_rng(0)

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
    model = onnx_file.onnx_model(policy, onnx_file.about(policy, robot), targets)
    return onnxruntime.InferenceSession(model.SerializeToString())


def infer(net, obs, output="action"):
    """One output for observations [B, 48]."""
    return net.run([output], {"obs": np.asarray(obs, np.float32)})[0]


def observations(names, batch=64):
    """Observations `[B, 48]` of the same situations, joints in the order `names`."""
    rng = np.random.default_rng(1)
    parts = {name: rng.normal(size=(batch, 3)) for name in sorted(names)}  # q, qd, previous action
    q, qd, action = (np.stack([parts[name][:, i] for name in names], 1) for i in range(3))
    body = rng.normal(size=(batch, 12))  # gravity, velocities, command
    return np.concatenate([q, 5 * qd, body, action], axis=1).astype(np.float32)
