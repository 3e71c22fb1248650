"""Several processes of one run, on this machine: same numbers, one writer, and no one left hanging."""

import csv
import os
import signal
import socket
import subprocess
import sys
import time

import answers
import numpy as np
import pytest
import toy_train
import workdirs
from answers import PATIENCE, ROOT, refused

from dynappo.config import ConfigError
from dynappo.program import build, devices, distributed
from dynappo.run import learning_curves
from dynappo.train import command as train_command

TESTS = ROOT / "tests"


def free_port():
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


def start(workdir, *fields, processes=1, devices=4):
    """The toy training as `processes` processes with `devices` devices in all; their handles."""
    meet = f"--coordinator=127.0.0.1:{free_port()}"
    forced = f"--xla_force_host_platform_device_count={devices // processes}"
    forced = f"{os.environ['XLA_FLAGS']} {forced}"  # the last of two holds
    environment = os.environ | {"XLA_FLAGS": forced, "PYTHONPATH": f"{ROOT}:{TESTS}"}
    command = [sys.executable, TESTS / "toy_train.py", f"--workdir={workdir}"]
    command += [f"--config.{field}" for field in fields]
    several = [[meet, f"--processes={processes}", f"--process={i}"] for i in range(processes)]
    return [
        subprocess.Popen(
            command + (flags if processes > 1 else []),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for flags in several
    ]


def end(handles, timeout=PATIENCE):
    """`[(exit status, stdout, stderr)]`; none of them is left running."""
    try:
        outputs = [handle.communicate(timeout=timeout) for handle in handles]
        return [(h.returncode, *out) for h, out in zip(handles, outputs, strict=True)]
    finally:
        for handle in handles:
            handle.kill()


def table(workdir):
    """metrics.csv without the seconds, `[rows, columns]`."""
    with (workdir / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    return np.array([[float(v or "nan") for k, v in r.items() if k != "seconds"] for r in rows])


def until(condition, handles):
    """Wait for it; fails if a process ends first."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < PATIENCE
        assert all(handle.poll() is None for handle in handles), end(handles)
        time.sleep(0.1)


def saved(workdir):
    """Iterations of the checkpoints that are complete."""
    return [int(p.name) for p in (workdir / "checkpoints").glob("*") if p.name.isdigit()]


UNJUDGED = "run.eval_envs=0"  # an evaluation would only be compiled
LONG = ("run.num_iterations=100000", UNJUDGED)
PLAIN = "schedule.end_steps=0"  # half of the program; the model on several devices: test_seeds.py
SPLIT = ("run.num_seeds=1", "run.mesh_env=2")  # the robots of one seed over two processes


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """Two processes, of which the second is killed -9 after the first checkpoint.

    `(workdir, end of the first)`.
    """
    workdir = tmp_path_factory.mktemp("killed") / "run"
    handles = start(workdir, *LONG, PLAIN, *SPLIT, processes=2, devices=2)
    until(lambda: saved(workdir), handles)
    handles[1].kill()
    return workdir, end(handles[:1])[0]


def test_a_process_that_dies_ends_the_others_within_a_minute_and_they_say_so(killed):
    """A message to it fails, which is a line of ours, or JAX misses its heartbeat and aborts."""
    _, (status, _, errors) = killed
    assert status != 0 and distributed.HEARTBEAT <= 30
    ours = "process 0 of 2 stops, because another one is gone"
    assert ours in errors or "most likely indicates that another task died" in errors


def test_what_was_lost_goes_on_on_one_process_and_other_devices(
    killed, tmp_path, monkeypatch, capsys
):
    """The checkpoint of two processes is resumed by one process on one device, and the numbers are those of
    a run that never stopped and had one device from the start."""
    workdir, _ = killed
    total = max(saved(workdir)) + 4
    fields = f"run.num_iterations={total}", UNJUDGED, PLAIN, "run.num_seeds=1"
    workdirs.toy(monkeypatch)
    monkeypatch.setattr(build, "program", workdirs.compiled_once(build.program))
    monkeypatch.setattr(devices, "own_process", lambda device: None)
    monkeypatch.setattr(learning_curves, "draw", lambda *_: "no picture")
    given = [*toy_train.ARGUMENTS, *(f"--config.{field}" for field in fields)]
    for folder in (workdir, tmp_path / "whole"):
        assert answers.status(train_command.main, *given, f"--workdir={folder}") == 0
    assert f"goes on from iteration {total - 4} of " in capsys.readouterr().out
    found, expected = table(workdir), table(tmp_path / "whole")
    assert found.shape == expected.shape and found[-1, 0] == total
    # chaos grows with the iterations; the first ones are those of the mesh of two processes
    np.testing.assert_allclose(found[:5], expected[:5], rtol=1e-3, atol=1e-4, equal_nan=True)


@pytest.mark.slow
def test_a_second_run_in_the_same_folder_is_refused_and_harms_nothing(tmp_path):
    """Status 2 and one line that names the process; killed -9, the first keeps nobody out."""
    workdir = tmp_path / "run"
    (first,) = start(workdir, "run.num_iterations=100000", devices=1)
    until(lambda: saved(workdir), [first])
    ((status, _, errors),) = end(start(workdir, "run.num_iterations=100000", devices=1))
    assert status == 2 and errors.count("\n") == 1
    assert f"another run is writing in this folder (pid {first.pid} on " in errors
    assert first.poll() is None
    first.kill()
    end([first])
    total = max(saved(workdir)) + 2
    ((status, said, errors),) = end(start(workdir, f"run.num_iterations={total}", devices=1))
    assert status == 0 and f"goes on from iteration {total - 2} of {workdir}" in said, errors
    assert list(table(workdir)[::2, 0]) == list(range(1, total + 1)) and errors == ""


@pytest.mark.slow
def test_processes_meet_stop_together_and_only_the_first_writes_and_speaks(tmp_path):
    """SIGTERM reaches one of them only: both stop after the same chunk, saved, with status 143 where
    the signal came and 0 elsewhere; then one process finds all of it."""
    workdir = tmp_path / "run"
    handles = start(workdir, *LONG, "run.mesh_seed=2", "run.mesh_env=2", processes=2)
    until(lambda: (workdir / "metrics.csv").exists(), handles)
    handles[0].send_signal(signal.SIGTERM)
    (first, said, errors), (second, said_1, errors_1) = end(handles)
    assert (first, second) == (143, 0), (errors, errors_1)
    assert "dynappo trains go1" in said
    assert all(line.startswith("[Gloo]") for line in said_1.splitlines())
    assert "saved at iteration" in errors and "saved at iteration" not in errors_1
    iteration = int(errors.split("saved at iteration ")[1].split()[0])
    assert (workdir / "checkpoints" / f"{iteration}").is_dir()
    assert table(workdir)[-1, 0] == iteration


@pytest.mark.slow
def test_four_processes_compute_what_one_does(tmp_path):
    """Four processes of two devices, as 2 x 4, against one process with one device; then a bad
    workdir is told to all of them."""
    fields = ("run.num_iterations=6", "run.checkpoint_every=6")
    mesh = ("run.mesh_seed=2", "run.mesh_env=4")
    handles = start(tmp_path / "four", *fields, *mesh, processes=4, devices=8)
    handles += start(tmp_path / "one", *fields, devices=1)
    for status, _, errors in end(handles, 2 * PATIENCE):
        assert status == 0, errors
    expected = table(tmp_path / "one")
    np.testing.assert_allclose(table(tmp_path / "four"), expected, rtol=1e-3, atol=1e-4)
    longer = ("run.num_iterations=10", *fields[1:], *mesh)  # what one device saved, on eight
    for status, _, errors in end(
        start(tmp_path / "one", *longer, processes=4, devices=8), 2 * PATIENCE
    ):
        assert status == 0, errors
    assert table(tmp_path / "one")[-1, 0] == 10
    other = ("ppo.gamma=0.9", *fields, *mesh)
    for status, _, errors in end(start(tmp_path / "one", *other, processes=4, devices=8)):
        assert status == 2 and "holds a run of another config (ppo.gamma" in errors


MESSAGES = """
import sys
import jax
from dynappo.config import ConfigError
from dynappo.program import distributed

distributed.join(sys.argv[1], 2, int(sys.argv[2]))
long = "ü" * 100_000
mesh = jax.make_mesh((2,), ("x",), devices=jax.devices())
halves = jax.NamedSharding(mesh, jax.P("x"))
ones = jax.make_array_from_callback((4,), halves, lambda part: jax.numpy.ones(4)[part])
assert distributed.on_first(lambda: {"text": long}) == {"text": long}
assert distributed.on_first(lambda: None) is None
for error, kind in ((ConfigError(long), ConfigError), (ZeroDivisionError(long), Exception)):
    def fails():
        raise error
    try:
        distributed.on_first(fails)
    except kind as caught:
        assert long in str(caught)
    else:
        raise AssertionError(kind)
assert distributed.any_of(not distributed.first()) and not distributed.any_of(False)
value, state = distributed.from_first(lambda s: (7, {"x": s["x"] + 1}), {"x": ones})
assert value == 7 and state["x"].sharding == halves
assert (distributed.whole(state)["x"] == [2, 2, 2, 2]).all()
distributed.leave()
"""


def test_what_the_first_process_finds_reaches_the_others_however_long_it_is():
    """A result, or the error that ends them all; and a state that it changes is the same everywhere."""
    address = f"127.0.0.1:{free_port()}"
    environment = os.environ | {"JAX_PLATFORMS": "cpu", "XLA_FLAGS": "", "PYTHONPATH": str(ROOT)}
    handles = [
        subprocess.Popen(
            [sys.executable, "-c", MESSAGES, address, str(i)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env=environment,
        )
        for i in range(2)
    ]
    for status, _, errors in end(handles):
        assert status == 0, errors


@pytest.mark.parametrize(
    ("flags", "words"),
    [
        (("host:1", 2, None), "--process is missing; several processes need --coordinator, --pro"),
        ((None, 2, 0), "--coordinator is missing"),
        (("host", 2, 0), "--coordinator is 'host', expected HOST:PORT"),
        (("", 2, 0), "--coordinator is '', expected HOST:PORT"),
        (("localhost:65536", 2, 0), "a port from 1 to 65535"),
        (("localhost:²", 2, 0), "a port from 1 to 65535"),
        (("localhost:7", 2, 2), "--process is 2, expected 0 to 1"),
        (("localhost:7", 2, -1), "--process is -1, expected 0 to 1"),
    ],
)
def test_flags_that_do_not_make_a_run_are_refused(flags, words):
    assert words in refused(distributed.join, *flags)


@pytest.mark.parametrize(
    ("variables", "flags", "joins"),
    [
        ({"SLURM_JOB_ID": "7", "SLURM_NTASKS": "4"}, (None, None, None), False),  # a batch script
        ({"SLURM_STEP_NUM_TASKS": "1", "SLURM_PROCID": "0"}, (None, None, None), False),
        ({"SLURM_STEP_NUM_TASKS": "4", "SLURM_PROCID": "2"}, (None, 1, None), False),
        ({"SLURM_STEP_NUM_TASKS": "4", "SLURM_PROCID": "2"}, (None, None, None), True),
        ({}, ("localhost:7", 2, 1), True),
    ],
)
def test_a_step_of_slurm_with_several_tasks_is_left_to_jax(variables, flags, joins, monkeypatch):
    import jax

    calls = []
    monkeypatch.setattr(jax.distributed, "initialize", lambda *args, **_: calls.append(args))
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    distributed.join(*flags)
    assert calls == [flags] * joins


def test_a_lost_process_is_an_error_of_one_line_and_a_defect_stays_one(monkeypatch):
    for error in ("Gloo all-reduce failed\nmore", "UNAVAILABLE: connection reset"):
        for several, kind in ((True, ConnectionError), (False, RuntimeError)):
            monkeypatch.setattr(distributed, "several", lambda several=several: several)
            with pytest.raises(kind) as caught, distributed.watched():
                raise RuntimeError(error)
    assert str(caught.value) == error
    monkeypatch.setattr(distributed, "several", lambda: True)
    with pytest.raises(ConnectionError, match=r"^process 0 of 1 stops, .*\(gloo failed\)$"):
        with distributed.watched():
            raise RuntimeError("gloo failed\nmore")
    for defect in (ZeroDivisionError("a"), ConfigError("the connection")):
        with pytest.raises(type(defect)), distributed.watched():
            raise defect


def test_with_one_process_nothing_is_asked_of_the_others():
    state = {"x": np.ones(3)}
    assert distributed.first() and distributed.any_of(True) and not distributed.any_of(False)
    assert distributed.on_first(lambda: 7) == 7 and distributed.whole(state) is state
    assert distributed.from_first(lambda s: (1, s), state) == (1, state)
    with distributed.together():
        distributed.barrier()
    distributed.leave()


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"SLURM_STEP_TASKS_PER_NODE": "8(x2)"}, None),  # all are visible: the one of its number
        ({"SLURM_STEP_TASKS_PER_NODE": "2", "CUDA_VISIBLE_DEVICES": "0,1"}, None),
        ({"SLURM_STEP_TASKS_PER_NODE": "4", "CUDA_VISIBLE_DEVICES": "3"}, [0]),  # --gpus-per-task=1
        ({"SLURM_STEP_TASKS_PER_NODE": "1(x2)", "CUDA_VISIBLE_DEVICES": "0,1,2,3"}, [0, 1, 2, 3]),
    ],
)
def test_every_task_of_slurm_gets_the_gpus_that_are_its_own(variables, expected):
    assert distributed.slurm_devices(variables) == expected
