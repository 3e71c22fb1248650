"""How a biped walks under single commands: feet, arms, torso, motors, and what it does when told to stand.

    python experiments/25_humanoid/gait.py OUT.csv RUN.npz ...

A row a policy and command of 8 s in C MuJoCo, the first second left out; the measures of
`dynappo/evaluate/trials.py` and `foot_motion.py`, and of the robot's arms and torso:

- `torso_tilt` (rad): mean angle of the torso from upright
- `arm_swing` (rad): half of the range, 5 to 95 %, of the shoulders' pitch, mean of both
- `arm_phase`: correlation of a shoulder's pitch with that of the hip on the other side: 1 as people walk
- `arm_spread` (m): how far the hands are outside of the shoulders, mean
- `step_width` (m): the left foot is so far to the left of the right one, mean; `step_width_least`: 1 %
- `drift` (m/s): distance from first to last place over the time, when told to stand
- `knee` (rad): mean angle of the knees, 0 is straight
"""

import csv
import sys
from pathlib import Path

import mujoco
import numpy as np

from dynappo.evaluate import trials
from dynappo.policy import episode, policy_file, policy_source

SECONDS = 8.0
COMMANDS = {
    "stand": (0, 0, 0),
    "0.5 ahead": (0.5, 0, 0),
    "1 ahead": (1, 0, 0),
    "0.5 back": (-0.5, 0, 0),
    "0.3 left": (0, 0.3, 0),
    "0.3 right": (0, -0.3, 0),
    "turn 0.5": (0, 0, 0.5),
    "turn -0.5": (0, 0, -0.5),
    "turn 1": (0, 0, 1),
    "turn -1": (0, 0, -1),
    "0.5 and turn 0.5": (0.5, 0, 0.5),
}


def main():
    out, *names = sys.argv[1:]
    rows = []
    for name in names:
        policy = policy_file.load(Path(name))
        body = policy_source.player(policy)[0]
        act = policy_file.actor(policy.params, policy.activation)
        for label, command in COMMANDS.items():
            recording = trials.record(body, act, command, SECONDS)
            row = trials.measures(body, [recording]) | trials.gait(body, [recording])
            row.pop("feet")
            row |= limbs(body, trials.measured_rows(body, recording)["qpos"])
            rows.append(
                {"policy": Path(name).stem, "asked": label, "fall": recording["fall"]} | row
            )
        print(name, flush=True)
    with open(out, "w", newline="") as file:
        writer = csv.DictWriter(file, [*rows[0]])
        writer.writeheader()
        for row in rows:
            writer.writerow({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()})


def limbs(body: episode.Player, qpos) -> dict[str, float]:
    """The measures of arms, torso and knees."""
    model, data = body.model, mujoco.MjData(body.model)
    joint = dict(zip(body.policy.joint_names, body.joint_q, strict=True))
    places = []
    for q in qpos:
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        turn = data.xmat[body.base_body].reshape(3, 3)
        ahead = turn[:2, 0] / np.linalg.norm(turn[:2, 0])
        left = np.array([-ahead[1], ahead[0], 0])
        y = {name: data.body(f"{name}_link").xpos @ left for name in BODIES}
        tilt = np.arccos(np.clip(data.body("torso_link").xmat[8], -1, 1))
        spread = y["left_wrist_yaw"] - y["left_shoulder_pitch"]
        spread += y["right_shoulder_pitch"] - y["right_wrist_yaw"]
        places.append([tilt, spread / 2, y["left_ankle_roll"] - y["right_ankle_roll"]])
    tilt, spread, width = np.array(places).T

    def angle(name):
        return qpos[:, joint[f"{name}_joint"]]

    swings, phases = [], []
    for side, other in (("left", "right"), ("right", "left")):
        arm, hip = angle(f"{side}_shoulder_pitch"), angle(f"{other}_hip_pitch")
        swings.append(np.diff(np.quantile(arm, [0.05, 0.95]))[0] / 2)
        phases.append(np.corrcoef(arm, hip)[0, 1])
    way = np.linalg.norm(qpos[-1, :2] - qpos[0, :2])
    return {
        "torso_tilt": float(tilt.mean()),
        "arm_swing": float(np.mean(swings)),
        "arm_phase": float(np.mean(phases)),
        "arm_spread": float(spread.mean()),
        "step_width": float(width.mean()),
        "step_width_least": float(np.quantile(width, 0.01)),
        "drift": float(way / (len(qpos) * episode.period(body))),
        "knee": float(np.mean([angle("left_knee"), angle("right_knee")])),
    }


BODIES = [
    f"{side}_{part}"
    for side in ("left", "right")
    for part in ("wrist_yaw", "shoulder_pitch", "ankle_roll")
]

if __name__ == "__main__":
    main()
