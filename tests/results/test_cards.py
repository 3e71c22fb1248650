"""experiments/cards.py: lanes of a plan on the GPUs of a host; and that what runs next can run."""

import argparse
import importlib
import os
import shlex
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import pytest

from dynappo.bench import command as bench
from experiments import cards, paper

peers = importlib.import_module("experiments.27_few.peers_table")
ROOT = Path(__file__).resolve().parents[2]
PLAN = ROOT / "experiments/next.txt"


def test_lanes_run_side_by_side_and_end_in_time(tmp_path, monkeypatch):
    """A lane's commands come one after the other; one that takes too long ends, with what it started."""
    child = f"import subprocess as s, time; s.Popen(['sleep', '77']); open('{tmp_path}/began', 'w')"
    child += "; time.sleep(77)"
    plan = tmp_path / "plan.txt"
    plan.write_text(
        f"""# a comment
a 0a 2 {sys.executable} -c "{child}"
a 0a 9 sh -c 'echo card $CUDA_VISIBLE_DEVICES in OUT ${{XLA_PYTHON_CLIENT_PREALLOCATE-all}} > OUT/second.txt'
a 1a 9 false
a 1b 9 sh -c 'echo $XLA_PYTHON_CLIENT_PREALLOCATE > OUT/third.txt'
b 1b 9 touch OUT/fourth.txt
c 0a 9 touch OUT/never.txt
"""
    )
    out = tmp_path / "out"
    monkeypatch.delenv("XLA_PYTHON_CLIENT_PREALLOCATE", raising=False)
    monkeypatch.setattr(sys, "argv", ["cards.py", str(out), str(plan), "a", "b", "--seconds", "60"])
    began = time.monotonic()
    cards.main()
    assert time.monotonic() - began < 30
    assert (tmp_path / "began").exists()
    running = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert "sleep 77" not in running.splitlines()
    assert (out / "second.txt").read_text() == f"card 0 in {out} all\n"
    assert (out / "third.txt").read_text() == "false\n"  # two lanes share the card
    assert "ended after" in (out / "0a.log").read_text()
    assert (out / "1a.log").read_text().endswith(", status 1\n")
    with tarfile.open(f"{out}.tar.xz") as tar:
        assert {Path(name).name for name in tar.getnames()} == {
            "out",
            "0a.log",
            "1a.log",
            "1b.log",
            "second.txt",
            "third.txt",
            "fourth.txt",
        }


def test_a_command_that_runs_elsewhere_writes_into_the_same_folder(tmp_path, monkeypatch):
    """OUT is a whole path, so `env -C` does not move it."""
    (tmp_path / "there").mkdir()
    (tmp_path / "plan.txt").write_text("a 0a 9 env -C there touch OUT/file\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["cards.py", "out", "plan.txt", "a"])
    cards.main()
    assert (tmp_path / "out/file").exists()


def test_where_no_time_is_left_a_command_does_not_begin(tmp_path):
    line = cards.Line("a", "0a", 9.0, f"touch {tmp_path}/never")
    cards.run_lane(tmp_path, [line], time.monotonic() - 1, 1, False)
    assert "has not run" in (tmp_path / "0a.log").read_text()
    assert not (tmp_path / "never").exists()


def test_cards_have_cores_of_their_own():
    every = os.sched_getaffinity(0)
    shares = [cards.cores(card, 2) for card in (0, 1)]
    assert set(shares[0]) | set(shares[1]) <= every
    assert len(every) < 2 or not set(shares[0]) & set(shares[1])
    assert set(cards.cores(0, 1000)) == every


def test_a_part_that_is_none_is_refused_before_one_runs(tmp_path, monkeypatch):
    plan = tmp_path / "plan.txt"
    plan.write_text(f"a 0a 9 touch {tmp_path}/never\n")
    monkeypatch.setattr(sys, "argv", ["cards.py", str(tmp_path / "out"), str(plan), "a", "x"])
    with pytest.raises(SystemExit, match="has no part 'x'"):
        cards.main()
    assert not (tmp_path / "never").exists()


@pytest.mark.parametrize("text", ["a 0a soon true", "a 0a", "a x 9 true"])
def test_a_line_that_is_none_is_refused_with_its_number(tmp_path, text):
    plan = tmp_path / "plan.txt"
    plan.write_text(f"a 0a 9 true\n{text}\n")
    with pytest.raises(SystemExit, match=rf"{plan}:2 is .*expected PART LANE SECONDS COMMAND"):
        list(cards.read(plan))


def test_of_jobs_only_those_run_whose_names_begin_as_asked(tmp_path, monkeypatch):
    less = importlib.import_module("experiments.21_less.run")
    jobs, started = tmp_path / "jobs.txt", []
    jobs.write_text("go1-a go1:best\ngo1-b go1:best\ngo2-a go2:best\n")
    (tmp_path / "go1-b.csv").touch()  # is there already

    def run(command, **_):
        started.append(command[-1])
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(less.subprocess, "run", run)
    for names, expected in (
        (["go1"], ["go1-a"]),
        ([], ["go1-a", "go2-a"]),
        (["go2", "go1-a"], ["go2-a", "go1-a"]),
    ):
        monkeypatch.setattr(sys, "argv", ["run.py", str(tmp_path), str(jobs), *names])
        started.clear()
        less.main()
        assert started == expected
    monkeypatch.setattr(sys, "argv", ["run.py", str(tmp_path), str(jobs), "go1", "x"])
    with pytest.raises(SystemExit, match="x: no job"):
        less.main()


def test_what_runs_next_names_scripts_and_jobs_that_there_are():
    """And a card whose seconds count is one lane's alone."""
    lines, asked = list(cards.read(PLAN)), {}
    assert len(lines) > 5
    for line in lines:
        words, folder = shlex.split(line.command), ROOT
        if words[:2] == ["env", "-C"]:  # runs there
            folder, words = ROOT / words[2], words[3:]
        program, script, *rest = words
        assert program == "python3"
        if script == "-m":  # the bench, whose flags its own parser knows
            assert rest[0] == "dynappo.bench" and bench.parse(rest[1:])
            continue
        assert (folder / script).is_file()
        if script.endswith("/peers.py"):
            names = [x for x in rest[2:] if not x.startswith(("--", "OUT")) and not x.isdigit()]
            settings = paper.jobs(folder / rest[1])
            if "--best" in rest:  # of what a command before it writes
                best = rest[rest.index("--best") + 1]
                assert {*names} <= peers.METHODS.keys()
                assert any(f" {best} " in x.command for x in lines[: lines.index(line)])
                continue
            asked.setdefault(rest[1], set()).update(paper.chosen(settings, names))
        if not script.endswith("/run.py"):
            continue
        parser = argparse.ArgumentParser()
        parser.add_argument("out")
        parser.add_argument("jobs")
        parser.add_argument("names", nargs="*")
        given, _ = parser.parse_known_args(rest)
        if given.jobs.startswith("OUT/"):  # a command before it writes that
            assert any(x.command.endswith(f" {given.jobs}") for x in lines[: lines.index(line)])
            continue
        jobs = [
            job.split()[0] for job in (folder / given.jobs).read_text().splitlines() if job.strip()
        ]
        for name in given.names:
            if not name.isdigit():  # of a flag
                assert any(job.startswith(name) for job in jobs), (line, name)
        if "30_row_cost" in script:
            shared = {x.lane for x in lines if (x.part, x.card) == (line.part, line.card)}
            assert shared == {line.lane}
    for jobs, names in asked.items():  # all but the settings that are whole already
        done = {"sac"}  # of 24_off_policy/jobs.txt
        if "27_few" in jobs:
            done = {name for name, one in peers.settings().items() if one.counts}
        assert names == set(paper.jobs(ROOT / jobs)) - done
