"""Robots in all kinds of states, for the kernel of a control step and for C MuJoCo."""

import copy
import functools

import mujoco
import numpy as np
import warp as wp

from dynappo import config as config_lib
from dynappo.description import contacts
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators
from dynappo.physics import ground as ground_lib
from dynappo.physics.warp import arrays, quadruped

ROBOTS = 64
MOTOR = (20.0, 0.5, 23.7, 28.0, 30.0, 0.9, 0.3, 1.0)  # arrays.MOTOR


load = functools.cache(robot_lib.load)  # hundreds of cases are one robot


@functools.cache
def physics(name):
    """The group physics of a config, its solver run to the end."""
    config = config_lib.load(f"configs/{name}.py")
    config.physics.update(iterations=30, ls_iterations=30)
    return config.physics


class Case:
    """Robots near the floor, tilted, pushed, some joints beyond their range; and their numbers.

    The tilt and the joints' noise of every other robot are `calm` times as large: whole feet touch the floor.
    """

    def __init__(
        self,
        name,
        substeps=1,
        robot=None,
        motors=MOTOR,
        way=quadruped,
        calm=1.0,
        every=False,
        ground=None,
    ):
        self.robot = robot = robot or load(name)
        self.way, self.motors = way, motors
        self.model = model = ground_lib.model(robot, physics(name), ground)
        self.ground, self.shape = ground, arrays.shape(model, robot, substeps, every, ground)
        rng, joints = np.random.default_rng(0), model.nu
        qpos = np.tile(model.key("home").qpos, (ROBOTS, 1))
        qpos[:, 2] -= rng.uniform(0, 0.05, ROBOTS)
        noise = np.where(np.arange(ROBOTS) % 2, calm, 1.0)[:, None]
        qpos[:, 3:7] += noise * rng.normal(0, 0.2, (ROBOTS, 4))
        qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
        qpos[:, 7:] += noise * rng.normal(0, 0.3, (ROBOTS, joints))
        if ground is not None:
            self.spread(qpos)
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

    def spread(self, qpos):
        """Robots over a height map, the lowest foot of each a little in it or above it."""
        heights, cell, corner = self.ground
        rng, data = np.random.default_rng(1), mujoco.MjData(self.model)
        deepest = min(0.008, 0.5 * self.model.geom_size[self.robot.feet, 0].min())
        far = cell * (np.array(heights.shape) - 1)
        qpos[:, :2] = corner + rng.uniform(0.45, 0.55, (ROBOTS, 2)) * far
        for pose in qpos:
            for _ in range(3):  # feet that are lowered meet other triangles
                data.qpos[:] = pose
                mujoco.mj_kinematics(self.model, data)
                pose[2] -= self.above(data)[0].min()
            pose[2] -= rng.uniform(-0.002, deepest)

    def above(self, data):
        """Heights of the feet's shapes, and of the parts, above a height map."""
        feet, parts = self.robot.feet, self.robot.parts
        place, turn = data.geom_xpos, data.geom_xmat.reshape(-1, 3, 3)
        ends, probes = (
            contacts.probes(self.model, geoms, between)
            for geoms, between in ((feet, False), (parts, True))
        )
        return [
            ground_lib.feet_above(ends, self.ground, place[feet], turn[feet]),
            ground_lib.parts_above(probes, self.ground, place[parts], turn[parts]),
        ]

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
        model.opt.ccd_tolerance = 1e-12  # of contacts with a height field
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


def deepest_alone(model, data):
    """As `mujoco.mj_step`, without the contacts of a shape that are not its deepest: on a height field it has
    one with every triangle that it reaches."""
    first = mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_makeM, mujoco.mj_factorM
    for phase in (*first, mujoco.mj_collision):
        phase(model, data)
    shape, dist = data.contact.geom[:, 1], data.contact.dist
    for i in range(data.ncon):
        others = np.flatnonzero(shape == shape[i])
        data.contact[i].exclude = int(i != others[np.argmin(dist[others])])
    constraints = mujoco.mj_makeConstraint, mujoco.mj_island, mujoco.mj_transmission
    forces = mujoco.mj_fwdVelocity, mujoco.mj_fwdActuation, mujoco.mj_fwdAcceleration
    for phase in (*constraints, mujoco.mj_projectConstraint, *forces, mujoco.mj_fwdConstraint):
        phase(model, data)
    mujoco.mj_Euler(model, data)


def a_physics_step(case, mj_step=mujoco.mj_step):
    """Assert that one of the kernel is one of C MuJoCo; `(contacts, joint limits, points touching of each
    foot [ROBOTS, F])`."""
    found, touching, limited, seen = case.step(case.before), 0, 0, []
    kp, kd, effort, stall, speed, strength, *_ = np.transpose(case.motors)
    limits = dict(effort_limit=effort, saturation_effort=stall, velocity_limit=speed)
    robot = case.robot
    for i in range(ROBOTS):
        model, data = case.of_robot(i)
        before = data.qvel[6:].copy()
        pd = actuators.pd(case.before["target"][i, 0], data.qpos[7:], before, kp, kd)
        torque = strength * actuators.clip_dc_motor(pd, before, **limits)
        atol = 2e-5 * max(1, np.max(effort) / 20)
        np.testing.assert_allclose(found["torque"][i], torque, atol=atol)
        drive(data, torque, case.motors)
        mj_step(model, data)
        touching, limited = touching + data.ncon, limited + data.nl
        qacc = data.qacc_warmstart
        # a GPU was off by 3.1e-5. On a map MuJoCo's heights are shares of the highest, of single
        # precision; contacts are stiff
        share = 5e-5 if case.ground is None else 2e-4
        np.testing.assert_allclose(found["qacc_warmstart"][i], qacc, atol=share * abs(qacc).max())
        fast = max(1, abs(data.qvel).max() / 5)  # light feet and hands turn fast
        np.testing.assert_allclose(found["qvel"][i], data.qvel, atol=1e-4 * fast)
        np.testing.assert_allclose(found["qpos"][i], data.qpos, atol=1e-6 * fast)
        # sqrt(1 - z^2) of an upright cylinder has half of the digits
        atol = 1e-5 if (model.geom_type[robot.parts] == contacts.CYLINDER).any() else 1e-6
        sole, lowest = (_low(model, data, geoms) for geoms in (robot.feet, robot.parts))
        if case.ground is not None:
            sole, lowest = case.above(data)
        np.testing.assert_allclose(found["lowest"][i], lowest, atol=atol)
        foot_of = robot.foot_of
        height = np.array([sole[foot_of == f].min() for f in range(len(robot.foot_names))])
        np.testing.assert_array_equal(found["contact_steps"][i], height < 0)
        np.testing.assert_array_equal(found["air_steps"][i], height >= 0)
        np.testing.assert_allclose(found["peak"][i], np.maximum(height, 0), atol=1e-6)
        of = [foot_of[list(robot.feet).index(geom)] for geom in data.contact.geom[:, 1]]
        seen.append(np.bincount(of, minlength=len(height)))
    return touching, limited, np.array(seen)


def _low(model, data, geoms):
    fixed, linear, ring = contacts.floor_distance(model, geoms)
    row = data.geom_xmat[geoms][:, 6:]
    drop = fixed + (linear * abs(row)).sum(-1) + ring * np.sqrt(1 - row[:, 2] ** 2)
    return data.geom_xpos[geoms, 2] - drop


def several_steps(case, several):
    """Assert that `several` physics steps in a call are calls of one each, of `case`, with the target of
    each; what they make."""
    found, after, lows = several.step(several.before), several.before, []
    for substep in range(several.shape.substeps):
        target = several.before["target"][:, substep : substep + 1]
        after = case.step(after | {"target": np.ascontiguousarray(target)})
        lows.append(after["lowest"])
    if several.shape.every_substep:
        after = after | {"lowest": np.min(lows, 0)}
    for name in (*arrays.IN_OUT, *arrays.RESULTS):
        atol = 2e-2 if name == "qacc_warmstart" else 1e-4  # rad/s2: contacts are stiff
        atol *= max(1, abs(after["qvel"]).max() / 5)  # light feet and hands turn fast
        np.testing.assert_allclose(found[name], after[name], atol=atol, err_msg=name)
    return found


def rounds_stop(case, few, worst=0.1):
    """Assert that ten times the rounds of Newton's method change nothing, and `few`, of it and of the line
    search, hardly."""
    opt = case.model.opt
    kept, found = (opt.iterations, opt.ls_iterations), case.step(case.before)["qacc_warmstart"]
    opt.iterations = 300
    np.testing.assert_allclose(
        case.step(case.before)["qacc_warmstart"], found, rtol=1e-4, atol=1e-3
    )
    opt.iterations, opt.ls_iterations = few
    short = case.step(case.before)["qacc_warmstart"]
    opt.iterations, opt.ls_iterations = kept
    off = abs(short - found).max(1) / abs(found).max(1)
    assert np.median(off) < 1e-5 and off.max() < worst
