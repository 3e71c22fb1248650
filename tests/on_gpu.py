"""What CI cannot test, because it has no GPU: on a machine with an NVIDIA GPU, in eight minutes.

    python tests/on_gpu.py                      # writes tests/on_gpu.json: the last run, to be committed
    python tests/on_gpu.py --out=FILE.json --only=kernel,speed
    python tests/on_gpu.py --device=cpu         # tries this script itself, tiny; no number means anything

It is run before a release, and after any change of physics. It needs this checkout, dynappo's packages
(JAX with CUDA, warp-lang) and pytest, no plugin and no network.

Each step is a process or several, as a user starts them: one that fails, crashes or hangs does not stop
the others, and none holds the GPU's memory while another runs. Exit status 1 if a step failed, 2 if
there is no GPU. This process imports no JAX, which would take the GPU's memory.

- `kernel`: the tests of our kernel and of MuJoCo Warp, on the GPU (tests/conftest.py makes sure of it)
- `walks`: two seeds of `go1:best` at once, evaluated every 10 iterations; passes if each is once at its
  level with falls in at most 1 % of 1000 episodes, and says when each walks (policy/walks.py). Not if each
  walks to the end: that rests on the worst of thirty evaluations, and one seed in ten gets there later
- `resume`: a run resumed at half of its way against the run in one go, from the same checkpoint; and a
  run killed -9 that goes on
- `processes`: a run of two processes against the same run of one; on two GPUs, or on the CPU if there is one
- `speed`: ms of an iteration with a tail and without, by `dynappo bench`
"""

from __future__ import annotations

import argparse
import csv
import datetime
import json
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))  # this checkout, whatever is installed

from dynappo import config as config_lib  # noqa: E402
from dynappo.config import ConfigError, files, flags, versions  # noqa: E402
from dynappo.policy import checkpoint_file  # noqa: E402
from dynappo.policy import walks as walks_lib  # noqa: E402
from experiments import stats  # noqa: E402

COMMITTED = ROOT / "tests" / "on_gpu.json"
PACKAGES = (
    "jax jaxlib jax-cuda13-plugin jax-cuda12-plugin warp-lang mujoco mujoco-mjx numpy flax optax "
    "orbax-checkpoint pytest"
).split()
HALF = 20  # iterations of a run that is then resumed
# relative, of an iteration from the same checkpoint: a state that is lost or mixed up changes these by
# more. On a CPU they are the same to the bit (docs/runs.md); on a GPU sums have no fixed order
CLOSE = {"episode_return": 0.05, "policy_std": 0.01, "value_loss": 0.2, "model_loss": 0.2}
# of the first iteration; of two processes within 2 %
LEARNT = ("policy_std", "value_loss", "model_loss")
QUIET = (
    "run.eval_envs=0 run.video_seconds=0.0 run.tensorboard=False run.log_every=10 "
    "run.checkpoint_every=0"
).split()
SMALL = (
    "rollout.num_envs=32 model.hidden=(16,) model.epochs=2 ppo.hidden=(16,) ppo.precision=highest "
    "model.precision=highest physics.impl=c physics.threads=1 run.device=cpu"
).split()


class Size(NamedTuple):
    """What a machine with a GPU runs, or the smoke run of this script on a CPU."""

    fields: list[str]  # of every run but that of two processes
    tests: list[str]  # of pytest
    iterations: int  # of `walks`
    episodes: int  # of each of its evaluations
    repeats: int  # of `speed`
    reach: bool  # whether the two seeds must reach their level


WARP = [
    f"tests/physics/test_{name}.py"
    for name in ("quadruped_kernel", "tree_kernel", "kernel_scope", "rough_ground")
]
# of robots with other feet one, and not MJX, which a GPU compiles for half a minute
SHORT = [
    "-m",
    "not fuzz",
    "-k",
    "not (mjx or (other_engines or there_is_room) and (jax or capsules or mixed or hexapod))",
]
SIZES = {
    "gpu": Size(
        ["run.device=gpu", "physics.impl=warp"],
        [*WARP, "tests/physics/test_warp_call.py", "tests/description/test_feet.py", *SHORT],
        300,
        1000,
        5,
        True,
    ),
    "cpu": Size(SMALL, [WARP[0], "-k", "a_physics_step and go1"], 20, 4, 1, False),
}


class Failed(Exception):
    """A step that has failed, in one line."""


class Place(NamedTuple):
    """Where a step works, and how long it may."""

    device: str  # "gpu" or "cpu"
    gpus: list[str]  # those that CUDA may use, as CUDA_VISIBLE_DEVICES names them
    folder: Path  # of its own, empty
    deadline: float  # of time.monotonic()

    @property
    def size(self) -> Size:
        return SIZES[self.device]


# --- steps: each returns a few numbers, or raises ---


def kernel(place: Place) -> dict[str, Any]:
    """The tests of Warp, with what users have of XLA; all must pass."""
    if not find_spec("pytest"):
        raise Failed("pytest is not installed; pip install pytest (pytest, pluggy and iniconfig)")
    report = place.folder / "report.xml"
    command = ["-m", "pytest", "-vv", "--tb=short", "-p", "no:cacheprovider"]
    command += [f"--junitxml={report}", *place.size.tests]
    process = start(
        place,
        "pytest",
        command,
        DYNAPPO_TEST_DEVICE=place.device,
        CUDA_VISIBLE_DEVICES=",".join(place.gpus[:1]),
    )
    status = wait(process, place, "pytest", okay=(0, 1))
    suite = ElementTree.parse(report).getroot().find("testsuite")
    assert suite is not None
    counts = {n: int(suite.get(n, 0)) for n in ("tests", "failures", "errors", "skipped")}
    bad = counts["failures"] + counts["errors"]
    found = {"passed": counts["tests"] - bad - counts["skipped"], "skipped": counts["skipped"]}
    if status or bad or not found["passed"]:
        broken = [
            c.get("name", "") for c in suite.iter("testcase") if c.find("failure") is not None
        ]
        show(place, "pytest", 60)
        raise Failed(f"{bad} of {counts['tests']} tests failed: {', '.join(broken[:8])}")
    return found


def walks(place: Place) -> dict[str, Any]:
    """Two seeds of `best`: simulator steps and seconds until each is at its level, and until it walks."""
    size, workdir = place.size, place.folder / "run"
    fields = [*QUIET, *size.fields, "run.num_seeds=2", f"run.num_iterations={size.iterations}"]
    fields += ["run.eval_every=10", f"run.eval_envs={size.episodes}"]
    train(place, workdir, *fields)
    rows = table(workdir)
    weights = config_lib.load("configs/go1.py:best").task.weights
    numbers = {
        n: np.array([[r[n] for r in rows if r["seed"] == s] for s in (0, 1)]).T for n in NUMBERS
    }
    evaluated = np.isfinite(numbers["eval_return"]).all(1)
    steps, seconds, returns, falls = (numbers[n][evaluated] for n in NUMBERS)
    if len(returns) != size.iterations // 10:
        raise Failed(f"{len(returns)} evaluations, expected {size.iterations // 10}")
    least = walks_lib.level(walks_lib.best(weights))
    found: dict[str, Any] = {"level": round(least, 2), "evaluations": len(returns)}
    for unit, of, scale in (("m_steps", steps, 1e-6), ("seconds", seconds, 1)):
        reached = stats.reached(of * scale, returns, falls, least)
        found |= {f"{name}_{unit}": listed(values) for name, values in reached._asdict().items()}
    found |= {"return": listed(returns[-1]), "fall_rate": listed(falls[-1], 4)}
    if size.reach and None in found["careful_m_steps"]:
        raise Failed(
            f"not every seed is at {least:g} with falls in at most 1 %: {json.dumps(found)}"
        )
    return found


NUMBERS = "sim_steps", "seconds", "eval_return", "eval_fall_rate"


def resume(place: Place) -> dict[str, Any]:
    """In one go against from the middle on; and after a kill -9."""
    whole, half, killed = (place.folder / name for name in ("whole", "half", "killed"))
    fields = [*QUIET, *place.size.fields, f"run.checkpoint_every={HALF}"]
    end = f"run.num_iterations={2 * HALF}"
    train(place, whole, *fields, end)
    shutil.copytree(whole, half)
    shutil.rmtree(half / "checkpoints" / str(2 * HALF))
    expect(f"goes on from iteration {HALF} of", train(place, half, *fields, end))
    found = same(table(half), table(whole), exact=place.device == "cpu")

    process = start(place, "killed", train_command(killed, *fields, "run.num_iterations=100000"))
    try:
        while not saved(killed):
            if process.poll() is not None or time.monotonic() > place.deadline:
                show(place, "killed")
                raise Failed("the run that was to be killed saved no checkpoint")
            time.sleep(0.02)
    finally:
        stop(process)
    done = max(saved(killed))
    lost = max(row["iteration"] for row in table(killed)) - done
    said = train(place, killed, *fields, f"run.num_iterations={done + HALF}")
    expect(f"goes on from iteration {done} of", said)
    # the rows of the last chunk before a kill -9 may be lost (a line says so), the iterations are not
    rows = counted(table(killed), done + HALF, since=done)
    empty = sum(np.isnan(row["value_loss"]) for row in rows)
    found |= {"killed_after": done, "lost_iterations": max(0, int(lost)), "empty_rows": int(empty)}
    return found


def processes(place: Place) -> dict[str, Any]:
    """The robots of a seed over two processes against all in one; `mesh_env` is 2 and 1."""
    on_gpus = place.device == "gpu" and len(place.gpus) > 1
    fields = [*QUIET, "run.num_iterations=10", *(place.size.fields if on_gpus else SMALL)]
    train(place, place.folder / "one", *fields)
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        meet = f"--coordinator=127.0.0.1:{s.getsockname()[1]}"
    command = train_command(place.folder / "two", *fields, "run.mesh_env=2")
    started = []
    for i in range(2):
        own = {"CUDA_VISIBLE_DEVICES": place.gpus[i]} if on_gpus else {}
        more = [meet, "--processes=2", f"--process={i}"]
        started.append(start(place, f"process{i}", command + more, **own))
    try:
        for i, process in enumerate(started):
            wait(process, place, f"process{i}")
    finally:
        for process in started:
            stop(process)
    one, two = (counted(table(place.folder / name), 10) for name in ("one", "two"))
    apart = {n: relative(two[0][n], one[0][n]) for n in LEARNT}
    if not all(value < 0.02 for value in apart.values()):  # NaN is not
        raise Failed(f"two processes compute something else than one: {apart}")
    return {"on": "2 GPUs" if on_gpus else "CPU", "apart": float(f"{max(apart.values()):.2g}")}


def speed(place: Place) -> dict[str, Any]:
    """ms of an iteration of `best`: its last ones are physics alone; with a tail that does not end."""
    found: dict[str, Any] = {}
    horizon = config_lib.load("configs/go1.py:best").run.num_iterations
    for name, fields in (
        ("without_tail", []),
        ("with_tail", [f"schedule.last_iteration={horizon}"]),
    ):
        out = place.folder / f"{name}.json"
        command = ["-m", "dynappo.bench", "--config=go1:best", f"--repeats={place.size.repeats}"]
        command += [f"--out={out}", *map(flag, [*place.size.fields, *fields])]
        wait(start(place, name, command), place, name)
        (report,) = json.loads(out.read_text())["configs"].values()
        found[f"{name}_ms"] = round(report["ms"]["iteration"], 2)
        found[f"{name}_setup_s"] = round(report["setup_seconds"], 1)
        found |= {"engine": report["impl"], "device": report["device"]}
    return found


# step, and the seconds after which it is ended on a GPU; together below ten minutes
STEPS = {kernel: 360, walks: 70, resume: 80, processes: 40, speed: 50}
SLOW = 1200  # s, of each on a CPU that may have much else to do


# --- what they are made of ---


def flag(field: str) -> str:
    return f"--config.{field}"


def train_command(workdir: Path, *fields: str) -> list[str]:
    """Arguments of Python that train `go1:best` with these fields; the last of two of a name holds."""
    last = {field.partition("=")[0]: field for field in fields}
    return [
        "-m",
        "dynappo.train",
        "--config=go1:best",
        f"--workdir={workdir}",
        *map(flag, last.values()),
    ]


def train(place: Place, workdir: Path, *fields: str) -> str:
    """Train to the end; what the command has said."""
    name = f"train_{len(list(place.folder.glob('*.txt')))}"
    wait(start(place, name, train_command(workdir, *fields)), place, name)
    return (place.folder / f"{name}.txt").read_text()


def start(place: Place, name: str, arguments, **variables: str) -> subprocess.Popen:
    """Python with these arguments in this checkout; what it says goes into NAME.txt."""
    path = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    environment = os.environ | {"PYTHONPATH": path} | variables
    with (place.folder / f"{name}.txt").open("w") as said:
        return subprocess.Popen(
            [sys.executable, *map(str, arguments)],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=subprocess.STDOUT,
        )


def wait(process: subprocess.Popen, place: Place, name: str, okay=(0,)) -> int:
    """Its exit status, one of `okay`; the step has failed if it is another, or comes too late."""
    try:
        status = process.wait(max(0.0, place.deadline - time.monotonic()))
    except subprocess.TimeoutExpired:
        status = None
    finally:
        stop(process)
    if status not in okay:
        show(place, name)
        raise Failed(
            f"{name} {'took too long' if status is None else f'ended with status {status}'}"
        )
    return status


def stop(process: subprocess.Popen) -> None:
    """kill -9, if it still runs."""
    process.kill()
    process.wait()


def show(place: Place, name: str, lines: int = 15) -> None:
    """The end of what a process has said."""
    text = (place.folder / f"{name}.txt").read_text(errors="replace").splitlines()
    print("\n".join(f"    {line}" for line in text[-lines:]), flush=True)


def expect(words: str, said: str) -> None:
    if words not in said:
        raise Failed(f"a resumed run did not say {words!r}")


def saved(workdir: Path) -> list[int]:
    """Iterations of the checkpoints that are complete."""
    return checkpoint_file.iterations(workdir / "checkpoints")


def table(workdir: Path) -> list[dict[str, float]]:
    """The rows of metrics.csv; an empty cell is NaN."""
    with (workdir / "metrics.csv").open(newline="") as file:
        return [{n: float(v or "nan") for n, v in row.items()} for row in csv.DictReader(file)]


def counted(rows: list[dict[str, float]], iterations: int, since=0) -> list[dict[str, float]]:
    """`rows`, if there is one for each iteration, and those behind `since` have finite losses."""
    if [row["iteration"] for row in rows] != [*range(1, iterations + 1)]:
        raise Failed(f"metrics.csv has not one row for each of {iterations} iterations")
    if not np.isfinite([[row[name] for name in LEARNT] for row in rows[since:]]).all():
        raise Failed("metrics.csv has numbers that are not finite")
    return rows


def relative(one: float, other: float) -> float:
    return abs(one - other) / max(abs(other), 1e-12)


def same(half, whole, *, exact: bool) -> dict[str, Any]:
    """A run resumed at `HALF` against one that never stopped: the same bits, or close after one iteration."""
    counted(half, 2 * HALF), counted(whole, 2 * HALF)
    names = [name for name in whole[0] if name != "seconds"]
    rows = [[[row[name] for name in names] for row in run] for run in (half, whole)]
    before, after = (
        np.array_equal(*(run[part] for run in map(np.array, rows)), equal_nan=True)
        for part in (slice(0, HALF), slice(HALF, None))
    )
    if not before or (exact and not after):
        raise Failed(
            f"the rows {'after' if before else 'before'} iteration {HALF} are not the same"
        )
    apart = {name: relative(half[HALF][name], whole[HALF][name]) for name in CLOSE}
    if not all(apart[name] <= most for name, most in CLOSE.items()):  # NaN is not
        raise Failed(f"iteration {HALF + 1} of a resumed run is another: {apart}")
    return {"same_bits": after, "apart": float(f"{max(apart.values()):.2g}")}


def listed(values, digits: int = 2) -> list[float | None]:
    """A number a seed; None: never."""
    return [round(float(v), digits) if np.isfinite(v) else None for v in values]


# --- the whole ---


def graphics() -> list[list[str]]:
    """`[name, driver, memory]` of each NVIDIA GPU; none where there is no driver."""
    command = [
        "nvidia-smi",
        "--query-gpu=name,driver_version,memory.total",
        "--format=csv,noheader",
    ]
    try:
        text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        return []
    return [line.split(", ") for line in text.splitlines() if line.strip()]


def about(device: str, gpus, commit: str | None) -> dict[str, Any]:
    """When, where and with what."""
    pins = (ROOT / "constraints.txt").read_text()
    found = {name: versions.of(name) for name in PACKAGES}
    return {
        "date": f"{datetime.date.today()}",
        "commit": commit or versions.commit(),
        "smoke": device == "cpu",  # a run that only tries the script
        "gpus": gpus if device == "gpu" else [],
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "versions": {"python": platform.python_version()}
        | {name: version for name, version in found.items() if version != "unknown"},
        "jax_of_ci": re.findall(r"^jax==(\S+)", pins, re.M)[0],
    }


def take(step, device: str, visible: list[str]) -> dict[str, Any]:
    """Do a step, whatever happens in it: `ok`, its seconds and numbers, or what has failed."""
    print(f"{step.__name__} ...", flush=True)
    began = time.monotonic()
    most = STEPS[step] if device == "gpu" else SLOW
    with tempfile.TemporaryDirectory(prefix="on_gpu-") as folder:
        try:
            found = step(Place(device, visible, Path(folder), began + most))
            result = {"ok": True} | found
        except Exception as error:
            kind = "" if isinstance(error, Failed) else f"{type(error).__name__}: "
            result = {"ok": False, "failed": f"{kind}{error}"}
    return result | {"took_s": round(time.monotonic() - began, 1)}


def parse(argv: list[str] | None):
    """`(device, names of steps, file or None, commit or None)`."""
    parser = argparse.ArgumentParser(
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        exit_on_error=False,
    )
    names = [step.__name__ for step in STEPS]
    parser.add_argument("--device", choices=["gpu", "cpu"], default="gpu", help="cpu: tiny")
    parser.add_argument(
        "--out", type=flags.path, metavar="FILE.json", help="default: tests/on_gpu.json"
    )
    parser.add_argument("--only", metavar="STEP,STEP", help=f"of {', '.join(names)}; needs --out")
    parser.add_argument("--commit", help="of this checkout, where it came without .git")
    known, rest = flags.read_known(parser, argv)
    if rest:
        raise ConfigError(f"{rest[0]}: no such flag; expected --device, --out, --only or --commit")
    steps = known.only.split(",") if known.only else names
    if unknown := [name for name in steps if name not in names]:
        raise ConfigError(f"--only: no step is called {unknown[0]!r}; expected {', '.join(names)}")
    whole = known.device == "gpu" and not known.only
    out = known.out or (COMMITTED if whole else None)
    if out and not whole and out.resolve() == COMMITTED:
        raise ConfigError(f"--out={out} is for whole runs on a GPU; name another file")
    if out:
        flags.check_writable(out)
    return known.device, steps, out, known.commit


def run(argv: list[str] | None) -> bool:
    """Take the steps, show and write what came out; whether all went well."""
    device, names, out, commit = parse(argv)
    gpus = graphics()
    if device == "gpu" and not gpus:
        raise ConfigError("nvidia-smi shows no NVIDIA GPU; --device=cpu only tries this script")
    given = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    visible = given.split(",") if given else [str(i) for i in range(len(gpus))]
    result: dict[str, Any] = about(device, gpus, commit)
    result["steps"] = {s.__name__: take(s, device, visible) for s in STEPS if s.__name__ in names}
    show_all(result)
    if out:
        files.write_json(out, result)
        print(out)
    return all(step["ok"] for step in result["steps"].values())


def show_all(result: dict[str, Any]) -> None:
    """The table."""
    where = ", ".join(dict.fromkeys(gpu[0] for gpu in result["gpus"])) or "CPU"
    known = ", ".join(f"{n} {v}" for n, v in result["versions"].items() if n in SHOWN)
    smoke = "; a smoke run, which measures nothing" if result["smoke"] else ""
    print(f"\n{result['date']}, {result['commit']}, {where}: {known}{smoke}")
    for name, step in result["steps"].items():
        numbers = {k: v for k, v in step.items() if k not in ("ok", "took_s", "failed")}
        text = step.get("failed") or ", ".join(f"{k} {v}" for k, v in numbers.items())
        print(f"{name:10s} {'ok' if step['ok'] else 'FAILED':6s} {step['took_s']:6.1f} s  {text}")


SHOWN = ("python", "jax", "warp-lang", "mujoco")


def main(argv: list[str] | None = None) -> None:
    """Exit statuses: module docstring."""
    well = []
    flags.answer(lambda: well.append(run(argv)))
    if well == [False]:
        sys.exit(1)


if __name__ == "__main__":
    main()
