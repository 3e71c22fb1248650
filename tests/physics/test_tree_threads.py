"""The kernel of trees as a GPU runs it, 32 threads a robot, without a GPU (tests/emulated_warp.py)."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pytest
from answers import ROOT

pytest.importorskip("warp", reason="its headers are compiled")  # without a GPU, so not in on_gpu.py

import emulated_warp  # noqa: E402
from tree_robots import made  # noqa: E402

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="needs g++")
BARRIERS = 0, 10  # two of the many


@pytest.mark.parametrize("name", ["biped", pytest.param("g1", marks=pytest.mark.slow)])
def test_lanes_make_what_one_thread_makes(name, tmp_path):
    case = made(name, tmp_path)
    expected = case.step(case.before)
    for name, found in emulated_warp.step(case, robots=16).items():
        one = expected[name][:16]
        atol = 2e-5 * max(1, np.abs(one).max())  # sums in another order
        np.testing.assert_allclose(found, one, rtol=0, atol=atol, err_msg=name)


def races(*arguments) -> int:
    """How many ThreadSanitizer reports, of twelve robots."""
    script = ROOT / "tests" / "emulated_warp.py"
    command = [sys.executable, script, "biped", "--robots=12", "--races", *arguments]
    paths = os.pathsep.join([str(ROOT), str(ROOT / "tests")])
    extra = {
        "LD_PRELOAD": emulated_warp.tsan(),
        "TSAN_OPTIONS": "exitcode=0 history_size=7",
        "PYTHONPATH": paths,
    }
    done = subprocess.run(command, env=os.environ | extra, capture_output=True, text=True)
    assert done.returncode == 0 and "lowest" in done.stdout, done.stderr[-2000:]
    return done.stderr.count("WARNING: ThreadSanitizer")


@pytest.mark.slow
@pytest.mark.skipif(not emulated_warp.tsan(), reason="needs ThreadSanitizer")
def test_no_lane_reads_what_another_has_not_written_yet():
    assert races() == 0
    for number in BARRIERS:
        assert races(f"--without={number}") > 0
