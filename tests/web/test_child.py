"""The page as a process of its own: of `train --serve`, and of `play --serve` as a person calls it."""

import os
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request

import pytest
from answers import PATIENCE, ROOT
from toy_policy import described, save

from dynappo import config as config_lib
from dynappo.web import address, child

server = pytest.importorskip("dynappo.web.server", reason="mjviser is not installed (extra web)")


@pytest.fixture(autouse=True)
def here(monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT))


@pytest.fixture
def run(tmp_path):
    """The folder of a run that has just begun."""
    config, _ = described()
    (tmp_path / "config.json").write_text(config_lib.to_json(config))
    return tmp_path


def free():
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def answers(port, seconds=PATIENCE):
    """Whether a page is there within `seconds`."""
    end = time.monotonic() + seconds
    while True:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}", timeout=5) as answer:
                return b"<html" in answer.read(2000)
        except OSError:
            if time.monotonic() > end:
                return False
            time.sleep(0.2)


def test_a_run_that_begins_is_served_until_training_ends(run):
    port = free()
    with child.serving(run, str(port)):
        assert answers(port)
        save(run / "policy.npz")  # the first policy of the run, which the page takes
        time.sleep(2)
        assert answers(port)
    assert not answers(port, 0)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_the_page_ends_with_a_training_that_is_killed(run):
    port = free()
    code = (
        "import pathlib, time; from dynappo.web import child\n"
        f"with child.serving(pathlib.Path({str(run)!r}), '{port}'): time.sleep(999)"
    )
    training = subprocess.Popen([sys.executable, "-c", code])
    assert answers(port)
    training.kill()
    training.wait()
    end = time.monotonic() + PATIENCE
    while answers(port, 0) and time.monotonic() < end:
        time.sleep(0.2)
    assert not answers(port, 0)


def test_without_the_flag_nothing_is_started(run, monkeypatch):
    started = []
    monkeypatch.setattr(subprocess, "Popen", lambda *given, **_: started.append(given))
    with child.serving(run, None):
        assert not started
    assert not started


def test_a_page_that_cannot_start_says_so_and_stops_no_training(tmp_path, capfd):
    trained, said, end = False, "", time.monotonic() + PATIENCE
    with child.serving(tmp_path / "nothing", str(free())):
        while not said and time.monotonic() < end:
            time.sleep(0.2)
            said = capfd.readouterr().err
        trained = True
    assert trained and said.startswith("dynappo: ") and "nothing" in said


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signal")
def test_ctrl_c_ends_all_and_the_port_is_free_again(tmp_path):
    port = free()
    command = [sys.executable, "-m", "dynappo.play", str(save(tmp_path / "policy.npz"))]
    process = subprocess.Popen(
        [*command, f"--serve={port}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ,
    )
    said = [process.stdout.readline() for _ in range(2)]
    assert answers(port)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 130 and err == "dynappo: stopped\n"
    assert f"open http://127.0.0.1:{port} in a browser" in said[1] and not out
    assert address.free(address.Address("127.0.0.1", port))[1] == port
