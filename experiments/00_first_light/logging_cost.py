"""What writing costs: the same iterations with every log and checkpoint, and with nothing written.

    python experiments/00_first_light/logging_cost.py OUT.json [--set FIELD=VALUE ...]

Alternates both on one compiled program (Go1, `:fast`) and prints ms of an iteration as a clock on the
wall sees it, from the first to the last chunk.
"""

import shutil
import tempfile
import time
from pathlib import Path

import jax
import jax.numpy as jnp

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.program import build, devices
from dynappo.run import training
from experiments import paper


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    args = parser.parse_args()
    devices.own_process()
    config = config_lib.load("configs/go1.py:fast")
    config.run.update(num_iterations=150, checkpoint_every=50, eval_envs=0)
    for text in args.set:
        config_lib.override(config, *text.split("=", 1))
    config = config_lib.validate(config)
    program = build.program(config)
    first, ms = program.state, {"nothing": [], "everything": []}
    for repeat in range(6):
        for name, times in ms.items():
            folder = Path(tempfile.mkdtemp()) if name == "everything" else None
            fresh = program._replace(state=jax.tree.map(jnp.copy, first))
            stamps = []
            told = training.Callbacks(progress=lambda i, last, s=stamps: s.append((i, now())))
            training.resume_and_loop([training.Run(config, folder)], fresh, told)
            if folder:
                shutil.rmtree(folder)
            (i0, t0), (i1, t1) = stamps[0], stamps[-1]
            if repeat:  # the first warms up
                times.append((t1 - t0) / (i1 - i0) * 1e3)
    medians = {name: sorted(times)[len(times) // 2] for name, times in ms.items()}
    ratio = medians["everything"] / medians["nothing"]
    files.write_json(args.out, {"ms": ms, "median": medians, "ratio": ratio})
    print(medians, f"ratio {ratio:.4f}")


now = time.perf_counter

if __name__ == "__main__":
    main()
