"""Where the time of an iteration goes: `dynappo bench --config=configs/go1.py:fast`.

`--vs=CONFIG` alternates two configs in one process, so that other load on the machine affects both, and
prints the ratio of their iterations. `--engines=c,jax` does the same for one config on two engines.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from dynappo import config as config_lib
from dynappo.bench import phases
from dynappo.config import ConfigError, files, flags, versions
from dynappo.program import build, devices


def report(config, program, repeats: int) -> dict[str, Any]:
    """Phases (ms), rates (1/s), bytes in use at most, and seconds of set-up of one config."""
    import jax

    ms = phases.measure(config, program, program.state, repeats)
    real = int(program.columns["n_real"][-1]) * config.rollout.num_envs
    stats = jax.devices()[0].memory_stats() or {}
    return {
        "ms": ms,
        "iterations_per_second": 1e3 / ms["iteration"],
        "control_steps_per_second": real * 1e3 / ms["iteration"],
        "physics_steps_per_second": real * config.physics.substeps * 1e3 / ms["iteration"],
        "peak_bytes": stats.get("peak_bytes_in_use"),
        "setup_seconds": program.compile_seconds,
        "device": program.device,
        "impl": program.impl,
        "commit": versions.commit(),
    }


def parse(argv: list[str] | None):
    """`(configs, names, repeats, out, compile)` of a command line."""
    parser = flags.parser(
        "bench",
        "Time each phase of a training iteration, on the program that trains.",
        "examples\n"
        "  python -m dynappo.bench --config=go1\n"
        "  python -m dynappo.bench --config=go1:ppo16 --vs=go1:best --out=bench.json\n"
        "--config.GROUP.FIELD=VALUE sets a field of both configs, as in dynappo train",
    )
    parser.add_argument(
        "--config",
        metavar="NAME[:VARIANT]|FILE.py[:VARIANT]",
        help="what to time: a robot, or a config file",
    )
    parser.add_argument(
        "--vs", metavar="NAME[:VARIANT]|FILE.py[:VARIANT]", help="alternate with this config"
    )
    parser.add_argument("--engines", metavar="ENGINE,ENGINE", help="alternate these engines")
    parser.add_argument(
        "--repeats", metavar="N", default="5", help="print medians of N measurements; default: 5"
    )
    parser.add_argument(
        "--compile", action="store_true", help="also time the set-up, with cold and warm caches"
    )
    parser.add_argument(
        "--out", type=flags.path, metavar="FILE.json", help="write all numbers to this file"
    )
    known, rest = flags.read_with_fields(parser, argv)
    repeats = flags.whole("repeats", known.repeats, 1, 10_000)
    if known.out:  # before minutes of measuring
        if known.out.suffix != ".json":
            raise ConfigError(f"--out={known.out}: expected a file named .json")
        flags.check_writable(known.out)
    names = [known.config, known.vs] if known.vs else [known.config]
    sources = [(name, rest, flag) for name, flag in zip(names, ("--config", "--vs"), strict=False)]
    if known.engines:
        engines = known.engines.split(",")
        if len(engines) != 2 or known.vs:
            raise ConfigError(
                f"--engines is {known.engines}, expected two engines of one config, as in "
                "--engines=c,jax, without --vs"
            )
        names = engines
        impl = "--config.physics.impl="
        sources = [(known.config, [*rest, f"{impl}{e}"], "--config") for e in engines]
    configs = []
    for name, fields, flag in sources:
        config = flags.load(name, fields, flag)
        # an evaluation would compile beside what is timed
        config.run.update(num_seeds=1, mesh_seed=1, eval_every=0, eval_envs=0)
        try:
            configs.append(config_lib.validate(config))
        except ConfigError as error:
            if known.engines and str(error).startswith("physics.impl is"):
                raise ConfigError(f"--engines={known.engines}: {error}") from None
            raise
    if names[1:] == names[:1]:  # how much two measurements of the same differ
        names = [names[0], f"{names[0]}, again"]
    return configs, names, repeats, known.out, known.compile


def show(names, reports, versus) -> None:
    """Print one column for each config."""
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    for title in ("", *names):
        # a long name breaks, and is not cut
        table.add_column(title, justify="right" if title else "left", overflow="fold")
    rows = {}
    for name in ("iteration", "physics", "tail", "fit", "ppo"):
        unit = "ms a row" if name in ("physics", "tail") else "ms"
        rows[f"{name}, {unit}"] = [
            f"{r['ms'][name]:.2f}" if name in r["ms"] else "" for r in reports
        ]
    for name, scale, digits, label in (
        ("iterations_per_second", 1, 2, "iterations/s"),
        ("control_steps_per_second", 1, 0, "control steps/s"),
        ("physics_steps_per_second", 1, 0, "physics steps/s"),
        ("peak_bytes", 2**-30, 2, "memory at most, GiB"),
        ("setup_seconds", 1, 1, "set-up, s"),
    ):
        rows[label] = [f"{r[name] * scale:,.{digits}f}" if r[name] else "" for r in reports]
    for name in ("cold", "warm"):
        if "compilation" in reports[0]:
            rows[f"set-up, {name} cache, s"] = [f"{r['compilation'][name]:.1f}" for r in reports]
    for label, cells in rows.items():
        if not any(cells):  # a CPU does not tell its memory
            continue
        table.add_row(label, *cells)
    out = Console(highlight=False, emoji=False)
    engines = " and ".join(dict.fromkeys(devices.ENGINES[r["impl"]] for r in reports))
    out.print(f"{reports[0]['device']}, {engines}")
    out.print(table)
    if versus:
        out.print(
            f"an iteration of {names[1]} takes {versus['ratio']:.3f} of one of {names[0]} "
            f"({versus['ratio_min']:.3f} to {versus['ratio_max']:.3f}, alternating)"
        )


def run(configs, names, repeats: int, out: Path | None, compile: bool) -> None:
    """Measure each config, print the results, and write them if the flags say so."""
    devices.own_process(configs[0].run.device)
    for config in configs:
        build.check(config)
    programs, reports = [], []
    for config, name in zip(configs, names, strict=True):
        print(f"dynappo compiles {name}, a minute or less ...", file=sys.stderr, flush=True)
        programs.append(build.program(config))
        print("dynappo measures it ...", file=sys.stderr, flush=True)
        reports.append(report(config, programs[-1], repeats))
    for config, found in zip(configs, reports, strict=True):
        if compile:
            found["compilation"] = phases.compilation(config)
    versus = phases.compare(configs, programs, repeats) if len(configs) == 2 else None
    show(names, reports, versus)
    if out:
        files.write_json(out, {"configs": dict(zip(names, reports, strict=True)), "versus": versus})
        print(out)


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags.answer(lambda: run(*parse(argv)))
