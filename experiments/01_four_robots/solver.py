"""How many iterations MuJoCo's solver needs: errors of a physics step, of robots that walk and explore.

    python experiments/01_four_robots/solver.py go1 go2 anymal_c anymal_d

The policy NAME_deploy walks in C MuJoCo under commands of training, with noise of `STD` in its actions. Each
walk has a friction of its own, as in `deploy`, or all have 0.8. From every tenth state a physics step is made
with so many iterations, and with 200. Prints the error of the fastest joint or axis (rad/s, m/s): the share
of steps in which it is above 0.01, and its 99.9th percentile.
"""

import copy
import sys

import mujoco
import numpy as np

from dynappo.policy import episode, policy_file, policy_source
from dynappo.tasks.velocity import observe

WALKS, STEPS, EVERY, STD = 60, 100, 10, 0.3
ITERATIONS = 4, 6, 10


def main():
    for name in sys.argv[1:]:
        for told, friction in (("0.2 to 1.25", (0.2, 1.25)), ("0.8", (0.8, 0.8))):
            error = errors(name, friction)
            text = ", ".join(
                f"{k} iterations {100 * np.mean(e > 0.01):.2f} % {np.quantile(e, 0.999):.2g}"
                for k, e in zip(ITERATIONS, error.T, strict=True)
            )
            print(f"{name:9s} friction {told}: {text} ({len(error)} steps)", flush=True)


def errors(name: str, friction: tuple[float, float]) -> np.ndarray:
    """[S, iterations] of each physics step that was looked at."""
    policy = policy_source.load(f"{name}_deploy")[0]
    body = policy_source.player(policy)[0]
    act, rng = policy_file.actor(policy.params, policy.activation), np.random.default_rng(0)
    model, found = body.model, []
    feet = np.flatnonzero(body.foot_of >= 0)
    single, count = body._replace(substeps=1), 0
    ranges = np.array([policy.command_x, policy.command_y, policy.command_yaw])
    for _ in range(WALKS):
        model.geom_friction[feet, 0] = rng.uniform(*friction)
        data, command = mujoco.MjData(model), rng.uniform(*ranges.T)
        episode.reset(body, data)
        see = observe.memory(policy.observation, policy.history, policy.own)
        action = np.zeros(len(policy.joint_names))
        for _ in range(STEPS):
            action = act(see(episode.look(body, data, command, action)))
            action = action + STD * rng.normal(size=action.shape)
            for _ in range(body.substeps):
                before = copy.copy(data)
                episode.step(single, data, action)
                count += 1
                if count % EVERY == 0:
                    before.qfrc_applied[:], before.ctrl[:] = data.qfrc_applied, data.ctrl
                    found.append([_off(model, before, k) for k in ITERATIONS])
    return np.array(found)


def _off(model, before, iterations: int) -> float:
    """The largest error of a velocity after a physics step with so many iterations."""
    after = []
    for most in (iterations, 200):
        model.opt.iterations = most
        data = copy.copy(before)
        mujoco.mj_step(model, data)
        after.append(data.qvel)
    return float(abs(after[0] - after[1]).max())


if __name__ == "__main__":
    main()
