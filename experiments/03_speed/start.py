"""Seconds from the command to the first iteration, by phase, with less and less left to build.

    python experiments/03_speed/start.py OUT.json [--config configs/go1.py:ppo16] [--cases warm ...]

`cold`: neither JAX's compiled programs nor Warp's kernels are there. `primed`: Warp's kernels are (it
builds them once for a version of dynappo's kernel). `warm`: both are, as from the second run on. Each
case is a `dynappo train` in a process of its own, which notes when the main thread ends a phase:

- imports: Python, JAX and the command
- checks: the config, the robot's file, the devices
- engine: the environment, with its engine
- trace: Python traces the programs, and lowers them for XLA, which compiles the first meanwhile
- XLA: it compiles the rest, or loads it
- kernels: the first call, which loads Warp's kernels and captures their graph
- row: until the first row of metrics.csv

OUT.json also has when XLA began and ended to compile or load each program ("programs"), side by side.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

FIELDS = dict(
    num_iterations=2,
    log_every=1,
    checkpoint_every=0,
    eval_envs=0,
    video_seconds=0.0,
    tensorboard=False,
)
PHASES = "imports", "checks", "engine", "trace", "XLA", "kernels", "row"
BEGAN, MARKS = "DYNAPPO_BEGAN", "DYNAPPO_MARKS"  # environment of the process that trains


def main():
    if MARKS in os.environ:
        return child()
    from dynappo.config import files  # here: the child imports what the command does
    from experiments import paper

    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--config", default="configs/go1.py")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--cases", nargs="+", default=["cold", "primed", "warm", "warm"])
    args = parser.parse_args()
    seconds, programs = [], None
    print(f"{'':8s} {'sum':>7s}", *(f"{name:>7s}" for name in PHASES), flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for number, case in enumerate(args.cases):
            if case != "warm":  # the warm ones have what the last of these has built
                programs = Path(folder, f"programs{number}")
            environment = dict(os.environ)
            if programs:
                environment["JAX_COMPILATION_CACHE_DIR"] = str(programs)
            if "cold" in args.cases:  # else the machine's own kernels
                environment["WARP_CACHE_PATH"] = str(Path(folder, "warp"))
            took, programs_at = phases(args, Path(folder, f"run{number}"), environment)
            row = {"case": case, "seconds": sum(took), **dict(zip(PHASES, took, strict=True))}
            seconds.append(row | {"programs": programs_at})
            print(f"{case:8s} {sum(took):7.1f}", *(f"{t:7.2f}" for t in took), flush=True)
            files.write_json(args.out, {"config": args.config, "set": args.set, "start": seconds})


def phases(args, workdir: Path, environment) -> tuple[list[float], dict]:
    """Seconds of each of `PHASES` in a process of its own, and from when to when XLA had each program."""
    marks = workdir.with_suffix(".marks")
    fields = [f"--config.run.{name}={value}" for name, value in FIELDS.items()]
    fields += [f"--config.{text}" for text in args.set]
    command = [sys.executable, __file__, f"--config={args.config}", *fields, f"--workdir={workdir}"]
    own = {BEGAN: str(time.time()), MARKS: str(marks)}
    done = subprocess.run(command, env=environment | own, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    ends, programs = json.loads(marks.read_text())
    at = [0.0, *(ends[name] for name in PHASES)]
    return [after - before for before, after in itertools.pairwise(at)], programs


def child():
    """`dynappo train`, with a note of when each phase ended."""
    began, ends, programs = float(os.environ[BEGAN]), {}, {}

    def note(name):
        ends[name] = time.time() - began

    def noting(module, function, before=None, after=None):
        own = getattr(module, function)

        def noted(*args, **kwargs):
            if before and before not in ends:
                note(before)
            result = own(*args, **kwargs)
            if after and after not in ends:
                note(after)
            return result

        setattr(module, function, noted)

    from dynappo.program import build
    from dynappo.run import loop
    from dynappo.train import command

    note("imports")
    import jax

    own_compile = jax.stages.Lowered.compile

    def compiling(self, *args, **kwargs):
        name, start = self._lowering._name, time.time() - began
        compiled = own_compile(self, *args, **kwargs)
        programs[name] = [round(start, 2), round(time.time() - began, 2)]
        if "kernels" not in ends:
            note("XLA")  # the last one counts
        return compiled

    def lowered(name, *_, **__):  # the last one before the program is compiled
        if name == "/jax/core/compile/jaxpr_to_mlir_module_duration" and "XLA" not in ends:
            note("trace")

    noting(build, "program", before="checks", after="kernels")
    noting(build, "_environment", after="engine")
    noting(loop, "write_rows", before="row")
    jax.monitoring.register_event_duration_secs_listener(lowered)
    jax.stages.Lowered.compile = compiling
    command.main(sys.argv[1:])
    Path(os.environ[MARKS]).write_text(json.dumps([ends, programs]))


if __name__ == "__main__":
    main()
