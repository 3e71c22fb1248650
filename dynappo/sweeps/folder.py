"""The folder of a sweep: a `sweep.json`, and a run's folder for each combination."""

from __future__ import annotations

import contextlib
import json
import os
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

from dynappo import config as config_lib
from dynappo.config import ConfigError, files, flags
from dynappo.run import workdir as workdir_lib
from dynappo.sweeps.grid import Combination

ABOUT, BLOWN_UP = "sweep.json", "nonfinite.json"
RUN = ("config.json", "metrics.csv", "checkpoints")  # of an ordinary run
WRITTEN = (ABOUT, "sweep.csv", "sweep.png", *workdir_lib.WRITTEN)
ELSE = "choose another --workdir, or --fresh to move that sweep aside"


def is_one(workdir: Path) -> bool:
    """Whether a sweep has begun in a folder."""
    return os.path.isfile(workdir / ABOUT)  # False where the name is too long


def load(workdir: Path, rest: list[str]) -> tuple[Any, dict[str, list[str]]]:
    """`(config, swept)` of the sweep in `workdir`, with every flag `--config.FIELD=VALUE` of `rest`."""
    about = _read(workdir)
    try:
        config = config_lib.from_json(json.dumps(about["config"]))
    except ConfigError as error:
        raise ConfigError(f"{workdir / ABOUT}: {error}; name the sweep's --config too") from None
    if about["own_env"]:
        raise ConfigError(
            f"--workdir={workdir}: it trains an environment of your own; name its file and values too: "
            "--config=FILE.py --sweep=FIELD=VALUE,VALUE"
        )
    flags.set_fields(config, rest)
    flags.check_terms(config, workdir)
    return config, about["sweep"]


def _read(workdir: Path) -> dict[str, Any]:
    path = workdir / ABOUT
    try:
        about = json.loads(path.read_bytes())
        kinds = {"sweep": dict, "config": dict, "own_env": bool, "combinations": dict}
        right = all(isinstance(about[name], kind) for name, kind in kinds.items())
        right = right and all(
            isinstance(texts, list) and all(isinstance(text, str) for text in texts)
            for texts in about["sweep"].values()
        )
        if right and isinstance(about["restore"], str | None):
            return about
    except (ValueError, TypeError, KeyError, RecursionError):
        pass
    raise ConfigError(f"{path}: it is not the JSON of a sweep; choose another --workdir")


@contextlib.contextmanager
def opened(
    workdir: Path,
    config,
    swept: dict[str, list[str]],
    combinations: list[Combination],
    restore: Path | None,
    fresh: bool = False,
):
    """The folder of a sweep, closed to other processes until the `with` ends; yields `restore`, or what the
    sweep began with.

    `config` is the one before values are set. ConfigError if a sweep has begun whose values are not all among
    those of now, or whose config differs in more than `workdir.MAY_CHANGE`. `fresh` moves it to
    `WORKDIR.old-1`.
    """
    with contextlib.ExitStack() as held:
        try:
            if problem := workdir_lib.in_checkpoint(workdir):
                raise ConfigError(problem)
            if fresh:
                _move(workdir, restore)
            for name in RUN:
                if not is_one(workdir) and (workdir / name).exists():
                    raise ConfigError(
                        f"--workdir={workdir} holds {name} of a run, expected a sweep or nothing; choose "
                        "another folder"
                    )
            if is_one(workdir):
                restore = _compare(workdir, config, swept, combinations, restore)
            workdir.mkdir(parents=True, exist_ok=True)
            held.enter_context(workdir_lib.hold(workdir))
            about = {
                "sweep": swept,
                "combinations": {one.name: one.values for one in combinations},
                "restore": str(restore.resolve()) if restore else None,
                "own_env": any(one.env is not None for one in combinations),
                "config": config.to_dict(),
            }
            files.write_json(workdir / ABOUT, about)
        except OSError as error:
            if error.errno not in flags.BAD_PATH:  # the machine's, not the name's
                raise
            raise ConfigError(
                f"--workdir={workdir}: cannot write there ({error.strerror}); choose another folder"
            ) from None
        yield restore


def _compare(workdir: Path, config, swept, combinations, restore: Path | None) -> Path | None:
    """The `--restore` of the sweep in `workdir`; ConfigError if it is another sweep."""
    about = _read(workdir)
    if list(about["sweep"]) != list(swept):
        raise ConfigError(
            f"--workdir={workdir} holds a sweep over {', '.join(about['sweep'])}, not over "
            f"{', '.join(swept)}; {ELSE}"
        )
    names = {one.name for one in combinations}
    lost = next((name for name in about["combinations"] if name not in names), "")
    if lost:
        raise ConfigError(
            f"--workdir={workdir} holds a sweep with {lost}, which is missing here; name its values too "
            f"(others may be added), or {ELSE}"
        )
    may = (*workdir_lib.MAY_CHANGE, *swept)
    changed = config_lib.difference(json.dumps(about["config"]), config_lib.to_json(config), may)
    if changed:
        raise ConfigError(
            f"--workdir={workdir} holds a sweep of another config ({changed}); {ELSE}"
        )
    there = about["restore"]
    if restore and str(restore.resolve()) != there:
        raise ConfigError(
            f"--restore={restore}: the sweep in {workdir} began from {there or 'untrained networks'}; leave "
            "--restore out to go on with it, or --fresh to start over"
        )
    return Path(there) if there else None


def _move(workdir: Path, restore: Path | None) -> None:
    """Move the sweep in `workdir` aside, if there is one; ConfigError if the folder holds anything else."""
    names = sorted(path.name for path in workdir.iterdir()) if workdir.is_dir() else []
    if not set(names) - {"lock"}:
        return
    workdir_lib.check_outside(workdir)
    if restore and restore.resolve().is_relative_to(workdir.resolve()):
        raise ConfigError(
            f"--restore={restore}: --fresh moves it aside; name one outside of {workdir}"
        )
    own = (*WRITTEN, *(_read(workdir)["combinations"] if is_one(workdir) else ()))
    others = [name for name in names if name not in own and not any(fnmatch(name, o) for o in own)]
    if others or not is_one(workdir):
        raise ConfigError(
            f"--workdir={workdir} holds {(others or names)[0]}, which no sweep writes: --fresh moves sweeps, "
            "and nothing else; move it yourself, or choose another folder"
        )
    workdir_lib.move_aside(workdir)


def iterations_saved(workdir: Path, one: Combination) -> int:
    """The iteration of a combination's newest checkpoint; 0 if there is none."""
    return max(workdir_lib.saved(workdir / one.name), default=0)


def blown_up(workdir: Path, one: Combination) -> str:
    """What was not finite in a combination that blew up; "" in any other."""
    path = workdir / one.name / BLOWN_UP
    if not path.is_file():
        return ""
    try:
        return str(json.loads(path.read_bytes())["problem"])
    except (ValueError, TypeError, KeyError):  # damaged since
        return f"{path} cannot be read"


def summary(workdir: Path, one: Combination) -> dict[str, Any]:
    """The summary.json of a combination that has ended as its config says; {} of any other, and where a file
    of it is lost or damaged: it then goes on from its checkpoint, which writes all of them again."""
    folder = workdir / one.name
    try:
        same = (folder / "config.json").read_text() == config_lib.to_json(one.config) + "\n"
        found = json.loads((folder / "summary.json").read_bytes())
        ended = (
            found["iterations"] == iterations_saved(workdir, one) == one.config.run.num_iterations
        )
        ended = ended and ("video" in found or not one.config.run.video_seconds)
        evaluation = found.get("evaluation", {})
        some = [found["seconds"], found.get("return"), *evaluation.values()]
        numbers = type(found["sim_steps"]) is int and all(map(_numbers, some))
    except (FileNotFoundError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    there = all((folder / name).is_file() for name in ("metrics.csv", "policy.npz"))
    return found if same and ended and numbers and there else {}


def _numbers(value: Any) -> bool:
    """Whether a value is a number, None where it is not known, or a list of these, one a seed."""
    some = value if isinstance(value, list) else [value]
    return all(x is None or type(x) in (int, float) for x in some)
