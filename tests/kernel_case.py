"""Robots in all kinds of states, for the kernel of a control step and for C MuJoCo."""

import copy
import functools
from pathlib import Path

import mujoco
import numpy as np
import warp as wp

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.physics.warp import arrays, quadruped, tree

ROBOTS = 64
MOTOR = (20.0, 0.5, 23.7, 28.0, 30.0, 0.9, 0.3, 1.0)  # arrays.MOTOR


load = functools.cache(robot_lib.load)  # hundreds of cases are one robot


@functools.cache
def physics(name):
    """The group physics of a config, its solver run to the end."""
    own = Path(f"configs/{name}.py")
    config = config_lib.load(str(own) if own.exists() else "configs/default.py")
    config.physics.update(iterations=30, ls_iterations=30)
    return config.physics


class Case:
    """Robots near the floor, tilted, pushed, some joints beyond their range; and their numbers."""

    def __init__(self, name, substeps=1, robot=None, motors=MOTOR, way=quadruped):
        self.robot = robot = robot or load(name)
        self.way = way
        self.model = model = robot_lib.physics_model(robot, physics(name))
        self.shape = arrays.shape(model, robot, substeps, False)
        rng, joints = np.random.default_rng(0), model.nu
        qpos = np.tile(model.key("home").qpos, (ROBOTS, 1))
        qpos[:, 2] -= rng.uniform(0, 0.05, ROBOTS)
        qpos[:, 3:7] += rng.normal(0, 0.2, (ROBOTS, 4))
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        qpos[:, 7:] += rng.normal(0, 0.3, (ROBOTS, joints))
        base = (np.arange(model.nbody) == 1)[:, None]
        scale = rng.uniform(0.8, 1.2, (ROBOTS, model.nbody))
        self.fields = {
            "body_mass": model.body_mass * scale,
            "body_inertia": model.body_inertia * scale[..., None],
            # the base's only: C MuJoCo's search for contacts keeps boxes around the links' centres
            "body_ipos": model.body_ipos + rng.normal(0, 0.02, (ROBOTS, 1, 3)) * base,
            "geom_friction": model.geom_friction * rng.uniform(0.3, 1.5, (ROBOTS, 1, 1)),
            "dof_armature": model.dof_armature * rng.uniform(0.5, 2, (ROBOTS, 1)),
        }
        self.before = {name: np.zeros((ROBOTS, *size)) for name, size in self.sizes().items()}
        qvel = rng.normal(0, 0.7, (ROBOTS, model.nv))
        target = model.key("home").qpos[7:] + rng.normal(0, 0.3, (ROBOTS, substeps, joints))
        motor = np.broadcast_to(motors, (ROBOTS, np.size(motors) // 8, 8))  # for all joints or each
        given = self.fields | dict(qpos=qpos, qvel=qvel, target=target, motor=motor)
        self.before |= {name: np.asarray(x, np.float32) for name, x in given.items()}

    def sizes(self):
        return arrays.sizes(self.model, self.shape)

    def step(self, before, way=None):
        """What the kernel, or another `way`, makes of the numbers `before`."""
        way, a = way or self.way, {}
        for name, size in self.sizes().items():
            kind = wp.vec3 if name in arrays.MODEL and len(size) == 2 else float
            a[name] = wp.array(before[name], dtype=int if name in arrays.COUNTS else kind)
        way.control_step(way.allocate(self.model, self.shape, ROBOTS), self.shape, a)
        return {name: x.numpy() for name, x in a.items()}

    def of_robot(self, i):
        """MuJoCo's model and data of robot i, its solver run to the end."""
        model = copy.copy(self.model)
        model.opt.iterations, model.opt.ls_iterations, model.opt.tolerance = 200, 200, 0.0
        for name, values in self.fields.items():
            getattr(model, name)[:] = np.asarray(values[i], np.float32)
        # no shortcuts for the masses and centres that the file has
        model.body_sameframe[:], model.dof_simplenum[:] = 0, 0
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = self.before["qpos"][i], self.before["qvel"][i]
        return model, data


def drive(data, torque, motors=MOTOR):
    """Give C MuJoCo the motors' torques and, beside them, the friction in the joints."""
    data.ctrl[:] = torque
    size = np.transpose(motors)[arrays.MOTOR.index("friction")]
    data.qfrc_applied[6:] = -size * np.tanh(data.qvel[6:] / 0.2)
