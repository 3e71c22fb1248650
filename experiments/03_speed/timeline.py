"""What the GPU does in an iteration: all kernels in order; pictures of a control step and of an iteration.

    python experiments/03_speed/timeline.py OUT.json [--config go1] [--set FIELD=VALUE ...] [--iteration 40]
    python experiments/03_speed/timeline.py OUT.png --draw BEFORE.json AFTER.json
    python experiments/03_speed/timeline.py OUT.json --whole ...
    python experiments/03_speed/timeline.py OUT.png --draw BEFORE.json AFTER.json ... --whole

The program that trains runs `--warm` iterations of a run's schedule, so that robots walk into the
ground and fall as they do then, and one more under JAX's profiler. OUT.json has its kernels: start and
length in us, name, whether it is physics (results/kernel/ keeps 3 ms of them); with `--whole` instead, for
each phase, its share of every 20 us in which the GPU computes ("busy"). A checkout of an older commit runs
this file, too, with its own folder first in PYTHONPATH.

XLA's command buffers (CUDA graphs) are off, because the profiler does not name the kernels in them. So gaps
between XLA's kernels are longer than in a run, several times as long as the kernels where the host is slow.
The picture of a whole iteration leaves gaps out.
"""

import collections
import json
import os
import re
import tempfile
import time
from pathlib import Path

os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_gpu_enable_command_buffer="

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo.program.build import program as build
from experiments import paper, pictures

BIN = 20.0  # us
PHASES = {  # name -> colour
    "physics": pictures.BLUE,
    "fit": pictures.ORANGE,
    "tail": pictures.VERMILION,
    "ppo": pictures.BLACK,
    "rest": pictures.GREY,
}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", default="go1")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--iteration", type=int, default=40)
    parser.add_argument("--warm", type=int, default=40)
    parser.add_argument("--draw", nargs="+", type=Path, metavar="JSON")
    parser.add_argument("--whole", action="store_true", help="a whole iteration, by phase")
    args = parser.parse_args()
    if args.draw:
        return draw_whole(args.out, args.draw) if args.whole else draw(args.out, *args.draw)
    name_phases()
    config = config_lib.load(args.config)
    for text in (*args.set, "run.log_every=1"):
        field, _, value = text.partition("=")
        config_lib.override(config, field, value)
    config = config_lib.validate(config)
    program = build(config)
    columns = {k: np.asarray(v) for k, v in program.columns.items()}

    def step(state, i):
        chunk = {name: jnp.asarray(column[i : i + 1]) for name, column in columns.items()}
        return jax.block_until_ready(program.step(program.hyper, state, chunk))[0]

    state = program.state
    for i in range(args.warm):
        state = step(state, i)
    times = []
    for _ in range(5):
        began = time.perf_counter()
        state = step(state, args.iteration)
        times.append((time.perf_counter() - began) * 1e3)
    with tempfile.TemporaryDirectory() as folder:
        with jax.profiler.trace(folder):
            state = step(state, args.iteration)
        found = events(folder)
    result = summary(found) | {
        "device": jax.devices()[0].device_kind,
        "config": args.config,
        "set": args.set,
        "iteration": args.iteration,
        "wall_ms": float(np.median(times)),
    }
    if args.whole:
        result["busy"] = busy(found, phases(program.step.args[0].as_text()))
        del result["events"], result["kernels"]
    args.out.write_text(json.dumps(result, indent=None if args.whole else 1) + "\n")
    print(
        json.dumps(
            {k: v for k, v in result.items() if k not in ("events", "kernels", "busy")}, indent=1
        )
    )


def name_phases() -> None:
    """XLA's operations get names that start with the phase; all that is in none is "rest"."""
    from dynappo import algorithm, rollout
    from dynappo.learner import ppo
    from dynappo.model import dynamics

    parts = (algorithm, "collect", "physics"), (rollout, "fill", "tail")
    for module, function, name in (*parts, (dynamics, "fit", "fit"), (ppo, "update", "ppo")):
        setattr(module, function, jax.named_scope(f"phase_{name}")(getattr(module, function)))


def phases(text: str) -> dict[str, str]:
    """`operation -> phase` of a compiled program: the outer one, because physics fills rows, too."""
    found = re.findall(r'%?([\w.\-]+) = [^\n]*op_name="([^"]*)"', text)
    inside = ((name, re.search(r"phase_(\w+)", label)) for name, label in found)
    return {name: phase[1] if phase else "rest" for name, phase in inside}


def busy(found, phase_of: dict[str, str]) -> dict[str, list[float]]:
    """Of each phase, its share of every `BIN` us of computing: kernels stand one behind the other.

    A kernel of an operation without a name belongs to the phase of the one before it.
    """
    ends = np.cumsum([took for _, took, *_ in found])
    bins = int(np.ceil(ends[-1] / BIN))
    shares, now = {}, "rest"
    for high, (_, took, _, operation) in zip(ends, found, strict=True):
        now = phase_of.get(operation, now)
        share, low = shares.setdefault(now, np.zeros(bins)), high - took
        for k in range(int(low / BIN), min(int(high / BIN), bins - 1) + 1):
            share[k] += max(0.0, min(high, (k + 1) * BIN) - max(low, k * BIN)) / BIN
    return {name: share.round(2).tolist() for name, share in shares.items()}


def events(folder):
    """`(start us, us, kernel, XLA's operation)` of everything on the GPU, in order."""
    path = sorted(Path(folder).rglob("*.xplane.pb"))[-1]
    data = jax.profiler.ProfileData.from_file(str(path))
    out = []
    for plane in data.planes:
        if "GPU" not in plane.name:
            continue
        for line in plane.lines:
            if not line.name.startswith("Stream"):
                continue
            for e in line.events:
                stats = dict(e.stats)
                out.append(
                    (
                        e.start_ns / 1e3,
                        e.duration_ns / 1e3,
                        e.name,
                        str(stats.get("hlo_op", "")),
                    )
                )
    return sorted(out)


def summary(found):
    first = found[0][0]
    by = collections.defaultdict(lambda: [0, 0.0])
    end, idle = first, 0.0
    for start, took, name, *_ in found:
        row = by[name.split("_kernel_forward")[0][:80]]
        row[0] += 1
        row[1] += took
        if start > end:
            idle += start - end
        end = max(end, start + took)
    top = sorted(by.items(), key=lambda kv: -kv[1][1])
    return {
        "span_ms": (end - first) / 1e3,
        "idle_ms": idle / 1e3,
        "launches": len(found),
        "kernels": [[n, c, round(us, 1)] for n, (c, us) in top],
        "events": [
            [round(start - first, 1), round(took, 1), name[:70], "ffi_call" in op]
            for start, took, name, op in found
        ],
    }


def draw(out: Path, before: Path, after: Path):
    """3 ms of both from a control step on: a bar a kernel, physics above, the rest below."""
    figure, axes = pictures.figure(2, 1, 2.8, sharex=True)
    for axis, path, name in zip(axes.flat, (before, after), ("before", "after"), strict=True):
        events = json.loads(path.read_text())["events"]
        for physics, y in ((True, 1), (False, 0)):
            bars = [
                (start / 1e3, took / 1e3)
                for start, took, _, is_physics in events
                if is_physics == physics
            ]
            axis.broken_barh(
                bars, (y, 0.8), color=pictures.BLUE if physics else pictures.GREY, linewidth=0
            )
        axis.set(
            yticks=(0.4, 1.4), yticklabels=("the rest", "physics"), title=name, xlim=(-0.4, 2.6)
        )
    axes.flat[-1].set_xlabel("ms")
    pictures.save(figure, out)


def draw_whole(out: Path, paths: list[Path]) -> None:
    """An iteration each, a line a phase: as high as its share of the time."""
    runs = [json.loads(path.read_text()) for path in paths]
    figure, axes = pictures.figure(len(runs), 1, 1.5 * len(runs) + 0.4, sharex=True)
    for axis, path, run in zip(axes.flat, paths, runs, strict=True):
        for foot, (name, colour) in enumerate(PHASES.items(), 1):
            share = np.array(run["busy"].get(name, [0.0]))
            at = np.arange(len(share)) * BIN / 1e3
            axis.fill_between(at, foot, foot - 0.85 * share, color=colour, lw=0, step="post")
        ms = sum(map(sum, run["busy"].values())) * BIN / 1e3
        labels = [name.replace("ppo", "PPO") for name in PHASES]
        axis.set(yticks=np.arange(len(PHASES)) + 0.6, yticklabels=labels, ylim=(len(PHASES), 0))
        name = path.stem.rpartition("_")[2]  # of its commit
        axis.set_title(f"{name}: {ms:.1f} ms in {run['launches']:,} kernels", loc="left")
    axes.flat[-1].set_xlabel("ms of computing, gaps left out")
    pictures.save(figure, out.with_suffix(""))


if __name__ == "__main__":
    main()
