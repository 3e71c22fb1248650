"""Pictures are not rendered, and stored runs are read once."""

import contextlib
import functools
import io
import types

import pytest
from result_files import cells, script

from experiments import paper, pictures


@pytest.fixture(scope="module", autouse=True)
def read_once():
    """The scripts read the same 300 runs 800 times. A caller gets a dictionary of its own."""
    shipped = paper.read
    read = functools.cache(lambda path, time: shipped(path))

    def columns(path):
        return dict(read(path.resolve(), path.stat().st_mtime_ns))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(paper, "read", columns)
        yield


@pytest.fixture
def drawn(monkeypatch):
    """Names of the pictures that a script has drawn; rendering them would take most of the time."""
    plt = pytest.importorskip("matplotlib.pyplot")
    names = []
    monkeypatch.setattr(pictures, "save", lambda page, path, **_: names.append(path.name))
    yield names
    plt.close("all")


@pytest.fixture(scope="module")
def humanoid():
    """What the table script of 25_humanoid prints of each table: rows of cells by the first heading's cell,
    or by the heading above."""
    table, lines = script("25_humanoid/table"), io.StringIO()
    with contextlib.redirect_stdout(lines):
        table.main()
    found, title = {}, ""
    for block in lines.getvalue().strip().split("\n\n"):
        if not block.startswith("|"):
            title = block
            continue
        head, _, *rows = map(cells, block.splitlines())
        found[title or head[0] or head[1]] = rows
    return types.SimpleNamespace(table=table, printed=found)
