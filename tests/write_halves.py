"""Write dynappo/config/halves.py, the types of `static` and `hyper`, from configs/default.py.

    python tests/write_halves.py

`config.split` decides which field is in which half; what its type is, configs/default.py says.
"""

import pathlib
import runpy
from typing import Literal, get_args, get_origin, get_type_hints

from dynappo import config as config_lib
from dynappo.config import fields

ROOT = pathlib.Path(__file__).parents[1]
DEFAULT, FILE = ROOT / "configs" / "default.py", ROOT / "dynappo" / "config" / "halves.py"
HEAD = '''"""`Static` and `Hyper`: which field is in which half of the config, for type checkers and editors.

`make format` writes this file (tests/write_halves.py) from configs/default.py, which has the fields'
units and sources. Nothing imports it at run time: `splitting.split` makes the same classes from the
config itself, so a new field works before it is here.

Why written out: a type checker runs no code, and no type in Python selects fields by their types. Two
classes for each group, written by hand, would separate fields that belong together, like `desired_kl` and
`adaptive`.
"""

from typing import NamedTuple
'''


def text() -> str:
    """What halves.py has to be."""
    config = config_lib.validate(fields.defaults())
    root = runpy.run_path(str(DEFAULT))["Config"]
    halves = [text for half in config_lib.split(config) for text in classes(half, root)]
    return "\n\n".join([HEAD, *halves])


def classes(values, group):
    """The classes of the groups inside `group` and then its own, with the fields that `values` has."""
    types = get_type_hints(group)  # without bounds
    lines = [f"class {type(values).__name__}(NamedTuple):\n"]
    for name, value in values._asdict().items():
        if hasattr(value, "_fields"):
            yield from classes(value, types[name])
            kind = type(value).__name__
        else:
            # validation has set what `task.formulation` decides
            kind = written(types[name]).removesuffix("" if value is None else " | None")
        lines.append(f"    {name}: {kind}\n")
    yield "".join(lines)


def written(kind) -> str:
    """A type as an annotation; one of several texts is a `str`."""
    parts = get_args(kind)
    if get_origin(kind) is Literal:
        return "str"
    if dict[str, float] in parts:  # `PerJoint`: its patterns are numbers when a config is split
        return "float | tuple[float, ...]" + " | None" * (type(None) in parts)
    if type(None) in parts:
        return f"{written(parts[0])} | None"
    return kind.__name__ if isinstance(kind, type) and not parts else str(kind)


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8", newline="\n")
