"""C MuJoCo on all CPU cores: one call from the compiled program does a control step of all robots.

On two CPU cores it makes more than twice as many steps as MJX (CHANGELOG.md). `mujoco.rollout` has
a pool of threads in C. Each takes the next robots, so no thread waits while another works, and a
robot's result depends neither on the thread nor on other robots.

Why a call per control step, not per physics step: every robot has its own physical parameters and
so its own model, and four steps read the model from memory once. With 512 Go1 on two cores that is
34 instead of 21 k control steps/s (a prototype, 2026-11-22). PD and motor limits are therefore
MuJoCo's: its DC motor with a position input computes the same as `actuators.clip_dc_motor`
(tests/physics/test_c_mujoco.py).

Friction in the joints (`actuators.friction`) is the one torque that MuJoCo's motors do not compute: it is
applied from outside, so a control step with it calls `mujoco.rollout` for each physics step. Go1 then
makes 11 instead of 17 k control steps/s on one core.

`mujoco.rollout` returns the geoms at the start of a physics step only through sensors, which cost
nothing measurable. It does not return accelerations: the solver starts the next control step from
the change of velocity in the last physics step, which without joint damping is the same.
"""

from __future__ import annotations

import copy
import threading
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import rollout

from dynappo.description import contacts, mjcf, motors
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators, engine_contract, xla_call
from dynappo.physics import ground as ground_lib
from dynappo.physics.cores import cores
from dynappo.terrain.height_map import HeightMap

# the numbers that define a robot's model, in the order of the last argument of a call; of those of the
# motors one for all joints, or one for each
BODY_NUMBERS = "mass_scale", *["base_com"] * 3, "friction", "armature"
MOTOR_NUMBERS = (
    "kp",
    "kd",
    "effort_limit",
    "saturation_effort",
    "velocity_limit",
    "joint_friction",
)
CONTROL = int(mujoco.mjtState.mjSTATE_CTRL)
APPLIED = CONTROL | int(mujoco.mjtState.mjSTATE_QFRC_APPLIED)
POSITION = int(mujoco.mjtCtrlInput.mjINPUT_POS)  # a motor's control is a position
ROOM = 2e9  # bytes, of all models: a robot's has the whole ground, which may be a map of many MB
FAR = 500.0  # MuJoCo never gets a state or a target above it: it would log a warning
AWAY = 1e6  # m, the same of a base's x and y: a robot may walk for long
FAR_ACCELERATION = 1e6
_ONE_AT_A_TIME = threading.Lock()  # the pool of threads can do only one call at a time


class Moved(NamedTuple):
    """A robot after a control step of `n` physics steps; geoms are where each of them began."""

    qpos: Any
    qvel: Any
    qacc_warmstart: Any
    torque: Any  # [A] N m, of the motors in the last physics step
    qd_before: Any  # [A] rad/s, before it
    feet: Any  # [n, S] m, heights of the centres of the feet's shapes; on a height map [n, S, 3], places
    parts: Any  # [n, G] or [n, G, 3], of the parts' centres
    # orientations, [n, G, 4] of the parts, or [n, S + G, 4] where feet are no spheres, and on a height map
    quat: Any


def make(
    robot: robot_lib.Robot,
    physics,
    varied: frozenset[str],
    has_friction: bool = False,
    ground: HeightMap | None = None,
):
    """`step(qpos, qvel, qacc_warmstart, target, numbers) -> Moved` of one robot, for `jax.vmap`.

    `physics` is the config's group. `target` are joint angles [n, A], a row a physics step; `numbers` are
    those of `BODY_NUMBERS` and then of `MOTOR_NUMBERS`. `has_friction`: of the joints,
    also where it does not vary. `ground`: None is flat.
    """
    engine_contract.check(robot, physics, "c", ground)
    varied |= {"joint_friction"} if has_friction else set()
    steps, threads, model = physics.substeps, cores(physics.threads), _model(robot, physics, ground)
    name = f"dynappo_c_{steps}_{threads}_{'_'.join(sorted(varied))}_{robot_lib.digest(model)}"
    if not xla_call.registered(name):
        xla_call.register(name, _World(robot, model, steps, threads, varied).step)
    parts, feet = len(robot.parts), len(robot.feet)
    shapes = (model.nq,), (model.nv,), (model.nv,), (model.nu,), (model.nu,)
    place = () if ground is None else (3,)
    turned = len(_turned(robot, ground is not None))
    shapes += (steps, feet, *place), (steps, parts, *place), (steps, turned, 4)
    shapes = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]
    # declared as a side effect, so that JAX waits for it before Python ends (xla_call.py)
    call = jax.ffi.ffi_call(name, shapes, vmap_method="broadcast_all", has_side_effect=True)
    return lambda *args: Moved(*call(*args))


def _turned(robot: robot_lib.Robot, rough: bool) -> np.ndarray:
    """Geoms whose orientation matters: parts, preceded by the feet unless all are spheres and the ground is
    not `rough`."""
    spheres = (robot.mj_model.geom_type[robot.feet] == contacts.SPHERE).all()
    return robot.parts if spheres and not rough else np.concatenate([robot.feet, robot.parts])


def _model(robot: robot_lib.Robot, physics, ground: HeightMap | None = None) -> mujoco.MjModel:
    """The robot's model with sensors for the geoms, and DC motors that hold a joint angle."""
    spec = robot_lib.physics_spec(robot.xml, robot.text)
    ground_lib.put(spec, ground)
    geom, kinds = mujoco.mjtObj.mjOBJ_GEOM, mujoco.mjtSensor
    feet, parts, turned = (
        [spec.geoms[i] for i in ids]
        for ids in (robot.feet, robot.parts, _turned(robot, ground is not None))
    )
    for sensor in list(spec.sensors):  # the file's own
        spec.delete(sensor)
    for i, shape in enumerate(spec.geoms):
        shape.name = shape.name or f"geom {i}"
    for kind, shapes in (
        (kinds.mjSENS_FRAMEPOS, feet + parts),
        (kinds.mjSENS_FRAMEQUAT, turned),
    ):
        for shape in shapes:
            spec.add_sensor(type=kind, objtype=geom, objname=shape.name)
    for motor in spec.actuators:
        spec.add_sensor(
            type=kinds.mjSENS_ACTUATORFRC, objtype=mujoco.mjtObj.mjOBJ_ACTUATOR, objname=motor.name
        )
        motor.set_to_dcmotor([1, 1], 1.0, controller=[1, 0, 1, 0, 0, 1], ctrlspec=POSITION)
        motor.forcelimited, motor.forcerange = True, [-1, 1]  # replaced by each robot's numbers
    model = robot_lib.with_settings(spec.compile(), physics, robot.parts)
    motors.set_armature(model, np.arange(6, model.nv), robot.mj_model.dof_armature[6:])
    # a policy may bring its own (evaluate/episodes.py)
    model.dof_damping[6:] = robot.mj_model.dof_damping[6:]
    model.dof_frictionloss[6:] = robot.mj_model.dof_frictionloss[6:]
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # a blow-up must be visible
    return model


class _World:
    """Models, scratch arrays and threads; XLA calls `step`."""

    def __init__(self, robot, model, steps: int, threads: int, varied):
        self.robot, self.model, self.steps, self.varied = robot, model, steps, varied
        self.models: list[mujoco.MjModel] = []
        self.written = np.zeros((0, 0), np.float32)  # the numbers in the models
        self.datas = [mujoco.MjData(model) for _ in range(threads)]
        self.most = max(threads, int(ROOM / mujoco.mj_sizeModel(model)))  # robots at a time
        self.pool = rollout.Rollout(nthread=threads if threads > 1 else 0)

    def step(self, args: list[np.ndarray], outs: list[np.ndarray]) -> None:
        with _ONE_AT_A_TIME, mjcf.without_warnings():  # blow-ups are counted (velocity/env.py)
            robots = args[0].size // self.model.nq
            given, found = ([x.reshape(robots, -1) for x in arrays] for arrays in (args, outs))
            for first in range(0, robots, self.most):
                some = slice(first, first + self.most)
                self._step([x[some] for x in given], [x[some] for x in found])

    def _step(self, args, outs) -> None:
        qpos, qvel, warm, target, numbers = args
        if not np.isfinite(numbers).all():
            raise ValueError("a body or a motor with numbers that are not finite")
        count, robot, model = len(qpos), self.robot, self.model
        # False where one is NaN; every base is free (robot_contract.py), its x and y come first
        good = np.abs(np.concatenate([qpos[:, 2:], qvel, target], 1)).max(1) < FAR
        good &= np.abs(qpos[:, :2]).max(1) < AWAY
        good &= np.abs(warm).max(1) < FAR_ACCELERATION
        state = np.empty((count, 1 + model.nq + model.nv))
        state[:, 0], state[:, 1 : 1 + model.nq], state[:, 1 + model.nq :] = 0, qpos, qvel
        control = target.reshape(count, self.steps, -1).astype(float)
        warm = warm.astype(float)
        if not good.all():
            bad = ~good
            state[bad, 1 : 1 + model.nq], state[bad, 1 + model.nq :] = robot.home_qpos, 0
            control[bad], warm[bad] = robot.default_pose, 0
        given = self._models(numbers), state, control, warm
        if "joint_friction" in self.varied:
            friction = _of_motors(numbers.astype(float), "joint_friction")
            after, sensed = self._with_friction(friction, *given)
        else:
            after, sensed = self._roll(*given)
        feet, parts = len(robot.feet), len(robot.parts)
        rough = bool(model.nhfield)
        turned = len(_turned(robot, rough))
        positions, quats, torque = np.split(
            sensed, [3 * (feet + parts), 3 * (feet + parts) + 4 * turned], 2
        )
        places = positions.reshape(*positions.shape[:2], -1, 3)
        places = places if rough else places[..., 2]
        velocity = after[..., 1 + model.nq :]
        before = velocity[:, -2] if self.steps > 1 else state[:, 1 + model.nq :]
        found = (
            after[:, -1, 1 : 1 + model.nq],
            velocity[:, -1],
            (velocity[:, -1] - before) / model.opt.timestep,
            torque[:, -1],
            before[:, 6:],
            places[:, :, :feet],
            places[:, :, feet:],
            quats.reshape(count, self.steps, turned, 4),
        )
        for out, value in zip(outs, found, strict=True):
            out = out.reshape(count, *value.shape[1:])
            out[...] = value
            if not good.all():
                out[~good] = np.nan

    def _roll(self, models, state, control, warm, spec: int = CONTROL):
        """States after, and what was sensed in, the physics steps [robots, n, ...] of `control`."""
        shape, model = control.shape[:2], self.model
        return self.pool.rollout(
            models,
            self.datas,
            state,
            control,
            control_spec=spec,
            skip_checks=True,
            nstep=shape[1],
            initial_warmstart=warm,
            state=np.empty((*shape, state.shape[1])),
            sensordata=np.empty((*shape, model.nsensordata)),
        )

    def _with_friction(self, size, models, state, control, warm):
        """`_roll` of joints that friction of `size` [robots, 1 or A] slows, by speeds when a step begins."""
        found, first = [], 1 + self.model.nq
        for k in range(self.steps):
            velocity = state[:, first:]
            applied = np.zeros_like(velocity)
            applied[:, 6:] = -actuators.friction(velocity[:, 6:], size)
            given = np.concatenate([control[:, k], applied], 1)[:, None]
            found.append(self._roll(models, state, given, warm, APPLIED))
            state = found[-1][0][:, 0].copy()
            warm = (state[:, first:] - velocity) / self.model.opt.timestep
        return [np.concatenate(parts, 1) for parts in zip(*found, strict=True)]

    def _models(self, numbers: np.ndarray) -> list[mujoco.MjModel]:
        """A model for each row of `numbers`; one for all if the rows are equal."""
        count = 1 if (numbers == numbers[0]).all() else len(numbers)
        while len(self.models) < count:
            self.models.append(copy.copy(self.model))
        width = numbers.shape[1]  # that of other programs may differ
        if self.written.shape[1] != width:
            self.written = np.zeros((0, width), np.float32)
        old = np.full((count, width), np.nan, np.float32)
        old[: len(self.written)] = self.written[:count]
        for i in np.flatnonzero((old != numbers[:count]).any(1)):
            self._write(self.models[i], numbers[i].astype(float))
        kept = self.written[count:]
        self.written = np.concatenate([numbers[:count], kept])
        return self.models[:count] * (len(numbers) // count)

    def _write(self, model: mujoco.MjModel, numbers: np.ndarray) -> None:
        """Write one robot's parameters and motors, as in `randomize.merge` and `actuators`."""
        base, feet, nominal = self.robot.base_body, self.robot.feet, self.model
        scale, com, (friction, armature) = numbers[0], numbers[1:4], numbers[4:6]
        kp, kd, effort, stall, speed, _ = (_of_motors(numbers, name) for name in MOTOR_NUMBERS)
        if "base_mass" in self.varied:
            model.body_mass[base] = nominal.body_mass[base] * scale
            model.body_inertia[base] = nominal.body_inertia[base] * scale
        if "base_com" in self.varied:
            model.body_ipos[base] = com
            # else MuJoCo takes the body's frame for the inertia's, where the file has them in one place
            model.body_sameframe[base] = mujoco.mjtSameFrame.mjSAMEFRAME_NONE
        if "friction" in self.varied:
            model.geom_friction[feet, 0] = friction
        if "armature" in self.varied:
            model.dof_armature[6:] = nominal.dof_armature[6:] * armature
        # with resistance 1 and constant k: torque <= k (V - k qd) = stall (1 - qd / speed)
        k = np.sqrt(stall / speed)
        gain, force = model.actuator_gainprm, model.actuator_forcerange
        gain[:, 1], gain[:, 4], gain[:, 6], gain[:, 7] = k, kp, kd, stall / k
        force[:, 0], force[:, 1] = -effort, effort


def _of_motors(numbers: np.ndarray, name: str) -> np.ndarray:
    """That of `MOTOR_NUMBERS`, [..., 1 or A], in the `numbers` [..., K] of a call."""
    motors = numbers[..., len(BODY_NUMBERS) :]
    width = motors.shape[-1] // len(MOTOR_NUMBERS)
    first = MOTOR_NUMBERS.index(name) * width
    return motors[..., first : first + width]
