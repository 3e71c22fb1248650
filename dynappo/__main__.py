"""`dynappo COMMAND ...`, where the package is installed; `python -m dynappo COMMAND ...` everywhere."""

import sys

from dynappo.config import flags, versions

COMMANDS = {
    "train": "train a robot, or resume a run",
    "adopt": "make a robot of a published MJCF or URDF",
    "look": "check a robot before training: does it stand?",
    "play": "watch a policy: a page, a film, or MuJoCo's viewer",
    "evaluate": "measure a policy on a grid of commands",
    "export": "write a policy as ONNX or npz, for a robot",
    "bench": "time the parts of an iteration",
}
USAGE = """\
usage: dynappo COMMAND ...

{commands}

Each explains itself: dynappo COMMAND --help. First: dynappo play go1 --out=walk.html"""


def main() -> None:
    """Hand the rest of the command line to the command that its first word names."""
    name, found = (sys.argv[1:2] or ["--help"])[0], []

    def choose():
        if name in ("--help", "-h"):
            print(USAGE.format(commands="\n".join(f"  {n:9} {t}" for n, t in COMMANDS.items())))
        elif name == "--version":
            print(f"dynappo {versions.of('dynappo')}")
        elif name in COMMANDS:
            found.append(name)
        else:
            raise flags.ConfigError(
                f"{name}: no such command, expected one of {', '.join(COMMANDS)}"
            )

    flags.answer(choose)
    if found:
        del sys.argv[1]
        flags.start(name)


if __name__ == "__main__":
    main()
