"""How many cores a process may use (dynappo/physics/cores.py)."""

import os

import jax
import pytest

from dynappo.physics.cores import cores
from dynappo.program import build


@pytest.fixture
def one_core():
    if not hasattr(os, "sched_setaffinity"):
        pytest.skip("this system has no affinity")
    mine = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(mine)})
    yield
    os.sched_setaffinity(0, mine)


def test_a_process_that_may_use_one_core_has_one(one_core):
    assert (cores(), cores(0), cores(3)) == (1, 1, 3)


def test_a_gpus_programs_are_compiled_on_the_cores_that_the_process_has(one_core, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert [*build._xla_options()] == [{"xla_gpu_force_compilation_parallelism": 1}] * 2
