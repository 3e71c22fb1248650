"""experiments/cards.py: lanes of a plan on the GPUs of a host; and that what runs next can run."""

import argparse
import csv
import importlib
import os
import shlex
import signal
import subprocess
import sys
import tarfile
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from dynappo.bench import command as bench
from experiments import cards, paper

peers = importlib.import_module("experiments.27_few.peers_table")
fresh = importlib.import_module("experiments.24_off_policy.fresh")
ROOT = Path(__file__).resolve().parents[2]
PLAN = ROOT / "experiments/next.txt"
COUNTED = cards.counted


@pytest.fixture(autouse=True)
def no_cards(monkeypatch):
    """As on a machine without NVIDIA's driver, wherever the tests run."""
    monkeypatch.setattr(cards, "counted", lambda lines: False)


def test_lanes_run_side_by_side_and_end_in_time(tmp_path, monkeypatch):
    """A lane's commands come one after the other; one that takes too long ends, with what it started."""
    long = 7700 + os.getpid() % 1000 / 1000  # told apart from those of other runs of this test
    child = (
        f"import subprocess as s, time; s.Popen(['sleep', '{long}']); open('{tmp_path}/began', 'w')"
    )
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
    assert f"sleep {long}" not in running.splitlines()
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
    call = cards.Call(tmp_path, time.monotonic() - 1, 1, False, threading.Event())
    cards.run_lane(call, [line], False)
    assert "has not run" in (tmp_path / "0a.log").read_text()
    assert not (tmp_path / "never").exists()


def test_a_lane_whose_card_is_not_there_is_refused_before_one_runs(tmp_path, monkeypatch, capsys):
    """nvidia-smi lists one card, and a part of it. On that JAX may not fall back to the CPU. Where there is
    no nvidia-smi this is said."""
    monkeypatch.setattr(cards, "counted", COUNTED)
    smi, plan = tmp_path / "bin/nvidia-smi", tmp_path / "plan.txt"
    smi.parent.mkdir()
    smi.write_text("#!/bin/sh\necho 'GPU 0: NVIDIA H200 (UUID: x)'; echo '  MIG 1g.18gb'\n")
    smi.chmod(0o755)
    monkeypatch.setenv("PATH", f"{smi.parent}:{os.environ['PATH']}")
    plan.write_text("a 0a 9 sh -c 'echo $JAX_PLATFORMS > OUT/said'\nb 1a 9 touch OUT/never\n")
    words = ["cards.py", str(tmp_path / "out"), str(plan), "a"]
    monkeypatch.setattr(sys, "argv", [*words, "b"])
    with pytest.raises(SystemExit, match="^lane 1a is of card 1, but nvidia-smi lists 1$"):
        cards.main()
    assert not (tmp_path / "out").exists()
    monkeypatch.setattr(sys, "argv", words)
    cards.main()
    assert (tmp_path / "out/said").read_text() == "cuda,cpu\n"
    capsys.readouterr()
    monkeypatch.setenv("PATH", "")
    assert not cards.counted([cards.Line("a", "7a", 9.0, "true")])
    assert capsys.readouterr().out.startswith("no nvidia-smi: cards are not counted")


def test_a_program_that_is_none_leaves_the_lanes_other_commands_and_the_packed_folder(
    tmp_path, monkeypatch
):
    plan, out = tmp_path / "plan.txt", tmp_path / "out"
    plan.write_text("a 0a 9 no-such-program\na 0a 9 touch OUT/second OUT/a.0.npz\n")
    monkeypatch.setattr(sys, "argv", ["cards.py", str(out), str(plan), "a"])
    cards.main()
    assert "no-such-program: has not run: [Errno 2]" in (out / "0a.log").read_text()
    with tarfile.open(f"{out}.tar.xz") as tar:
        assert tar.getnames() == ["out", "out/0a.log", "out/second"]


def test_the_folder_is_packed_on_the_way(tmp_path, monkeypatch):
    """So a call that is killed has lost a minute. A file that is renamed meanwhile is left out."""
    plan, out = tmp_path / "plan.txt", tmp_path / "out"
    plan.write_text(
        f"a 0a 20 sh -c 'until cp OUT.tar.xz {tmp_path}/on_the_way; do sleep 0.1; done'\n"
    )
    monkeypatch.setattr(cards, "EVERY", 0.2)
    monkeypatch.setattr(sys, "argv", ["cards.py", str(out), str(plan), "a"])
    cards.main()
    assert (out / "0a.log").read_text().endswith("status 0\n")
    with tarfile.open(tmp_path / "on_the_way") as tar:
        assert tar.getnames() == ["out", "out/0a.log"]
    (out / "b.csv").write_text("whole")
    listed = [out / "a.csv.new", out / "b.csv"]
    monkeypatch.setattr(Path, "rglob", lambda *_: listed)
    cards.pack(out)
    with tarfile.open(f"{out}.tar.xz") as tar:
        assert tar.getnames() == ["out", "out/b.csv"]
        assert tar.extractfile("out/b.csv").read() == b"whole"


def test_ended_by_a_signal_it_ends_its_commands_and_packs_what_they_wrote(tmp_path):
    plan, out = tmp_path / "plan.txt", tmp_path / "out"
    plan.write_text(
        f"a 0a 60 sh -c 'echo > OUT/began; sleep 88.{os.getpid()}; true'\na 0a 60 touch OUT/never\n"
    )
    command = [sys.executable, cards.__file__, str(out), str(plan), "a"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    for _ in range(200):
        if (out / "began").exists():
            break
        time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    said, _ = process.communicate(timeout=30)
    assert process.returncode == 128 + signal.SIGTERM
    assert "touch OUT/never: has not run: all end" in said
    running = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert f"sleep 88.{os.getpid()}" not in running.splitlines()
    with tarfile.open(f"{out}.tar.xz") as tar:
        assert tar.getnames() == ["out", "out/0a.log", "out/began"]


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


@pytest.mark.parametrize("text", ["a 0a soon true", "a 0a", "a x 9 true", "a 0a 9 echo 'x"])
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
        failed = command[-1] == fails
        return subprocess.CompletedProcess(command, failed, "", "out of memory\n" * failed)

    fails = ""

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
    # one that fails: the others run, why is beside what its log said, and the command fails
    monkeypatch.setattr(sys, "argv", ["run.py", str(tmp_path), str(jobs)])
    (tmp_path / "go1-a.log").write_text("seed 100: value_loss is not finite in iteration 3\n")
    started.clear()
    fails = "go1-a"
    with pytest.raises(SystemExit, match="^failed: go1-a$"):
        less.main()
    assert started == ["go1-a", "go2-a"]
    assert "not finite" in (tmp_path / "go1-a.log").read_text()
    assert (tmp_path / "go1-a.error").read_text() == "out of memory\n"
    fails = ""
    less.main()
    assert not (tmp_path / "go1-a.error").exists()


def test_states_of_two_files_of_one_name_are_apart(tmp_path, monkeypatch):
    """fresh.txt of 27_few and of 23_untuned, named from their folders."""
    less, paths = importlib.import_module("experiments.21_less.run"), []
    monkeypatch.setattr(less, "run", lambda *given: paths.append(given[-1]))
    monkeypatch.setattr(less.devices, "own_process", lambda: None)
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "jobs.txt").write_text("best-g go1:best\n")
        monkeypatch.chdir(tmp_path / folder)
        words = ["run.py", str(tmp_path / "out"), "jobs.txt", "--only", "best-g"]
        monkeypatch.setattr(sys, "argv", [*words, "--states", "/states"])
        less.main()
    assert paths == [Path(f"/states/{folder}/jobs/best-g") for folder in ("a", "b")]


def test_what_runs_next_names_scripts_and_jobs_that_there_are():
    """And a card whose seconds count is one lane's alone."""
    lines, asked = list(cards.read(PLAN)), {}
    assert len({line.part for line in lines}) > 1
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
        assert all((folder / x).is_file() for x in words if x.startswith("experiments/"))

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
            before = lines[: lines.index(line)]
            assert any(f" {given.jobs} " in f"{x.command} " for x in before)
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
        if "24_off_policy/fresh" in jobs:
            seeds = {name: len(fresh.runs_of(fresh.RUNS, name)) for name in fresh.SETTINGS}
            done = {name for name, (count, *_) in fresh.SETTINGS.items() if seeds[name] == count}
        if "27_few" in jobs:
            done = {name for name, one in peers.settings().items() if one.counts}
        assert names == set(paper.jobs(ROOT / jobs)) - done


def test_ways_to_capture_a_step_that_have_run_are_not_run_again(tmp_path, monkeypatch, capsys):
    """Each engine and way has a process; one that fails is named, and the others run."""
    graphs = importlib.import_module("experiments.03_speed.graphs")
    out, began = tmp_path / "graphs.csv", []

    def run(command, **_):
        engine, mode = command[-3], command[-1]
        began.append((engine, mode))
        if mode == "JAX":
            return subprocess.CompletedProcess(command, 1, "", "no\nout of memory\n")
        with out.open("a") as file:
            for k, ms in enumerate((900.0, 30.0, 34.0)):
                file.write(f"{engine},{mode},gpu,abc,0,{10 * (k + 1)},{ms},{k}\n")
        return subprocess.CompletedProcess(command, 0, "", "")

    monkeypatch.setattr(graphs.subprocess, "run", run)
    words = ["graphs.py", str(out), "--engines", "kernel", "--modes", "WARP", "JAX"]
    monkeypatch.setattr(sys, "argv", words)
    for expected in ([("kernel", "WARP"), ("kernel", "JAX")], [("kernel", "JAX")]):
        began.clear()
        with pytest.raises(SystemExit, match="^failed: kernel JAX$"):
            graphs.main()
        assert began == expected
        said = capsys.readouterr().out.splitlines()
        assert said == ["kernel WARP 32.00 (2)", "kernel JAX out of memory"]
    monkeypatch.setattr(sys, "argv", [*words, "WARPED"])
    with pytest.raises(
        SystemExit, match="^--modes has 'WARPED', expected some of WARP, WARP_STAGED"
    ):
        graphs.main()


def test_no_other_way_to_capture_a_step_is_as_much_faster_as_its_rule_asks():
    """The table of 03_speed, its rule on results/graphs.csv, and what captures took."""
    folder, found = ROOT / "experiments/03_speed", {}
    for row in csv.DictReader((folder / "results/graphs.csv").read_text().splitlines()):
        assert (row["commit"], row["device"]) == ("05f6d8fb5aa0", "NVIDIA H200")
        each = found.setdefault((row["engine"], row["mode"]), {})
        each.setdefault(row["seed"], []).append((float(row["ms"]), int(row["captures"])))
    ways = ["WARP", "WARP_STAGED", "WARP_STAGED_EX", "JAX"]
    assert [*found] == [("mujoco_warp", way) for way in ways[:3]] + [("kernel", x) for x in ways]
    page = (folder / "README.md").read_text()
    means = {}  # without a seed's first ten iterations
    for (engine, way), seeds in found.items():
        assert [*seeds] == [*"01234"] and {len(rows) for rows in seeds.values()} == {6}
        means[engine, way] = [np.mean([ms for ms, _ in rows[1:]]) for rows in seeds.values()]
        first, last = means[engine, way][0], means[engine, way][-1]
        own = means[engine, "WARP"]
        more = [100 * (first / own[0] - 1), 100 * (last / own[-1] - 1)]
        beside = "" if way == "WARP" else ", ".join(f"{x:+.1f} %" for x in more) + " "
        beside = beside.replace("-0.0", "0.0")
        counts = np.diff([0, *(rows[-1][1] for rows in seeds.values())])
        label = {"mujoco_warp": "MuJoCo Warp", "kernel": "our kernel"}[engine]
        cells = f"{first:.2f} | {last:.2f} | {beside}| {', '.join(map(str, counts))}"
        assert f"| {label}, `{way}` | {cells} |" in page
        assert not (more[0] <= -3 and more[1] <= 1)  # the rule
    words, warp = " ".join(page.split()), found["mujoco_warp", "WARP"]
    own, staged = means["mujoco_warp", "WARP"], means["mujoco_warp", "WARP_STAGED"]
    text = "takes {:.1f} % longer, with `WARP` itself {:.1f}."
    assert text.format(*(100 * (x[0] / own[-1] - 1) for x in (staged, own))) in words
    assert [n for rows in warp.values() for _, n in rows] == [2, *[3] * 5, *[4] * 6, *[5] * 18]
    took, others = {}, {}
    for engine in ("mujoco_warp", "kernel"):
        second = [rows[1][0] for rows in found[engine, "WARP"].values()]
        took[engine], others[engine] = (second[0] - np.mean(second[1:])) / 100, second
    first, *rest = others["mujoco_warp"]
    late = [np.mean([ms for ms, _ in rows[2:]]) for rows in warp.values()]
    for text in (
        f"**Those {100 * (own[0] / own[-1] - 1):.1f} % are one capture**, of {took['mujoco_warp']:.2f} s:"
        f" iterations 11 to 20 of seed 0 take {first:.1f} ms, of the others {min(rest):.1f} to"
        f" {max(rest):.1f}; from 21 to 60 the five take {min(late):.1f} to {max(late):.1f}.",
        f"A capture of our kernel takes {took['kernel']:.2f} s.",
    ):
        assert text in words, text
    # that of a seed's first ten, beside those of the last two seeds
    usual = np.mean([warp[seed][0][0] for seed in "34"])
    most = max(took["mujoco_warp"], *((warp[seed][0][0] - usual) / 100 for seed in "12"))
    runs = " ".join((ROOT / "experiments/30_row_cost/runs.md").read_text().split())
    assert f"Each takes up to {most:.2f} s, once," in runs
