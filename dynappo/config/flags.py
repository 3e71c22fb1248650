"""What every command shares: how it reads its flags, and how it ends."""

from __future__ import annotations

import _thread
import argparse
import contextlib
import difflib
import errno
import importlib
import io
import os
import re
import reprlib
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from dynappo import config as config_lib
from dynappo.config import ConfigError, fields, files, ground_map, shell, terms
from dynappo.config.stop import Stop, leave

# errno values caused by a bad path; others are failures of input or output
BAD_PATH = (
    *(errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EACCES, errno.EPERM),
    *(errno.ENAMETOOLONG, errno.ELOOP),
)
LONGEST = 600  # characters of a path
LINE = 4000  # of a line: a robot's file may break every rule
# flags of other trainers, and what `train` has for them
OF_OTHERS = {
    **dict.fromkeys(("task", "env", "env_name"), "here it is --config=NAME"),
    "resume": "the same command goes on, and so does --workdir=DIR alone",
    **dict.fromkeys(
        ("load_run", "checkpoint"),
        "--workdir=DIR goes on with a run, --restore=SOURCE starts from its policy",
    ),
    **dict.fromkeys(
        ("max_iterations", "num_timesteps"),
        "here it is --config.run.num_iterations=N, in iterations",
    ),
    **dict.fromkeys(
        ("experiment_name", "run_name", "logdir", "log_dir"), "here it is --workdir=DIR"
    ),
    "logger": "--config.run.wandb=PROJECT logs to Weights & Biases",
}
STOPPED = (129, 130, 143)  # exit statuses of a command that was stopped by a signal


class Help(argparse.RawDescriptionHelpFormatter):
    """Help whose commands and files are as they can be typed and found here."""

    def format_help(self) -> str:
        return shell.pasted(super().format_help())


def parser(command: str, description: str, epilog: str) -> argparse.ArgumentParser:
    """A parser of `dynappo COMMAND`; the commands in `epilog` are printed as they are called here."""
    return argparse.ArgumentParser(
        prog=f"dynappo {command}",
        description=description,
        epilog=epilog,
        formatter_class=Help,
        allow_abbrev=False,
        exit_on_error=False,
    )


def read_known(
    of: argparse.ArgumentParser, argv: list[str] | None
) -> tuple[argparse.Namespace, list[str]]:
    """`(flags, the rest)` of `argv`, or of the command line; ConfigError if one cannot be understood.

    The rest is for a command that takes fields of the config, too (`set_fields`).
    """
    argv = sys.argv[1:] if argv is None else argv
    try:
        flags, rest = of.parse_known_args(argv)
    except argparse.ArgumentError as error:
        hint = "; write it as --flag=VALUE" if "expected one argument" in str(error) else ""
        raise ConfigError(str(error).removeprefix("argument ") + hint) from None
    for name, value in vars(flags).items():
        if value == [] or str(value) == "--":  # what argparse makes of `--flag=--`; Python 3.13
            raise ConfigError(f"--{name.replace('_', '-')}: expected a value, not '--'")
    return flags, rest


def read(of: argparse.ArgumentParser, argv: list[str] | None) -> argparse.Namespace:
    """The flags; ConfigError also where there are others."""
    flags, rest = read_known(of, argv)
    if rest:
        if not (meant := _meant(of, rest[0])) and not rest[0].startswith("-"):
            # a second policy, or the value of a flag that has none
            if "NAME_OR_DIR" in of.format_usage():
                raise ConfigError(
                    f"{rest[0]}: expected one NAME_OR_DIR, and flags that begin with --"
                )
        of_all = f"python -m {of.prog.replace(' ', '.')} --help lists them"
        raise ConfigError(f"{rest[0]}: no such flag; {meant or of_all}")
    return flags


def read_with_fields(
    of: argparse.ArgumentParser, argv: list[str] | None
) -> tuple[argparse.Namespace, list[str]]:
    """As `read_known`; ConfigError where the rest has more than `--config.GROUP.FIELD=VALUE`."""
    flags, rest = read_known(of, argv)
    for word, _ in _fields(rest):
        if not word.startswith("--config."):
            unnamed = getattr(flags, "config", "") is None
            raise ConfigError(_no_flag(word, _meant(of, word, unnamed)))
    short = {"--terms": "task.terms", "--logs": "run.logs"}
    known = {flag: str(getattr(flags, flag[2:], None) or "") for flag in short}
    of_rest = given(rest)
    for flag, field in short.items():
        if known[flag] and of_rest.get(field, known[flag]) != known[flag]:
            raise ConfigError(
                f"{flag}={known[flag]} and --config.{field}={of_rest[field]} set one field; expected one of "
                "them"
            )
    return flags, rest  # of a flag given twice the last counts, as scripts that end in "$@" expect


def _meant(of: argparse.ArgumentParser, word: str, unnamed: bool = False) -> str:
    """What may be meant by a word that is no flag of a command: a flag like it, or, where `unnamed` says that
    --config is missing, a config or the folder of a run; "" where nothing is."""
    usage = of.format_usage()
    if other := _of_others(usage, word):
        return other
    known, near = re.findall(r"--[a-z][a-z-]*", usage), []
    if word.startswith("-") or "=" in word:
        near = difflib.get_close_matches(f"--{word.lstrip('-').partition('=')[0]}", known, 1, 0.75)
    elif unnamed and os.path.isdir(word) and "--workdir" in known:
        near = [f"--workdir={word}"]
    elif unnamed and re.fullmatch(r"([A-Za-z_]\w*|.*\.py)(:\w+)*", word):
        near = [f"--config={word}"]
    return f"did you mean {near[0]}?" if near else ""


def _of_others(usage: str, word: str) -> str:
    """What a command of this `usage` has in the place of another trainer's flag; "" where it has nothing."""
    name = _bare(word)
    if name not in OF_OTHERS or not word.startswith("-"):
        return ""
    of_task = OF_OTHERS[name] == OF_OTHERS["task"]
    if "--workdir" in usage or (of_task and "--config" in usage):
        return OF_OTHERS[name]
    if of_task and "CONFIG" in usage:
        return "name the config without a flag"
    named = "NAME_OR_DIR" in usage and name not in ("max_iterations", "num_timesteps", "logger")
    return "name the policy, or the folder of its run, without a flag" if named else ""


def _bare(word: str) -> str:
    return word.lstrip("-").partition("=")[0].replace("-", "_")


def _no_flag(word: str, meant: str = "") -> str:
    """The line on a word that is no flag: the field of its name, or what was `meant`."""
    name = _bare(word)
    named = [f"--config.{n}" for n in fields.every() if n.rpartition(".")[2] == name]
    named = [] if name in OF_OTHERS and meant else named  # `env` follows from a config
    expected = f"expected {' or '.join(named or ['--config.GROUP.FIELD'])}=VALUE"
    return f"{word}: no such flag; {expected if named or not meant else meant}"


def _fields(rest: list[str]) -> Iterator[tuple[str, str]]:
    """`(flag, value)` of `--flag=value` and of `--flag value`; the flag may be anything."""
    words = iter(rest)
    for word in words:
        flag, equals, value = (
            word.partition("=") if word.startswith("--config.") else (word, "=", "")
        )
        yield flag, value if equals else next(words, "")


def given(rest: list[str]) -> dict[str, str]:
    """The texts of every `--config.GROUP.FIELD=VALUE` of `rest`, by field."""
    found = [(flag.partition("--config.")[2], text) for flag, text in _fields(rest)]
    return {name: text for name, text in found if name}


def load(spec: str | None, rest: list[str], flag: str = "--config"):
    """The config `--config=SPEC` with every `--config.GROUP.FIELD=VALUE` of `rest`; not validated."""
    return load_both(spec, rest, flag)[0]


def load_both(spec: str | None, rest: list[str], flag: str = "--config"):
    """`load(spec, rest)`, and the `get_env` that the file may define (`loading.load_both`)."""
    if not spec:
        raise ConfigError("--config is missing; try --config=go1:laptop")
    config, get_env = config_lib.load_both(spec, flag)
    set_fields(config, rest)
    return config, get_env


def load_run(workdir: Path, rest: list[str], kept: str = ""):
    """The config of the run in `workdir`, with every flag of `rest`; not validated.

    `kept` is its text where the file is lost.
    """
    try:
        text = kept or (workdir / "config.json").read_text(encoding="utf-8")
        config = config_lib.from_json(text)
    except UnicodeDecodeError:
        raise ConfigError(f"{workdir}/config.json: it is not text") from None
    except ConfigError as error:
        raise ConfigError(f"{workdir}/config.json: {error}; name the run's --config too") from None
    if config.env:
        set_fields(config, rest)
        return config
    if not config.robot:
        raise ConfigError(
            f"--workdir={workdir}: it trains an environment of your own; name its file too: --config=FILE.py"
        )
    xml = f"{config.robot}/{config.robot}.xml"
    if not files.find("robots", xml):
        raise ConfigError(
            f"--workdir={workdir}: there is no robots/{xml} here; write it from the run by "
            f"python -m dynappo.export {shell.quoted(str(workdir))} {shell.quoted(f'--out=robots/{xml}')}"
        )
    set_fields(config, rest)
    check_terms(config, workdir)
    return config


def check_terms(config, workdir: Path) -> None:
    """ConfigError if a run's own config names terms of one's own, whose file this command line does not."""
    try:
        terms.of(config.task)
    except ConfigError as error:
        raise ConfigError(f"--workdir={workdir}: {error}") from None


def set_fields(config, rest: list[str]) -> None:
    """Set every `--config.GROUP.FIELD=VALUE` of `rest`."""
    # the file of terms first: others may be fields of these
    for flag, text in sorted(_fields(rest), key=lambda given: given[0] != "--config.task.terms"):
        if not flag.startswith("--config."):
            raise ConfigError(_no_flag(flag))
        config_lib.override(config, flag.removeprefix("--config."), text)
    ground_map.settle(config, any(flag.startswith("--config.task.tiles.") for flag in rest))


def path(text: str) -> Path:
    """For `add_argument(type=path)`: an empty one would mean the working directory."""
    if not text:
        raise argparse.ArgumentTypeError("is empty, expected a path")
    if len(text) > LONGEST:  # to make so many folders Python would need a deeper stack
        raise argparse.ArgumentTypeError(f"has {len(text)} characters, expected at most {LONGEST}")
    try:
        os.fsencode(text).decode()
    except UnicodeDecodeError:  # files there would have names that no text can hold
        raise argparse.ArgumentTypeError(f"is {text!r}, which is not UTF-8") from None
    return Path(text)


def whole(name: str, text: str, least: int, most: int = 2**31 - 1) -> int:
    """The integer of `--NAME=TEXT`; ConfigError if it is none, or not from `least` to `most`."""
    try:
        value = int(text)
    except ValueError:  # also of more digits than Python reads
        value = least - 1
    if not least <= value <= most:
        raise ConfigError(
            f"--{name}={reprlib.repr(text)}: expected an integer of {least} or more, at most {most:,}"
        )
    return value


def check_writable(out: Path, flag: str = "out") -> None:
    """ConfigError if no file can be written at `out`, the value of a flag; leaves nothing behind."""
    missing: list[Path] = []
    try:
        target = out.resolve()  # what a link points to may be missing
        fresh = not target.exists()
        missing += [folder for folder in target.parents if not folder.exists()]
        target.parent.mkdir(parents=True, exist_ok=True)
        files.check_regular(target)
        target.open("ab").close()
    except (OSError, RuntimeError) as error:  # links in a circle
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(f"--{flag}={out}: cannot write there ({reason})") from None
    else:
        if fresh:
            target.unlink()
    finally:
        for folder in missing:
            with contextlib.suppress(OSError):
                folder.rmdir()


def check_kept(out: Path, inputs: dict[str, Path | str | None], flag: str = "out") -> None:
    """ConfigError if `out`, the value of a flag, is one of the files that are read: they are named by what
    they are, and need not exist."""
    for what, path in inputs.items():
        if path and os.path.exists(path) and os.path.exists(out) and os.path.samefile(path, out):
            raise ConfigError(f"--{flag}={out}: this would overwrite {what}; choose another file")


def start(command: str) -> None:
    """Run `dynappo.COMMAND`, whatever MUJOCO_GL is.

    MuJoCo reads it when it is imported, and fails where it names what is not there. No command draws
    in its own process: films are made in another (policy/render.py), the viewer has its own window.
    """
    os.environ["MUJOCO_GL"] = "disable"
    stop = Stop()
    try:
        with stop:
            importlib.import_module(f"dynappo.{command}.command").main()
    except SystemExit as end:
        if end.code in STOPPED:
            leave(end.code)
        raise
    except Exception:  # C++ has made another of the KeyboardInterrupt
        if not stop.interrupted.is_set():
            raise
        print("dynappo: stopped", file=sys.stderr)
        leave(stop.status)


def answer(action: Callable[[], None], stopped: str | Callable[[], str] = "stopped") -> None:
    """Run `action`; turn its end into one line and an exit status. Only this function decides that.

    Status 2: the user asked for something impossible. 1: numbers blew up, the machine failed (disk, memory,
    another process), or the reader of a pipe has gone, which prints nothing. 130, or the KeyboardInterrupt's
    own status: interrupted, with the line `stopped`. A bug keeps its traceback.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what a terminal has no letter for
            stream.reconfigure(errors="backslashreplace")
    line, code = "", 0
    before, sys.unraisablehook = sys.unraisablehook, _interrupt_again
    try:
        action()
    except SystemExit as end:  # of --help
        code = end.code
    except KeyboardInterrupt as stop:
        line, code = stopped if isinstance(stopped, str) else stopped(), (*stop.args, 130)[0]
    except BrokenPipeError:
        code = 1
    except Exception as error:
        line, code = _explained(error)
        if not line:
            raise
    finally:
        sys.unraisablehook = before
    try:
        if sys.stdout:
            sys.stdout.flush()
    except BrokenPipeError:  # else Python would complain of it at its end
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        code = code or 1
    if line:
        print(f"dynappo: {_one_line(shell.pasted(line))}", file=sys.stderr)
    if code:
        sys.exit(code)


def _interrupt_again(lost) -> None:
    """Python prints what a finalizer raises (JAX has some), and goes on; ctrl-C is raised again instead."""
    if not isinstance(lost.exc_value, KeyboardInterrupt):
        sys.__unraisablehook__(lost)
        return
    begun = None
    while (
        begun is None
    ):  # one that comes meanwhile is ignored; a `threading.Thread` would be waited for
        with contextlib.suppress(KeyboardInterrupt):
            status = (*lost.exc_value.args, 130)[0]
            begun = _thread.start_new_thread(_interrupt_later, (signal.Signals(status - 128),))


def _interrupt_later(number: signal.Signals) -> None:
    time.sleep(0.05)
    _interrupt(number)


def _interrupt(number: signal.Signals = signal.SIGINT) -> None:
    """Signals the main thread, also where it waits in a system call; Windows has only the plainer way."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(number)


def _explained(error: Exception) -> tuple[str, int]:
    """The line for an error, and the exit status; a bug of dynappo has no line."""
    text = str(error)
    if isinstance(error, ImportError) and re.search("map segment|allocate memory", text):
        return "out of memory (Python's imports); take a larger machine", 1
    if isinstance(error, ConfigError):
        return text, 2
    if isinstance(error, FloatingPointError):
        return text, 1
    if isinstance(error, MemoryError):
        return f"out of memory ({text or 'Python'}); ask for less, or take a larger machine", 1
    if "RESOURCE_EXHAUSTED" in text:  # JAX, which is not imported here
        return (
            f"out of memory ({text.splitlines()[0][:160]}); ask for less, or take more devices",
            1,
        )
    if isinstance(error, OSError) and error.strerror:
        name = error.filename or _unnamed()
        if error.errno in BAD_PATH:
            return f"{name} cannot be used ({error.strerror}); name another file or folder", 2
        return f"{name} cannot be read or written ({error.strerror})", 1
    return (text, 1) if isinstance(error, OSError) else ("", 1)  # a library, not a file


def _unnamed() -> str:
    """What an error that names no file is about."""
    try:
        os.getcwd()
    except OSError:
        return "the working directory"
    return "a file"


def _one_line(text: str) -> str:
    """A text that may hold anything that a user typed, as one line that a terminal can show."""
    if len(text) > LINE:
        half = LINE // 2
        text = f"{text[:half]} ... {text[-half:]}"
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)
