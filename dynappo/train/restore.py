"""`--restore=DIR`: start a run from the networks of another one, in whose folder nothing is changed."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import ConfigError, files
from dynappo.policy import checkpoint_file
from dynappo.program import distributed
from dynappo.train import checkpoint
from dynappo.train import workdir as workdir_lib


def start_from(folder: Path, program: Any, say: Callable[[str], None] = print) -> Any:
    """`program` with the networks of another run in its first state (`weights`)."""
    _, state = distributed.from_first(lambda s: (0, weights(folder, s, say)), program.state)
    return program._replace(state=program.place(state))


def source(workdir: Path, asked: Path | None) -> Path | None:
    """The run whose networks this one is to start from; None where it starts with untrained ones, or goes on.

    `asked` is `--restore`; `workdir/restored_from` remembers it. ConfigError if the run that is there began
    from something else.
    """

    def settle():
        path = workdir / "restored_from"
        there = path.read_bytes().decode(errors="replace").strip() if path.exists() else ""
        here = str(asked.resolve()) if asked else there
        if workdir_lib.begun(workdir) and here != there:
            raise ConfigError(
                f"--restore={asked}: the run in {workdir} began from {there or 'untrained networks'}; leave "
                "--restore out to go on with it, or --fresh to start over"
            )
        if asked:
            files.write_text(path, f"{here}\n")
        return "" if workdir_lib.saved(workdir) else here

    found = distributed.on_first(settle)
    return Path(found) if found else None


def weights(folder: Path, like: Any, say: Callable[[str], None] = print) -> Any:
    """`like` with the networks of another run's newest good checkpoint, to start a run from.

    `folder` is its workdir, in which nothing is changed. Policy, value function and, where both runs
    have one, the transition model with its moments are taken; optimisers, learning rate and robots
    start anew. `say` tells of damaged checkpoints that were passed over. ConfigError where none is
    good, or a network has another shape.
    """
    there, problems = None, []
    for step in saved(folder):
        try:
            there = checkpoint_file.read(folder / "checkpoints" / str(step))
        except ConfigError as error:
            problems.append(str(error))
            continue
        for problem in problems:
            say(f"{problem}; checkpoint {step} is taken")
        break
    if there is None:
        raise ConfigError(
            f"--restore={folder}: none of its {len(problems)} checkpoints can be read ({problems[0]}); "
            "expected a run with a good one"
        )
    learner = like.learner.replace(
        params=_taken(folder, like.learner.params, there, "policy", "learner.params")
    )
    model = like.model
    if model is not None and any(name.startswith("model.") for name in there):
        parts = {
            name: _taken(folder, getattr(model, name), there, f"model.{name}", f"model.{name}")
            for name in ("params", "inputs", "targets")
        }
        model = model.replace(**parts)
    return like.replace(learner=learner, model=model)


def check(folder: Path, config) -> None:
    """ConfigError if the run in `folder` has networks of other sizes than `config`, as its checkpoint says:
    before anything is compiled, written or moved. `weights` looks at the arrays themselves.
    """
    steps, there = saved(folder), {}
    for step in steps:
        with contextlib.suppress(checkpoint_file.Damaged, KeyError, TypeError, AttributeError):
            about = checkpoint_file.about(folder / "checkpoints" / str(step))
            there = config_lib.flat(about["config"])
            break
    here = config_lib.flat(config)
    names = ["run.num_seeds", "ppo.hidden"]
    if schedule.uses_model(config) and there.get("schedule.end_steps"):
        names += ["model.hidden", "model.falls"]
    for name in names:
        one, other = (d[name] for d in (there if name in there else here, here))
        if np.ravel(one).tolist() != np.ravel(other).tolist():
            raise ConfigError(
                f"--restore={folder}: {name} is {one} there, {other} here; "
                "set the sizes and run.num_seeds of that run (its config.json has them)"
            )


def saved(folder: Path) -> list[int]:
    """Iterations of the checkpoints of another run, newest first; ConfigError if there is none."""
    if not (folder / "checkpoints").is_dir():
        raise ConfigError(f"--restore={folder}: no checkpoints/ there; expected a run's workdir")
    found = checkpoint_file.iterations(folder / "checkpoints")
    if not found:
        raise ConfigError(
            f"--restore={folder}: it holds no checkpoint yet; expected a run that has saved one"
        )
    return found


def _taken(folder, like, there, what, prefix):
    """The arrays of `there` under `prefix`, in the structure of `like`."""
    out = []
    for name, leaf in checkpoint.paths(like).items():
        array = there.get(f"{prefix}.{name.replace('/', '.')}")
        if array is None or array.shape != leaf.shape:
            found = "absent" if array is None else f"of shape {array.shape}"
            raise ConfigError(
                f"--restore={folder}: {what} {name} is {found} there, of shape {leaf.shape} here; "
                "set the sizes and run.num_seeds of that run (its config.json has them)"
            )
        out.append(jnp.asarray(array, leaf.dtype))
    return jax.tree.unflatten(jax.tree.structure(like), out)
