"""A Python that lacks what native Windows lacks (most of it a Mac lacks too), as far as Linux can play it.

python tests/other_system.py imports            # every module of dynappo
python tests/other_system.py play go1 ...       # the command of that name
python tests/other_system.py toy --workdir=DIR  # a run over the toy environment, and the same command again

Modules are hidden from dynappo, and from filelock, which then locks as it can. Names of `os` and `signal`
are gone for everybody. `sys.platform` stays: Python's own library would look for Windows itself.
"""

import builtins
import importlib
import os
import pkgutil
import runpy
import signal
import sys
from pathlib import Path

MODULES = "fcntl grp posix pty pwd resource syslog termios tty".split()
OS = (
    "fork forkpty getpgid getpriority getsid getuid killpg nice pread sched_getaffinity setsid "
    "sysconf sysconf_names"
)
SIGNAL = (
    "SIGALRM SIGHUP SIGKILL SIGQUIT SIGUSR1 alarm pthread_kill pthread_sigmask setitimer sigwait"
)


def hide() -> None:
    """From here on they are not there."""
    there = builtins.__import__

    def absent(name, scope=None, locals=None, fromlist=(), level=0):
        importer = (scope or {}).get("__name__", "").split(".")[0]
        if name in MODULES and level == 0 and importer in ("dynappo", "configs", "filelock"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return there(name, scope, locals, fromlist, level)

    builtins.__import__ = absent
    for module, names in ((os, OS), (signal, SIGNAL)):
        for name in names.split():
            delattr(module, name) if hasattr(module, name) else None


def main(what: str) -> None:
    """Do one of the three."""
    hide()
    if what == "imports":
        import dynappo

        for module in pkgutil.walk_packages(dynappo.__path__, "dynappo."):
            if not module.name.endswith("__main__"):
                importlib.import_module(module.name)
                print(module.name)
    elif what == "toy":
        for _ in range(2):
            runpy.run_path(str(Path(__file__).with_name("toy_train.py")), run_name="__main__")
    else:
        from dynappo.config import flags

        flags.start(what)


if __name__ == "__main__":
    main(sys.argv.pop(1))
