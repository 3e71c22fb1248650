"""Ctrl-C, SIGTERM and SIGHUP: what a process that hears them does, and one whose main thread is deaf."""

import signal
import subprocess
import sys
import time

import pytest
from answers import PATIENCE, ROOT, shell

from dynappo.config import stop as stop_lib
from dynappo.config.stop import Stop

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such signals")
# as XLA's compiler, it is in C for ever, without the lock of Python: it asks twice for one lock, which no
# signal interrupts
DEAF = "[lock(mutex) for _ in 'ab']"
LOCK = "import ctypes; c, mutex = ctypes.CDLL(None), ctypes.create_string_buffer(256)\n"
LOCK += "c.pthread_mutex_init(mutex, None); lock = c.pthread_mutex_lock\n"


def started(code):
    """A process that runs `code`, once it has said that it begins."""
    # pytest may be under nohup, or in a background that ignores ctrl-C: a process inherits that
    heard = "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"
    heard += "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
    code = f"import signal, time\n{LOCK}{heard}from dynappo.config.stop import Stop\n{code}"
    pipe = subprocess.PIPE
    command = [sys.executable, "-c", code]
    process = subprocess.Popen(command, cwd=ROOT, stdout=pipe, stderr=pipe, text=True)
    assert process.stdout.readline() == "begins\n", process.communicate()
    return process


def ended(process):
    """`(exit status, what it said on stderr)`."""
    try:
        _, said = process.communicate(timeout=PATIENCE)
    finally:
        process.kill()
    return process.returncode, said


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_main_thread_that_does_not_hear_it_is_ended(number):
    process = started(  # the signal may come just before it is deaf
        "with Stop():\n  while True:\n    try: print('begins', flush=True); " + DEAF + "\n"
        "    except KeyboardInterrupt: pass"
    )
    process.send_signal(number)
    assert ended(process) == (128 + number, "dynappo: stopped\n")


def test_what_catches_the_interruption_is_ended():
    """As trimesh does where it imports."""
    process = started(
        "with Stop():\n  try: print('begins', flush=True); time.sleep(999)\n"
        "  except BaseException: pass\n  time.sleep(999)"
    )
    process.send_signal(signal.SIGINT)
    assert ended(process) == (130, "dynappo: stopped\n")


def test_where_a_run_trains_the_second_signal_ends_it():
    """The first asked it to save when it is back in Python."""
    process = started(
        f"with Stop() as stop: stop.patient = True; print('begins', flush=True); {DEAF}"
    )
    end = time.monotonic() + PATIENCE
    while process.poll() is None and time.monotonic() < end:
        process.send_signal(signal.SIGTERM)
        time.sleep(0.3)
    assert ended(process) == (143, "dynappo: stopped\n")


def test_where_a_run_trains_the_first_signal_is_answered_at_once():
    """Though the main thread is deaf; once, whatever comes in the next second; then the second ends it."""
    process = started(
        "with Stop() as stop: stop.patient, stop.waits = True, 'stopping soon'; stop.ended = lambda: 'ended'"
        f"; print('begins', flush=True); {DEAF}"
    )
    for _ in range(2):
        process.send_signal(signal.SIGINT)
    assert process.stderr.readline() == "dynappo: stopping soon\n"
    assert process.poll() is None
    time.sleep(stop_lib.AGAIN + 0.2)
    process.send_signal(signal.SIGINT)
    assert ended(process) == (130, "dynappo: ended\n")


@pytest.mark.parametrize("line", ["1 / 0", "time.sleep(999)"])
def test_a_line_on_the_end_that_cannot_be_found_holds_nothing_up(line):
    """As where it waits for a lock that the main thread has."""
    process = started(
        f"with Stop() as stop:\n  stop.ended = lambda: {line}\n  while True:\n"
        f"    try: print('begins', flush=True); {DEAF}\n    except KeyboardInterrupt: pass"
    )
    process.send_signal(signal.SIGTERM)
    assert ended(process) == (143, "dynappo: stopped\n")


def test_before_a_run_trains_a_signal_interrupts():
    """Then the handlers are as they were."""
    before = signal.getsignal(signal.SIGTERM)
    with Stop() as stop, pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGTERM)
    assert stop.status == 143 and signal.getsignal(signal.SIGTERM) is before


def test_a_signal_that_comes_while_a_module_is_imported_ends_it_at_once(tmp_path):
    """Nothing is raised there: jaxlib, while it is loaded, crashes of a KeyboardInterrupt. What was printed
    is written."""
    (tmp_path / "taking.py").write_text("import signal; signal.raise_signal(signal.SIGTERM)")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\nfrom dynappo.config.stop import Stop\n"
    )
    code += "with Stop() as stop:\n  stop.ended = lambda: 'ended'; print('before')\n"
    code += "  try: import taking\n  except BaseException as error: print(repr(error))\n  print('after')"
    done = shell("-c", code)
    assert (done.returncode, done.stdout, done.stderr) == (143, "before\n", "dynappo: ended\n")


def test_a_command_hears_signals_before_its_own_imports(tmp_path):
    """As where it imports ml_collections, long before `Stop` is there; not so what imports this package."""
    (tmp_path / "ml_collections.py").write_text(
        "import signal; signal.raise_signal(signal.SIGTERM)"
    )
    (tmp_path / "theirs").mkdir()
    (tmp_path / "theirs" / "__init__.py").write_text("import dynappo, signal, sys")
    told = "from theirs import *; print(signal.getsignal(15) is signal.SIG_DFL, sys.excepthook is "
    (tmp_path / "theirs" / "__main__.py").write_text(f"{told}sys.__excepthook__)")
    for module in (("-m", "dynappo"), ("-m", "dynappo.play"), ("-mdynappo.play",)):
        done = shell(*module, first=tmp_path)
        assert (done.returncode, done.stderr) == (143, "dynappo: stopped\n"), module
    done = shell("-m", "theirs", first=tmp_path)
    assert done.stdout == "True True\n", done.stderr


def test_a_signal_that_is_sent_twice_asks_once(monkeypatch):
    """As by a shell and by what runs in it; only one that comes later is a second one."""
    with Stop() as stop:
        stop.patient = True
        monkeypatch.setattr(stop_lib, "AGAIN", float("inf"))
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        assert stop.status == 130
        monkeypatch.setattr(stop_lib, "AGAIN", -1.0)
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
    assert stop.status == 143


def test_what_nohup_started_outlives_the_terminal():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with Stop() as stop:
            signal.raise_signal(signal.SIGHUP)
        assert stop.status == 0 and signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_one_inside_another_gives_its_handlers_and_its_watch_back():
    def heard():
        return [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)]

    before = heard()
    with Stop() as outer:
        between, fd = heard(), outer.ours.fileno()
        with Stop():
            assert heard() != between
        assert heard() == between
        assert signal.set_wakeup_fd(fd) == fd
    assert heard() == before


def test_an_import_that_is_interrupted_in_c_is_no_bug():
    """pybind11 makes an ImportError of the KeyboardInterrupt."""
    done = shell(
        "-c",
        "import signal\nfrom dynappo.config import flags\n"
        "def imported(name):\n  try: signal.raise_signal(signal.SIGTERM)\n"
        "  except KeyboardInterrupt as stop: raise ImportError('initialization failed') from stop\n"
        "flags.importlib.import_module = imported\nflags.start('play')",
    )
    assert (done.returncode, done.stderr) == (143, "dynappo: stopped\n")


# of a checkpoint only the line is another one: train/test_command.py
CHECKPOINT = pytest.param("a checkpoint", marks=pytest.mark.slow)


@pytest.mark.parametrize("there", ["nothing", CHECKPOINT, "a file of the user's"])
def test_a_run_that_compiles_is_stopped(there, tmp_path):
    """Its threads would compile for an hour, and Python would wait for them. A new folder is gone again."""
    run, users = tmp_path / "runs" / "mine", there == "a file of the user's"
    after = "there is no checkpoint yet, the same command starts anew"
    if there == "a checkpoint":
        (run / "checkpoints" / "40").mkdir(parents=True)
        after = "the same command goes on from iteration 40"
    code = (
        f"{LOCK}import sys; sys.path.insert(0, 'tests')\n"
        "import toy_env, toy_train, jax\nfrom dynappo.config import flags\n"
        "from dynappo.tasks.velocity import env\n"
        "env.make = lambda *_, **__: toy_env.make()\n"
        f"import pathlib; run = pathlib.Path({str(run)!r})\n"
        f"def compile(*_):\n  if {users}: (run / 'notes.txt').touch()\n"
        f"  print('begins', flush=True); {DEAF}\n"
        "jax.stages.Lowered.compile = compile\n"
        "from dynappo.run import workdir; workdir._compare = lambda *_: None\n"
        # plain PPO is traced in a third of the time
        "sys.argv[1:] = [*toy_train.ARGUMENTS, '--config.schedule.end_steps=0', f'--workdir={run}']\n"
        "flags.start('train')"
    )
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=pipe, stderr=pipe, text=True
    )
    for line in process.stdout:
        if line == "begins\n":
            process.send_signal(signal.SIGTERM)
            break
    code, said = ended(process)
    assert (code, said) == (143, f"dynappo: stopped; {after}\n")
    assert (tmp_path / "runs").exists() == run.exists() == (there != "nothing")
    kept = {"config.json", "lock", "notes.txt"}
    assert not users or {path.name for path in run.iterdir()} == kept
