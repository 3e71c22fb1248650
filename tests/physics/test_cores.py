"""How many cores a process may use (dynappo/physics/cores.py)."""

import os

import jax
import pytest

from dynappo.physics import cores as cores_lib
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


@pytest.mark.parametrize(
    ("quota", "expected"),
    [("200000 100000", 2), ("150000 100000", 2), ("10000 100000", 1), ("900000 100000", 4)]
    + [(text, 4) for text in ("max 100000", "", "nonsense", "1 0", None)],
)
def test_a_quota_of_a_container_counts(quota, expected, tmp_path, monkeypatch):
    """As `docker run --cpus=2` writes it: all cores of the host are in the affinity."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 2, 3}, raising=False)
    monkeypatch.setattr(cores_lib, "QUOTA", str(tmp_path / "cpu.max"))
    if quota is not None:
        (tmp_path / "cpu.max").write_text(f"{quota}\n")
    assert (cores(), cores(3)) == (expected, 3)


def test_a_gpus_programs_are_compiled_on_the_cores_that_the_process_has(one_core, monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert [*build._xla_options()] == [{"xla_gpu_force_compilation_parallelism": 1}] * 2
