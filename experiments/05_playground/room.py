"""How many constraints and contacts robots of Playground's tasks have, by C MuJoCo and by Warp, on a CPU.

    python experiments/05_playground/room.py [TASK ...] [--robots 64] [--rows 300]

C MuJoCo steps the robots. Actions are an untrained policy's, tanh of normal numbers of std 0.7. A robot
starts anew where its base is upside down, or after 100 rows; in half of the starts it is dropped as it may
lie, which is more than what tasks of walking do. Then MuJoCo Warp counts again, in the states with the most
constraints and in the steps with the most contacts.

A line a task: the most constraints of a robot by C MuJoCo, by Warp, the task's `njmax` and ours
(dynappo/tasks/playground/room.py); the most contacts of a robot by Warp, in the mean of all robots in the
worst step, and the room a robot that the task and we have.
"""

import mujoco
import numpy as np
import warp as wp
from mujoco.mjx.third_party import mujoco_warp as mjw

from dynappo.tasks.playground import loading
from experiments import paper

AGE, STEPS, WORST = 100, 24, 512  # rows; steps and states in which Warp counts
HEAD = "task | constraints in C | in Warp | the task's njmax | ours | contacts | mean | the task's | ours"


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("tasks", nargs="*")
    parser.add_argument("--robots", type=int, default=64)
    parser.add_argument("--rows", type=int, default=300)
    args = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    print(f"| {HEAD} |\n|{'---|' * len(HEAD.split('|'))}")
    for name in args.tasks or loading.names():
        task = loading.load(name, worlds=loading.PLAYGROUND_ROBOTS).task
        own = loading.own_room(loading.made(name)[0])
        counts, states = stepped(task, args.robots, args.rows)
        worst = np.argsort(counts[..., 0].ravel())[-WORST:]
        rows, contacts = in_warp(task.mj_model, states.reshape(-1, states.shape[-1])[worst])
        fullest = np.argsort(counts[..., 1].mean(1))[-STEPS:]
        more, others = in_warp(task.mj_model, states[fullest].reshape(-1, states.shape[-1]))
        cells = [name, counts[..., 0].max(), max(rows.max(), more.max()), own[0]]
        cells += [task._config.njmax, max(contacts.max(), others.max())]
        cells += [f"{others.reshape(len(fullest), -1).mean(1).max():.1f}", f"{own[1]:g}"]
        cells += [f"{task._config.naconmax / loading.PLAYGROUND_ROBOTS:g}"]
        print(f"| {' | '.join(map(str, cells))} |", flush=True)


def stepped(task, robots, rows):
    """`([steps, robots, (constraints, contacts)], [steps, robots, qpos and qvel])` of physics steps."""
    model, draw = task.mj_model, np.random.default_rng(0)
    counts = np.zeros((rows * task.n_substeps, robots, 2), int)
    states = np.zeros((*counts.shape[:2], model.nq + model.nv), np.float32)
    data = mujoco.MjData(model)
    for robot in range(robots):
        for row in range(rows):
            if row % AGE == 0 or (data.xmat[1][8] < 0 and data.time > 1):
                start(task, data, draw)
            action = np.tanh(0.7 * draw.normal(size=model.nu))
            data.ctrl[:] = task._default_pose + task._config.action_scale * action
            for step in range(row * task.n_substeps, (row + 1) * task.n_substeps):
                states[step, robot] = *data.qpos, *data.qvel
                mujoco.mj_step(model, data)
                counts[step, robot] = data.nefc, data.ncon
    return counts, states


def start(task, data, draw):
    mujoco.mj_resetData(task.mj_model, data)
    data.qpos[:] = task._init_q
    data.qpos[:2] += draw.uniform(-0.5, 0.5, 2)
    data.qpos[7:] *= draw.uniform(0.5, 1.5, data.qpos[7:].shape)
    data.qvel[:6] = draw.uniform(-0.5, 0.5, 6)
    if draw.uniform() < 0.5:
        turned = draw.normal(size=4)
        data.qpos[3:7] = turned / np.linalg.norm(turned)


def in_warp(model, states):
    """`(constraints, contacts)` of each state."""
    n = len(states)
    with wp.ScopedDevice("cpu"):
        warp_model = mjw.put_model(model)
        data = mjw.make_data(model, nworld=n, naconmax=200 * n, njmax=800)
        data.qpos = wp.array(states[:, : model.nq].copy(), dtype=float)
        data.qvel = wp.array(states[:, model.nq :].copy(), dtype=float)
        for call in (mjw.kinematics, mjw.com_pos, mjw.camlight, mjw.crb):
            call(warp_model, data)
        mjw.collision(warp_model, data)
        mjw.make_constraint(warp_model, data)
        worlds = data.contact.worldid.numpy()[: data.nacon.numpy()[0]]
        return data.nefc.numpy(), np.bincount(worlds, minlength=n)


if __name__ == "__main__":
    main()
