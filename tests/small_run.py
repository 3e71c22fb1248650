"""Fixtures: one small run over the toy environment, compiled once for all tests of a process."""

import jax
import pytest
import workdirs

from dynappo.program import build


@pytest.fixture(scope="session")
def config():
    return workdirs.config()


@pytest.fixture(scope="session")
def program(config):
    """`program()`: the same run, compiled and ready to start."""
    with pytest.MonkeyPatch.context() as patch:
        workdirs.toy(patch)
        once = build.program(config)
    return lambda: once._replace(state=jax.tree.map(lambda x: x.copy(), once.state))


@pytest.fixture(scope="session")
def whole(config, program, tmp_path_factory):
    """The run without interruption, with the same compiled program."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "program", lambda *_, **__: program())
        return workdirs.Run(config, tmp_path_factory.mktemp("whole") / "deep" / "run")
