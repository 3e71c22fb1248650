"""How smoothly policies walk: energy, torques, joint speeds, changes of the targets, foot clearance.

    python experiments/22_deploy/gait.py go1 go1_deploy RUN.npz ...

Seven commands of 6 s in C MuJoCo, the first second left out. Prints a row a policy:

- cost of transport: the integral of |torque x joint speed| / (weight x way of the base)
- torque and joint speed that 99.9 % of all physics steps and joints stay below
- change of the targets: root mean square, rad/s, over control steps and joints
- clearance: median over swings of at least 60 ms of the highest that a foot's lowest point was; of the seven
  commands, and of 0.5 m/s ahead alone
- scuff: horizontal speed of a foot's centre that 90 % of the feet below 4 mm stay below; one that rolls over
  its toe moves, too, and so does one that has just landed or is about to lift
- slide: the same without the first and the last 20 ms of the time that a foot is below 4 mm
- load: the mean normal force of the foot that carries most, over that of the one that carries least
- front, left: the load of front over that of hind feet, of left over that of right ones
- front of standing: the same of a robot that stands in its default pose, which follows from where its mass is
"""

import sys
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dynappo.evaluate import stress
from dynappo.evaluate.foot_motion import at_ground, intervals
from dynappo.policy import episode, policy_file, policy_source
from dynappo.tasks.velocity import observe

SECONDS, SETTLE, SWING, LOW, EDGE = 6.0, 1.0, 0.06, 0.004, 0.02
AHEAD = 0.5  # m/s
LISTS = "torques speeds changes clearances scuffs slides".split()  # of a walk


def main():
    for name in sys.argv[1:]:
        policy = (
            policy_file.load(Path(name)) if name.endswith(".npz") else policy_source.load(name)[0]
        )
        row = measure(policy)
        print(
            f"{Path(name).stem:20s}", ", ".join(f"{k} {v:.3g}" for k, v in row.items()), flush=True
        )


def measure(policy) -> dict[str, float]:
    body = policy_source.player(policy)[0]
    weight = body.model.body_subtreemass[body.base_body] * -body.model.opt.gravity[2]
    shapes = [int(np.flatnonzero(body.foot_of == foot)[0]) for foot in range(len(body.foot_names))]
    standing, front, left = stand(body, shapes)
    walks = [walk(policy, body, shapes, command) for command in stress.commands(policy)[1:]]
    every = {name: np.concatenate([one[name] for one in walks]) for name in LISTS}
    load = sum(one["load"] for one in walks)
    ahead = walk(policy, body, shapes, np.array([AHEAD, 0.0, 0.0]))
    return {
        "cost of transport": sum(one["work"] for one in walks)
        / (weight * sum(one["way"] for one in walks)),
        "torque N m": np.quantile(every["torques"], 0.999),
        "joint speed rad/s": np.quantile(every["speeds"], 0.999),
        "change of targets rad/s": np.sqrt(np.mean(np.square(every["changes"]))),
        "clearance cm": 100 * np.median(every["clearances"]),
        f"clearance at {AHEAD:g} m/s cm": 100 * np.median(ahead["clearances"]),
        "scuff m/s": np.quantile(every["scuffs"], 0.9),
        "slide m/s": np.quantile(every["slides"], 0.9),
        "load": load.max() / load.min(),
        "front": share(load, front),
        "left": share(load, left),
        "front of standing": standing,
    }


def walk(policy, body, shapes: list[int], command) -> dict[str, Any]:
    """`LISTS` of a command from standing, the first second left out; `load` (N, summed) of each foot, `work`
    (J), the base's `way` (m)."""
    model, act = body.model, policy_file.actor(policy.params, policy.activation)
    dt, single = model.opt.timestep, body._replace(substeps=1)
    data, load, work, way = mujoco.MjData(model), np.zeros(len(shapes)), 0.0, 0.0
    torques, speeds, changes, heights, paces = [], [], [], [], []
    episode.reset(body, data)
    see = observe.memory(policy.observation, policy.history, policy.own)
    action = before = np.zeros(len(policy.joint_names))
    for k in range(round(SECONDS / (dt * body.substeps))):
        settled = k * dt * body.substeps >= SETTLE
        before, action = action, act(see(episode.look(body, data, command, action)))
        for _ in range(body.substeps):
            done, _ = episode.step(single, data, action)
            if settled:
                torques.append(np.abs(data.qfrc_applied[body.joint_v]))
                speeds.append(np.abs(data.qvel[body.joint_v]))
                heights.append(episode.foot_heights(body, data))
                paces.append([ground_speed(model, data, shape) for shape in shapes])
                load += at_ground(body, data)[1]
                way += np.linalg.norm(data.qvel[:2]) * dt
                work += done
        if settled:
            changes.append((action - before) * policy.action_scale / (dt * body.substeps))
    low, pace, clearances = np.array(heights) < LOW, np.array(paces), []
    for height in np.array(heights).T:
        swings = zip(*intervals(height > LOW), strict=True)
        clearances += [height[on:off].max() for on, off in swings if (off - on) * dt >= SWING]
    scuffs, slides = pace[low], pace[inside(low, round(EDGE / dt))]
    lists = torques, speeds, changes, clearances, scuffs, slides
    return dict(zip(LISTS, lists, strict=True)) | {"load": load, "work": work, "way": way}


def stand(body, shapes: list[int]) -> tuple[float, np.ndarray, np.ndarray]:
    """What front feet carry over what hind feet do in the default pose, which feet are in front, which left.

    Forces at the ground balance about the middle of the mass: front / hind is the distance of the hind feet
    from it over that of the front feet.
    """
    data = mujoco.MjData(body.model)
    episode.reset(body, data)
    x, y = (data.geom_xpos[shapes] - data.subtree_com[body.base_body])[:, :2].T
    front = x > 0
    return -x[~front].mean() / x[front].mean(), front, y > 0


def share(load, feet) -> float:
    """The load of these feet over that of the others."""
    return load[feet].sum() / load[~feet].sum()


def inside(low, steps: int) -> np.ndarray:
    """[T, F] Where a foot has been `low` for more than so many steps, and will be."""
    out = low.copy()
    for k in range(1, steps + 1):
        out[k:] &= low[:-k]
        out[:-k] &= low[k:]
    return out


def ground_speed(model, data, shape: int) -> float:
    """Horizontal speed of a shape's centre, m/s."""
    velocity = np.zeros(6)
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_GEOM, shape, velocity, 0)
    return float(np.hypot(*velocity[3:5]))


if __name__ == "__main__":
    main()
