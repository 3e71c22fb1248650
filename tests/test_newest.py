"""Today's newest version of every package, without the pins, in an environment of its own (slow)."""

import os
import pathlib
import shutil
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow
ROOT = pathlib.Path(__file__).parents[1]
EXTRAS = "dev,video,export"
# what does not need the browser, and compiles little
TESTS = (
    "config learner model policy export description facts test_rollout.py test_scores.py".split()
)
UNREACHABLE = "Connection", "Name or service", "Temporary failure", "Read timed out"


def python() -> str:
    """The newest Python that dynappo supports and that runs here: only it has the newest JAX."""
    for name in ("python3.13", "python3.12"):
        found = shutil.which(name)
        if found and not subprocess.run([found, "--version"], capture_output=True).returncode:
            return found
    return sys.executable


@pytest.fixture(scope="module")
def newest(tmp_path_factory):
    """The Python of an environment into which pip has put dynappo without the pins."""
    folder = tmp_path_factory.mktemp("newest")
    subprocess.run([python(), "-m", "venv", folder / "venv"], check=True)
    own = folder / "venv" / "bin" / "python"
    command = [own, "-m", "pip", "install", "-q", "-e", f"{ROOT}[{EXTRAS}]"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode and any(word in done.stderr for word in UNREACHABLE):
        pytest.skip("pip reaches no index here")
    assert done.returncode == 0, done.stderr[-2000:]
    return own


def run(command, folder):
    # without what conftest.py sets for the pinned JAX, whose XLA has other flags
    ours = {"PYTHONPATH", "XLA_FLAGS", *(name for name in os.environ if name.startswith("JAX_"))}
    environment = {name: text for name, text in os.environ.items() if name not in ours}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, (done.stdout[-2000:], done.stderr[-2000:])
    return done.stdout


def test_tests_pass_with_them(newest):
    run([newest, "-m", "pytest", "-p", "no:cacheprovider", *(f"tests/{x}" for x in TESTS)], ROOT)


def test_a_robot_trains_plays_and_is_exported_with_them(newest, tmp_path):
    dynappo = [newest, "-m", "dynappo"]
    small = {"run.num_iterations": 20, "run.eval_envs": 16, "run.video_seconds": 0.0}
    fields = [f"--config.{name}={value}" for name, value in small.items()]
    run([*dynappo, "train", "--config=go1:laptop", "--workdir=run", *fields], tmp_path)
    run([*dynappo, "play", "run", "--out=walk.html"], tmp_path)
    run([*dynappo, "export", "run", "--out=policy.onnx"], tmp_path)
    assert (tmp_path / "walk.html").stat().st_size > 1e5
    assert (tmp_path / "policy.onnx").stat().st_size > 1e4
