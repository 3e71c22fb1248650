"""Tells whether the code of an environment of one's own has changed: `digest(path)` of its file."""

from __future__ import annotations

import ast
import hashlib
from pathlib import Path

from dynappo.config.fields import ConfigError

BESIDE = "get_config"  # may change: what it returns is compared field by field


def digest(path: Path) -> str:
    """A hash of what a config's file says, and of the files beside it that it imports, in any depth.

    Comments, docstrings, layout and the function get_config do not count. ConfigError if one is no Python.
    """
    texts: dict[Path, str] = {}
    _read(path.resolve(), texts)
    named = sorted((path.name, text) for path, text in texts.items())
    return hashlib.sha256(repr(named).encode()).hexdigest()[:12]


def _read(path: Path, texts: dict[Path, str]) -> None:
    """Add the text of a file, and of those that it imports, to `texts`."""
    if path in texts:
        return
    try:
        tree = ast.parse(path.read_bytes(), str(path))
    except (SyntaxError, ValueError, RecursionError) as error:
        line = getattr(error, "lineno", None)
        at = f"{path}, line {line}" if line else f"{path}"
        raise ConfigError(f"{at}: it is no Python ({getattr(error, 'msg', error)})") from None
    tree.body = [node for node in tree.body if getattr(node, "name", "") != BESIDE]
    for node in ast.walk(tree):
        if isinstance(body := getattr(node, "body", None), list):
            node.body = [one for one in body if not _is_text(one)] or [ast.Pass()]  # pyright: ignore[reportAttributeAccessIssue]
    texts[path] = ast.unparse(tree)
    for name in _imported(tree):
        for found in (f"{name.replace('.', '/')}.py", f"{name.replace('.', '/')}/__init__.py"):
            if (path.parent / found).is_file():
                _read(path.parent / found, texts)


def _is_text(node: ast.AST) -> bool:
    """Whether a statement is a text alone, as a docstring is."""
    value = getattr(node, "value", None)
    return (
        isinstance(node, ast.Expr) and isinstance(value, ast.Constant) and type(value.value) is str
    )


def _imported(tree: ast.AST) -> list[str]:
    """The modules, and what may be one, that a file's imports name."""
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [one.name for one in node.names]
        elif isinstance(node, ast.ImportFrom):
            of = node.module or ""
            names += [of, *(f"{of}.{one.name}".lstrip(".") for one in node.names)]
    return [name for name in names if name]
