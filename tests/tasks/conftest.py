"""What tests of Playground's tasks share."""

import pytest


@pytest.fixture
def stand_ins(monkeypatch, tmp_path_factory):
    """In the place of meshes, in a folder of these tests, also where the machine has meshes."""
    from dynappo.tasks.playground import assets

    folder = tmp_path_factory.getbasetemp() / "stand_ins"
    folder.mkdir(exist_ok=True)
    monkeypatch.setattr(assets.tempfile, "gettempdir", lambda: str(folder))
    monkeypatch.setattr(assets, "_places", lambda playground: iter(()))
