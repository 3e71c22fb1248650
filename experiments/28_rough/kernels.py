"""The kernels of an iteration of physics alone, and of a tail alone, by the time that they take on a GPU.

    python experiments/28_rough/kernels.py OUT.csv go2:rough go2 [--robots 2048] [--set FIELD=VALUE ...]
    python experiments/28_rough/kernels.py experiments/28_rough/results/kernels.csv    # the table of time.md

Each config runs `ITERATIONS` iterations of the program that trains, under JAX's profiler: once with all rows
real and no fit (`physics`), once with none real (`tail`). A line of OUT.csv is a kernel: config, what ran,
name, microseconds and launches a row, and what it computes: the line of the source and the operation at its
end, as XLA has noted them. What PPO's update takes is in both. `--hlo FOLDER` keeps the compiled programs.
"""

import csv
import re
import tempfile
from collections import Counter
from pathlib import Path

import jax
from jax.profiler import ProfileData

from dynappo import config as config_lib
from dynappo.bench import phases
from dynappo.config import loading
from dynappo.program import build, devices
from experiments import paper

ITERATIONS = 10
PARTS = {  # of a simulated row: what its kernels compute, the first that fits
    "physics in one kernel": r"control_step",
    "the ground looked up": r"(scan|height_map|surroundings|ground)\.py",
    "rows written": r"scatter$",
    "policy and value": r"(fast|networks|algorithm)\.py",
    "robots that begin, with their noise": r"env\.py:\d+ select_n",
    "rewards, observations and the rest": r"",
}


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("configs", nargs="*", metavar="ROBOT:VARIANT")
    parser.add_argument("--robots", type=int, default=2048)
    parser.add_argument("--most", type=int, default=25, help="kernels to print of each")
    parser.add_argument("--hlo", type=Path, help="folder for what XLA compiled, as text")
    parser.add_argument(
        "--set", nargs="+", default=[], metavar="FIELD=VALUE", help="of all configs"
    )
    args = parser.parse_args()
    if not args.configs:
        print(table(paper.rows(args.out)))
        return
    devices.own_process()
    rows = []
    for name in args.configs:
        config = loading.load(name)
        sizes = [f"rollout.num_envs={args.robots}", f"run.log_every={ITERATIONS}"]
        for field in [*sizes, *args.set]:
            loading.override(config, *field.split("=", 1))
        rows += of_config(name, config_lib.validate(config), args.hlo)
    with args.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    for name, ran in dict.fromkeys((row["config"], row["ran"]) for row in rows):
        of_run = [row for row in rows if (row["config"], row["ran"]) == (name, ran)]
        print(f"{name}, {ran}: {sum(row['us_a_row'] for row in of_run):.1f} us a row")
        for row in of_run[: args.most]:
            took, launches = row["us_a_row"], row["launches_a_row"]
            print(f"  {took:8.2f} us {launches:6.2f}  {row['kernel']}  {row['computes']}")


def table(rows: list[dict]) -> str:
    """Of each config, microseconds of a simulated row in kernels that a row of the tail does not have."""
    configs = list(dict.fromkeys(row["config"] for row in rows))
    took = {config: Counter() for config in configs}
    for config in configs:
        mine = [row for row in rows if row["config"] == config]
        tail = {row["kernel"] for row in mine if row["ran"] == "tail"}
        for row in mine:
            if row["kernel"] not in tail:
                said = f"{row['kernel']} {row['computes']}"
                part = next(part for part, of in PARTS.items() if re.search(of, said))
                took[config][part] += row["us_a_row"]
    lines = [[part, *(f"{took[config][part]:.1f}" for config in configs)] for part in PARTS]
    lines.append(["all", *(f"{took[config].total():.1f}" for config in configs)])
    return paper.markdown(["part", *configs], lines)


def of_config(name: str, config, hlo: Path | None = None) -> list[dict]:
    """Rows of OUT.csv, the dearest kernel of a run first; the compiled program into the folder `hlo`."""
    program = build.program(config)
    text = program.step.args[0].as_text()  # of the compiled chunk
    if hlo is not None:
        hlo.mkdir(parents=True, exist_ok=True)
        (hlo / f"{name.replace(':', '_')}.txt").write_text(text)
    about = computes(text)
    horizon = config.rollout.horizon
    last = {key: int(column[-1]) for key, column in program.columns.items()}
    last |= {key: value for key, value in (("model_epochs", 0), ("rounds", 1)) if key in last}
    rows = []
    for ran, real in (("physics", horizon), ("tail", 0)):
        asked = last | {"n_real": real}
        phases.iteration(config, program, program.state, asked)  # warm
        with tempfile.TemporaryDirectory() as folder:
            with jax.profiler.trace(folder):
                phases.iteration(config, program, program.state, asked)
            took, launches = kernels(next(Path(folder).rglob("*.xplane.pb")))
        count = ITERATIONS * horizon
        rows += [
            {
                "config": name,
                "ran": ran,
                "kernel": kernel,
                "us_a_row": float(f"{ns / 1e3 / count:.4g}"),
                "launches_a_row": float(f"{launches[kernel] / count:.4g}"),
                "computes": about.get(plain(kernel), ""),
            }
            for kernel, ns in took.most_common()
        ]
    return rows


def plain(name: str) -> str:
    """The name of an instruction as its kernel has it."""
    return re.sub(r"[.-]", "_", name)


def computes(text: str) -> dict[str, str]:
    """Of each instruction of a compiled program, as kernels are named after them: `file:line operation`."""
    tables = {}  # of the text: what has which number
    for found in re.finditer(r"^([A-Z]\w+)\n((?:\d+ .*\n)+)", text, re.M):
        tables[found[1]] = dict(row.split(" ", 1) for row in found[2].splitlines())
    out = {}
    for line in text.splitlines():
        found = re.match(r"\s*(?:ROOT )?%?([\w.-]+) = .*op_name=\"([^\"]*)\"", line)
        if not found:
            continue
        place, name = "", plain(found[1])
        for frame in re.findall(r"stack_frame_id=(\d+)", line):
            (at,) = re.findall(r"file_location_id=(\d+)", tables["StackFrames"][frame])
            location = tables["FileLocations"][at]
            ((file, number),) = re.findall(r"file_name_id=(\d+) .*? line=(\d+)", location)
            place = Path(tables["FileNames"][file].strip('"')).name + f":{number} "
        out[name] = place + found[2].rpartition("/")[2]
    return out


def kernels(path: Path) -> tuple[Counter, Counter]:
    """`(ns, launches)` of each kernel of a GPU in a profile; on a CPU, of each operation of XLA's threads."""
    took, launches = Counter(), Counter()
    planes = [*ProfileData.from_file(str(path)).planes]
    device = [plane for plane in planes if plane.name.startswith("/device:GPU")]
    for plane in device or [plane for plane in planes if plane.name == "/host:CPU"]:
        for line in plane.lines:
            if not (line.name.startswith("Stream") if device else "XLA" in line.name):
                continue
            for event in line.events:
                took[event.name] += event.duration_ns
                launches[event.name] += 1
    return took, launches


if __name__ == "__main__":
    main()
