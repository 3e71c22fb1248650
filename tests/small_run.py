"""Fixtures: one small run over the toy environment, compiled and trained once for all tests of a process.

Each folder that takes them has fixtures of its own, so it is not pytest that remembers what they made.
"""

import functools

import jax
import pytest
import workdirs

from dynappo.program import build


@pytest.fixture(scope="session")
def config():
    return workdirs.config()


@functools.cache
def compiled():
    with pytest.MonkeyPatch.context() as patch:
        workdirs.toy(patch)
        return build.program(workdirs.config())


@pytest.fixture(scope="session")
def program():
    """`program()`: the same run, compiled and ready to start."""
    once = compiled()
    return lambda: once._replace(state=jax.tree.map(lambda x: x.copy(), once.state))


RUNS: list[workdirs.Run] = []


@pytest.fixture(scope="session")
def whole(config, program, tmp_path_factory):
    """The run without interruption, with the same compiled program."""
    if not RUNS:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(build, "program", lambda *_, **__: program())
            folder = tmp_path_factory.mktemp("whole") / "deep" / "run"
            RUNS.append(workdirs.Run(config, folder))
    return RUNS[0]
