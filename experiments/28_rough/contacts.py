"""What a second contact of a foot would change: a policy of the floor on low stairs, here and in C MuJoCo.

    python experiments/28_rough/contacts.py go2 --step 0.04 --robots 600 [--worlds kernel,all,two]

Stairs along x, 0.3 m a step, walls a cell (0.1 m) wide; robots are told 0.65 m/s for 8 s, start a little
apart, and have no noise. A line a world: the share that falls (tilted by more than 60 degrees), its standard
error, and the mean speed (m/s) until then. Worlds:

    kernel   our kernel (physics/warp/quadruped.py): one contact a foot, with the nearest triangle
    all      C MuJoCo on the same height field: one with every triangle that a foot reaches
    deepest  the same without all contacts of a foot but its deepest
    two      the same with the deepest, and the deepest on a triangle that is 5 degrees steeper or flatter
    boxes    C MuJoCo, the same surface made of boxes: no triangles inside of a tread
"""

import math
from pathlib import Path

import mujoco
import numpy as np
import warp as wp

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.physics import actuators
from dynappo.physics import ground as ground_lib
from dynappo.physics.warp import arrays, quadruped
from dynappo.policy import policy_file
from dynappo.tasks.velocity import observe
from dynappo.terrain import height_map
from dynappo.terrain.height_map import HeightMap
from experiments import paper

CELL, TREAD, HALF = 0.1, 0.3, 6.0  # m; HALF: of the map's side
COMMAND, SECONDS, TILTED = np.array([0.65, 0.0, 0.0]), 8.0, 60.0  # m/s; s; degrees
ANOTHER = math.cos(math.radians(5.0))  # of two normals that differ


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("robot", help="with a bundled policy, as go2")
    parser.add_argument("--step", type=float, default=0.04, help="m, height of a step")
    parser.add_argument("--robots", type=int, default=600)
    parser.add_argument("--worlds", default="kernel,all,deepest,two,boxes")
    args = parser.parse_args()
    robot = robot_lib.load(args.robot)
    policy = policy_file.load(Path(robot.xml).with_name("policy.npz"))
    x = CELL * np.arange(round(2 * HALF / CELL) + 1) - HALF
    heights = np.repeat(args.step * np.floor(x / TREAD + 1e-6)[:, None], len(x), 1)
    ground = HeightMap(heights.astype(np.float32), CELL, (-HALF, -HALF))
    physics = config_lib.load(f"configs/{args.robot}.py").physics
    physics.iterations = 20
    model = ground_lib.model(robot, physics, ground)
    start = places(robot, model, ground, args.robots)
    for name in args.worlds.split(","):
        if name == "kernel":
            step = in_kernel(robot, policy, model, ground, start)
        else:
            on = of_boxes(robot, physics, args.step) if name == "boxes" else model
            step = in_c(on, policy, start, name, ground)
        fell, speed = walk(step, model, robot, policy, start)
        error = math.sqrt(fell.mean() * (1 - fell.mean()) / len(fell))
        print(f"{name:8s} fell {fell.mean():.3f} +- {error:.3f}  {speed:.3f} m/s", flush=True)


def places(robot, model, ground, count: int) -> np.ndarray:
    """Poses [count, Q] on the lower half of the stairs, the lowest foot of each on the ground."""
    rng, data = np.random.default_rng(1), mujoco.MjData(model)
    start = np.tile(robot.home_qpos, (count, 1))
    start[:, :2] = rng.uniform(-0.5, 0.5, (count, 2)) - [HALF / 2, 0]
    start[:, 7:] += rng.uniform(-0.02, 0.02, (count, model.nu))
    radius = model.geom_size[robot.feet, 0]
    for pose in start:
        for _ in range(4):
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            gaps, _ = height_map.nearest(*ground, data.geom_xpos[robot.feet], radius)
            pose[2] -= (gaps - radius).min()
    return start


def walk(step, model, robot, policy, start):
    """Which robots fell [R], and the mean speed of all until then (m/s)."""
    act = policy_file.actor(policy.params, policy.activation)
    see = [observe.memory(policy.observation, policy.history) for _ in start]
    com, dt = model.body_ipos[robot.base_body], policy.timestep * policy.substeps
    qpos, qvel, action = start, np.zeros((len(start), model.nv)), np.zeros((len(start), model.nu))
    fell, last, time = np.zeros(len(start), bool), start.copy(), np.zeros(len(start))
    for _ in range(round(SECONDS / dt)):
        seen = [
            view(observe.observe(q, v, com, policy.default_pose, COMMAND, a))
            for view, q, v, a in zip(see, qpos, qvel, action, strict=True)
        ]
        action = np.asarray(act(np.stack(seen)), float)
        qpos, qvel = step(actuators.target(action, policy.default_pose, policy.action_scale))
        up = 1 - 2 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
        fell |= ~(up > math.cos(math.radians(TILTED)))  # what is no number has fallen
        last[~fell] = qpos[~fell]
        time[~fell] += dt
    return fell, (last - start)[:, 0].sum() / time.sum()


def in_kernel(robot, policy, model, ground, start):
    """`target [R, A] -> (qpos, qvel)` a control step later."""
    shape = arrays.shape(model, robot, policy.substeps, False, ground)
    p, motor = policy, np.zeros((len(start), model.nu, 8))
    limits = p.effort_limit, p.saturation_effort, p.velocity_limit
    motor[:] = np.stack(np.broadcast_arrays(p.kp, p.kd, *limits, 1.0, 0.0, 1.0), -1)
    sizes = arrays.sizes(model, shape)
    given = {name: np.zeros((len(start), *size)) for name, size in sizes.items()}
    given |= {name: getattr(model, name)[None] for name in arrays.MODEL}
    given |= dict(qpos=start, motor=motor)
    held = {}
    for name, value in given.items():
        kind = wp.vec3 if name in arrays.MODEL and len(sizes[name]) == 2 else float
        kind = int if name in arrays.COUNTS else kind
        held[name] = wp.array(np.ascontiguousarray(value, float), dtype=kind)
    buffers = quadruped.allocate(model, shape, len(start))

    def step(target):
        every = np.repeat(target[:, None], shape.substeps, 1)
        held["target"] = wp.array(np.ascontiguousarray(every), dtype=float)
        quadruped.control_step(buffers, shape, held)
        return held["qpos"].numpy().astype(float), held["qvel"].numpy().astype(float)

    return step


def in_c(model, policy, start, name: str, ground):
    """The same in C MuJoCo."""
    datas = [mujoco.MjData(model) for _ in start]
    for data, pose in zip(datas, start, strict=True):
        data.qpos[:] = pose
    limits = {
        n: getattr(policy, n) for n in ("effort_limit", "saturation_effort", "velocity_limit")
    }

    def step(target):
        for data, wanted in zip(datas, target, strict=True):
            for _ in range(policy.substeps):
                qd = data.qvel[6:]
                torque = actuators.pd(wanted, data.qpos[7:], qd, policy.kp, policy.kd)
                data.ctrl[:] = actuators.clip_dc_motor(torque, qd, **limits)
                if name in ("deepest", "two"):
                    with_few_contacts(model, data, ground if name == "two" else None)
                else:
                    mujoco.mj_step(model, data)
        return np.array([d.qpos for d in datas]), np.array([d.qvel for d in datas])

    return step


def with_few_contacts(model, data, ground: HeightMap | None) -> None:
    """`mj_step` with the deepest contact of each foot alone; on a `ground` with a second one, as `two`."""
    m = mujoco
    for phase in (m.mj_kinematics, m.mj_comPos, m.mj_makeM, m.mj_factorM, m.mj_collision):
        phase(model, data)
    foot, dist = data.contact.geom[:, 1], data.contact.dist
    normal, place = data.contact.frame[:, :3], data.contact.pos
    kept = set()
    for one in set(foot.tolist()):
        of = np.flatnonzero(foot == one)
        first = of[np.argmin(dist[of])]
        kept.add(first)
        if ground is None:
            continue
        planes = height_map.normal(*ground, place[of, 0], place[of, 1])
        on_plane = (normal[of] * planes).sum(-1) > 1 - 1e-5
        others = of[on_plane & (normal[of] @ normal[first] < ANOTHER)]
        kept |= {others[np.argmin(dist[others])]} if len(others) else set()
    for i in set(range(data.ncon)) - kept:
        data.contact[i].exclude = 1
    for phase in (
        *(m.mj_makeConstraint, m.mj_island, m.mj_transmission, m.mj_projectConstraint),
        *(m.mj_fwdVelocity, m.mj_fwdActuation, m.mj_fwdAcceleration, m.mj_fwdConstraint),
        m.mj_Euler,
    ):
        phase(model, data)


def of_boxes(robot, physics, high: float) -> mujoco.MjModel:
    """The robot on the same surface: a box under each tread, and one, turned, under each wall."""
    spec = robot_lib.physics_spec(robot.xml, robot.text)
    floor = spec.geom("floor")
    floor.pos = [0, 0, -20]
    names = "contype", "conaffinity", "condim", "priority", "friction", "solref", "solimp"
    same = {name: getattr(floor, name) for name in names} | {"type": mujoco.mjtGeom.mjGEOM_BOX}
    angle, long, add = math.atan2(high, CELL), math.hypot(high, CELL), spec.worldbody.add_geom
    along, up = np.array([math.cos(angle), math.sin(angle)]), [-math.sin(angle), math.cos(angle)]
    for n in range(round(-HALF / TREAD), round(HALF / TREAD) + 1):
        x, z = TREAD * n, high * n
        add(size=[TREAD / 2, HALF, 0.25], pos=[x + TREAD / 2, 0, z - 0.25], **same)
        # from the next tread's edge down, and on below this tread
        middle = [x + TREAD, z + high] - along * (long + 0.1) / 2 - np.multiply(0.05, up)
        turn = [math.cos(angle / 2), 0, -math.sin(angle / 2), 0]
        add(size=[(long + 0.1) / 2, HALF, 0.05], pos=[middle[0], 0, middle[1]], quat=turn, **same)
    model = robot_lib.with_settings(spec.compile(), physics, np.array([], int))
    world = model.geom_bodyid == 0
    feet = [model.geom(robot.mj_model.geom(i).name).id for i in robot.feet]
    model.geom_contype[:], model.geom_conaffinity[:] = world, 0
    model.geom_conaffinity[feet] = 1
    return model


if __name__ == "__main__":
    main()
