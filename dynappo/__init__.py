"""dynappo: PPO whose rollout tails are written by a learned transition model.

Start reading at `algorithm.py`, whose first lines say which file to read next. The files beside it are the
method; each folder is one subject, and its `__init__` says what is in it. The public modules can be
imported from here:

    from dynappo import algorithm, config, env, gae, robot, schedule, scores, seeds, terms, train

Importing the package sets two flags of XLA's CPU compiler, and what XLA may print, before JAX starts.
Values that you have set stay.

- The concurrency-optimised scheduler is off: with it, jaxlib 0.10.2 deadlocks on two cores at 256
  robots, when parallel loops (random bits, the constraint solver) take all threads and wait for
  one. Turning it off costs nothing measurable.
- One fusion is off, in jaxlib 0.10.2 alone, because that version computes wrong numbers in sums of
  products with more than 32,768 results (jax-ml/jax#39103): from robot 2,340 on, a Go1's lowest points
  were wrong, and standing robots counted as fallen. No GPU is affected.
- Where JAX has no plugin for a GPU, XLA prints fatal errors alone (`TF_CPP_MIN_LOG_LEVEL`): it raises red
  alarms where it compiles for two minutes, as MJX on a CPU, and no setting is for them alone. With a plugin
  such lines are about the GPU too, and stay. Set here, because JAX reads it when it is imported, and
  Playground's and brax's settings import JAX before a command is set up.
"""

import contextlib
import importlib
import importlib.util
import os
import re
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING


def _starts_command() -> bool:
    """Whether Python starts one of our commands, and not a program that imports this package."""
    # `-m dynappo.play`, and `-mdynappo.play` without a space
    words = [argument.removeprefix("-m").partition(".")[0] for argument in sys.orig_argv[1:]]
    named = "dynappo" in words
    return sys.argv[:1] == ["-m"] and named or Path((sys.argv or [""])[0]).stem == "dynappo"


def _stopped(number: int, _) -> None:
    """The handler of signals until `config.stop.Stop` hears them: nothing has begun, so it ends at once."""
    with contextlib.suppress(OSError):  # the terminal may be gone
        os.write(2, b"dynappo: stopped\n")
    os._exit(128 + number)


if _starts_command():  # before all else: imports take a second
    for _name in ("SIGINT", "SIGTERM", "SIGHUP"):  # Windows has not all of them
        _number = getattr(signal, _name, None)
        if _number and signal.getsignal(_number) is not signal.SIG_IGN:  # as after `nohup`
            signal.signal(_number, _stopped)

from importlib import metadata  # noqa: E402 (it takes as long as Python's start)


def _in_a_line(kind, error, trace) -> None:
    """Python's own error report, but ctrl-C and a missing package are one line."""
    if issubclass(kind, KeyboardInterrupt):
        line, status = "stopped", (*error.args, 130)[0]
    elif issubclass(kind, ModuleNotFoundError) and not str(error.name).startswith("dynappo"):
        line, status = (
            f"{error.name} is not installed for {sys.executable}; {_remedy(str(error.name))}",
            2,
        )
    else:
        return sys.__excepthook__(kind, error, trace)
    print(f"dynappo: {line}", file=sys.stderr, flush=True)
    os._exit(status)


def _remedy(module: str) -> str:
    """What to do if a module is missing: in a clone, use the clone's own `.venv`; else install its package,
    for dynappo itself may not be where pip looks."""
    root = Path(__file__).resolve().parents[1]
    own = root / ".venv"
    if (own / "bin" / "python").exists() and own != Path(sys.prefix):
        return f"source {own}/bin/activate"
    if (own / "Scripts" / "python.exe").exists() and own != Path(sys.prefix):
        return rf"{own}\Scripts\activate"
    if (root / "constraints.txt").exists():
        return f"{sys.executable} -m pip install -c {root}/constraints.txt -e {root}"
    try:
        needed = [re.split(r"[^\w.-]", text)[0] for text in metadata.requires("dynappo") or []]
    except metadata.PackageNotFoundError:
        needed = []
    names = re.sub("[._]", "-", module), module.partition(".")[0].replace("_", "-")
    package = next((name for name in needed if name in names), names[1])
    return f"{sys.executable} -m pip install {package}"


if _starts_command():
    sys.excepthook = _in_a_line

if TYPE_CHECKING:  # what an editor completes
    from dynappo.config import terms as terms
    from dynappo.description import robot as robot
    from dynappo.learner import gae as gae
    from dynappo.tasks.velocity import env as env

# public modules that are not in this folder, loaded on first use
_PUBLIC = {
    "env": "dynappo.tasks.velocity.env",
    "gae": "dynappo.learner.gae",
    "robot": "dynappo.description.robot",
    "terms": "dynappo.config.terms",
}

_FLAGS = {"--xla_cpu_enable_concurrency_optimized_scheduler": "false"}
with contextlib.suppress(metadata.PackageNotFoundError):  # reported where jax is imported
    if metadata.version("jaxlib") == "0.10.2":
        _FLAGS["--xla_cpu_experimental_ynn_fusion_type"] = ""
if importlib.util.find_spec("jax_plugins") is None:
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
for _flag, _value in _FLAGS.items():
    if _flag not in os.environ.get("XLA_FLAGS", ""):
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_flag}={_value}".strip()


def __getattr__(name: str):
    if name not in _PUBLIC:
        raise AttributeError(f"module 'dynappo' has no attribute {name!r}")
    return importlib.import_module(_PUBLIC[name])
