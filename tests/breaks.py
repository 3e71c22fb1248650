"""Breaks the code on purpose, one place at a time, and sees whether a test fails.

    python tests/breaks.py              # all, on two processes: ten minutes on two cores
    python tests/breaks.py 3 17         # these of BREAKS, by their place

Each break is put into a copy of the checkout, in a temporary folder, and the named tests run there. A line
says which test failed first; "missed" is a break that no named test saw. Exit status 1 if one was missed
or a text to be replaced is gone from its file. Run it before and after a large change of the house.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

ROOT = Path(__file__).parents[1]
VELOCITY = "dynappo/tasks/velocity"
BREAKS = (  # file, text, what it becomes, tests that must see it
    # the method
    ("dynappo/learner/gae.py", "discount * (1 - truncation)", "discount", "learner/test_gae.py"),
    (
        "dynappo/learner/ppo.py",
        "jnp.maximum(error, here(batch",
        "jnp.minimum(error, here(batch",
        "learner/test_ppo.py",
    ),
    (
        "dynappo/learner/ppo.py",
        "hyper.ppo.desired_kl / 2)",
        "hyper.ppo.desired_kl)",
        "learner/test_ppo.py",
    ),
    ("dynappo/learner/symmetry.py", "(grad + other) / 2", "grad", "learner/test_symmetry.py"),
    (
        "dynappo/model/dynamics.py",
        "place < epochs * count)",
        "place < epochs * length)",
        "model/test_dynamics.py",
    ),
    (
        "dynappo/model/dynamics.py",
        "prop = prop + obs[..., :size]",
        "prop = prop",
        "model/test_dynamics.py",
    ),
    (
        "dynappo/model/dynamics.py",
        "1 - jax.nn.sigmoid(",
        "jax.nn.sigmoid(",
        "model/test_options.py",
    ),
    (
        "dynappo/algorithm.py",
        "jnp.where, k == 0), last, drawn",
        "jnp.where, k == 0), drawn, last",
        "test_algorithm.py",
    ),
    ("dynappo/algorithm.py", "key=key(ANCHOR, k)", "key=key(ROWS, k)", "test_random_numbers.py"),
    (
        "dynappo/schedule.py",
        "np.where(tail > 0, config.schedule.rounds, 1)",
        "np.full_like(tail, config.schedule.rounds)",
        "test_schedule.py",
    ),
    ("dynappo/fast.py", "sign * grads[index]", "grads[index]", "test_fast.py"),
    # the task and physics
    (
        "dynappo/physics/actuators.py",
        "saturation_effort * (-1 - slope)",
        "saturation_effort * (-1 + slope)",
        "physics/test_actuators.py",
    ),
    (
        f"{VELOCITY}/env.py",
        "coin < 1 - hyper.task.start_anew",
        "coin > 1 - hyper.task.start_anew",
        "tasks/test_draws.py",
    ),
    (
        f"{VELOCITY}/env.py",
        "older_action=state.last_action",
        "older_action=action",
        "tasks/test_env.py",
    ),
    (
        f"{VELOCITY}/rewards.py",
        "off = foot_height - foot_height.min() - ",
        "off = foot_height - ",
        "tasks/test_biped.py",
    ),
    (f"{VELOCITY}/gait.py", "cos * c - sin * s]", "cos * c + sin * s]", "tasks/test_gait.py"),
    (
        "dynappo/physics/warp/tree.h",
        "way = vec3(more[0] / flat, more[1] / flat, 0.0f)",
        "way = vec3(1.0f, 0.0f, 0.0f)",
        "physics/test_tree_kernel.py",
    ),
    (
        "dynappo/physics/warp/tree.h",
        "S.H[own][k] * S.inverse[k] * S.H[c][k];",
        "S.H[own][k] * S.H[c][k];",
        "physics/test_tree_kernel.py",
    ),
    # robots
    (
        "dynappo/description/contacts.py",
        "round_end = np.isin(kind, (SPHERE, CAPSULE))",
        "round_end = np.isin(kind, (SPHERE,))",
        "description/test_robot.py description/test_feet.py",
    ),
    (
        "dynappo/description/motors.py",
        "mujoco.mj_setConst(model, mujoco.MjData(model))",
        "pass",
        "description/test_motors.py",
    ),
    (
        "dynappo/adopt/gains.py",
        "STIFFEST_SERVO = 3.0, 0.45",
        "STIFFEST_SERVO = 3.0, 0.045",
        "adopt/test_gains.py",
    ),
    # a policy, and what is said of it
    (
        "experiments/stats.py",
        "np.logical_and.accumulate(holding[::-1])[::-1]",
        "holding",
        "results/test_statistics.py",
    ),
    (
        "dynappo/policy/policy_file.py",
        "if version not in READ:",
        "if False:",
        "policy/test_policy_file.py",
    ),
    (
        "dynappo/export/deploy_yaml.py",
        "1 / float(np.mean(policy.gait_frequency))",
        "float(np.mean(policy.gait_frequency))",
        "tasks/test_gait.py",
    ),
    (
        "dynappo/evaluate/stress.py",
        "+= stress.push * np",
        "+= 2 * stress.push * np",
        "evaluate/test_stress.py",
    ),
    (
        "dynappo/model/dynamics.py",
        "mean - bound * std, mean + bound * std",
        "mean - 2 * bound * std, mean + bound * std",
        "model/test_dynamics.py",
    ),
    # tasks of others
    (
        "dynappo/tasks/playground/known.py",
        "+ prop[layout.prop_size - 1])",
        ")",
        "tasks/test_playground_known.py",
    ),
    # a run
    ("dynappo/run/log.py", "{float(value):.6g}", "{float(value):.2g}", "run/test_log.py"),
    (
        "dynappo/sweeps/table.py",
        "float(values.mean())",
        "float(values.max())",
        "sweeps/test_table.py",
    ),
)


def main():
    chosen = [int(place) for place in sys.argv[1:]] or range(len(BREAKS))
    gone = [path for path, text, *_ in BREAKS if text not in (ROOT / path).read_text()]
    if gone:
        sys.exit(f"a text that is to be broken is gone from {', '.join(gone)}")
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        copies = [copied(Path(folder) / str(i)) for i in range(2)]

        def one(place):
            copy = copies.pop()
            try:
                seen = broken(copy, *BREAKS[place])
            finally:
                copies.append(copy)
            path, text, *_ = BREAKS[place]
            print(f"{place:2d}  {path}: {text[:40]!r}: {seen or 'missed'}", flush=True)
            return seen

        missed = [*pool.map(one, chosen)].count(None)
    print(f"{len(chosen) - missed} of {len(chosen)} breaks were seen")
    sys.exit(bool(missed))


def copied(folder: Path) -> Path:
    """A copy of the files that git knows."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True)
    for name in filter(None, listed.stdout.decode().split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    return folder


def broken(folder: Path, path: str, text: str, instead: str, tests: str) -> str | None:
    """The first test that fails where `text` is `instead`; None if all pass."""
    file = folder / path
    whole = file.read_text()
    file.write_text(whole.replace(text, instead, 1))
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider"]
    command += [f"tests/{name}" for name in tests.split()]
    env = os.environ | {"PYTHONPATH": str(folder), "PYTHONDONTWRITEBYTECODE": "1"}
    try:
        done = subprocess.run(command, cwd=folder, env=env, capture_output=True, text=True)
    finally:
        file.write_text(whole)
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    if failed:
        return failed[0].split(" - ")[0][:110]
    if done.returncode:  # no test was run: a wrong path, for example
        sys.exit(
            f"{path}: pytest ends with {done.returncode}: {done.stdout[-300:]}{done.stderr[-300:]}"
        )
    return None


if __name__ == "__main__":
    main()
