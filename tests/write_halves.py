"""Write dynappo/config/halves.py, the types of `static` and `hyper`, from configs/default.py.

    python tests/write_halves.py

`config.split` decides which field is in which half; what its type is, configs/default.py says.
"""

import ast
import pathlib

from dynappo import config as config_lib
from dynappo.config import fields

ROOT = pathlib.Path(__file__).parents[1]
DEFAULT, FILE = ROOT / "configs" / "default.py", ROOT / "dynappo" / "config" / "halves.py"
HEAD = '''"""`Static` and `Hyper`: which field is in which half of the config, for type checkers and editors.

`make format` writes this file (tests/write_halves.py) from configs/default.py, which has the fields'
units and sources. Nothing imports it at run time: `splitting.split` makes the same classes from the
config itself, so a new field works before it is here.

Why written out: a type checker runs no code, and no type in Python selects fields by their types. Two
classes a group by hand would separate what belongs together, as `desired_kl` and `adaptive`.
"""

from typing import NamedTuple
'''


def text() -> str:
    """What halves.py has to be."""
    body = ast.parse(DEFAULT.read_text(encoding="utf-8")).body
    groups = {node.name: node for node in body if isinstance(node, ast.ClassDef)}
    config = config_lib.validate(fields.defaults())
    halves = [c for half in config_lib.split(config) for c in classes(half, "Config", groups)]
    return "\n\n".join([HEAD, *halves])


def classes(values, group, groups):
    """The classes of the groups inside `group` and then its own, with the fields that `values` has."""
    lines = [node for node in groups[group].body if isinstance(node, ast.AnnAssign)]
    types = {ast.unparse(node.target): ast.unparse(node.annotation) for node in lines}
    lines = [f"class {type(values).__name__}(NamedTuple):\n"]
    for name, value in values._asdict().items():
        if hasattr(value, "_fields"):
            yield from classes(value, types[name], groups)
            types[name] = type(value).__name__
        # validation has set what `task.formulation` decides
        kind = types[name] if value is None else types[name].removesuffix(" | None")
        lines.append(f"    {name}: {kind}\n")
    yield "".join(lines)


if __name__ == "__main__":
    FILE.write_text(text(), encoding="utf-8", newline="\n")
