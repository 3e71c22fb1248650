"""The script for GPU hosts: what it calls the same, when a step fails, and all of it, tiny, on a CPU."""

import csv
import json
import re
import time

import numpy as np
import on_gpu
import pytest
from answers import ROOT, mistake, refused, shell

STEPS = ["kernel", "walks", "resume", "processes", "speed"]


def place(folder, device="cpu"):
    return on_gpu.Place(device, ["0"], folder, time.monotonic() + 60)


def rows(**more):
    """Of a metrics.csv: numbers that differ from row to row."""
    names = [*on_gpu.CLOSE, *more]
    rng = np.random.default_rng(0)
    made = []
    for i in range(2 * on_gpu.HALF):
        numbers = zip(names, map(float, rng.uniform(1, 2, len(names))), strict=True)
        made.append({"iteration": i + 1, "seconds": 0.5 * i, **dict(numbers)})
    return made


def changed(table, at, **values):
    return [row | (values if i == at else {}) for i, row in enumerate(table)]


# --- what is the same ---


def test_a_resumed_run_may_only_differ_where_it_was_resumed():
    whole = rows(other=1)
    apart = {"same_bits": True, "apart": 0.0}
    later = changed(whole, on_gpu.HALF + 3, seconds=7.0)  # a clock is no number of the run
    assert on_gpu.same(later, whole, exact=True) == apart
    value = whole[on_gpu.HALF]["value_loss"]
    near = changed(whole, on_gpu.HALF, value_loss=1.01 * value, other=5.0)
    found = on_gpu.same(near, whole, exact=False)
    assert found == {"same_bits": False, "apart": 0.01}


@pytest.mark.parametrize(
    ("table", "exact", "words"),
    [
        (rows()[:-1], False, "not one row for each of 40"),
        ([*rows(), rows()[-1]], False, "not one row for each of 40"),
        (changed(rows(), 3, iteration=3), False, "not one row for each of 40"),
        (changed(rows(), 39, model_loss=np.nan), False, "not finite"),
        (
            changed(rows(), on_gpu.HALF - 1, policy_std=0.9),
            False,
            "before iteration 20 are not the same",
        ),
        (changed(rows(), on_gpu.HALF, value_loss=1.0000001), True, "rows after iteration 20"),
        (changed(rows(), on_gpu.HALF, policy_std=0.9), False, "iteration 21 of a resumed run"),
        (changed(rows(), on_gpu.HALF, episode_return=np.nan), False, "iteration 21 of a resumed"),
    ],
)
def test_a_run_that_lost_something_is_not_the_same(table, exact, words):
    with pytest.raises(on_gpu.Failed, match=words):
        on_gpu.same(table, rows(), exact=exact)


# --- steps ---


def written(monkeypatch, returns, falls, every=10):
    """`train` of the script writes a metrics.csv with these evaluations [E][2] instead."""

    def train(place, workdir, *fields):
        workdir.mkdir()
        with (workdir / "metrics.csv").open("w", newline="") as file:
            names = ["iteration", "sim_steps", "seconds", "eval_return", "eval_fall_rate", "seed"]
            out = csv.DictWriter(file, names)
            out.writeheader()
            for i in range(1, every * len(returns) + 1):
                for seed in (0, 1):
                    row = {"iteration": i, "sim_steps": 5000 * i, "seconds": i / 4, "seed": seed}
                    if i % every == 0:
                        row["eval_return"] = returns[i // every - 1][seed]
                        row["eval_fall_rate"] = falls[i // every - 1][seed]
                    out.writerow(row)
        return ""

    monkeypatch.setattr(on_gpu, "train", train)
    size = on_gpu.SIZES["gpu"]._replace(iterations=every * len(returns))
    monkeypatch.setitem(on_gpu.SIZES, "gpu", size)


def test_a_walk_is_counted_in_steps_and_seconds_of_each_seed(monkeypatch, tmp_path):
    """Seed 0 walks from the second evaluation on; seed 1 falls again at the last."""
    written(monkeypatch, [[20, 39], [38, 40], [41, 41]], [[0, 0.01], [0.01, 0.0], [0.002, 0.02]])
    found = on_gpu.walks(place(tmp_path, "gpu"))
    assert found["level"] == 38 and found["evaluations"] == 3
    assert found["walks_m_steps"] == [0.1, None] and found["walks_seconds"] == [5.0, None]
    assert found["careful_m_steps"] == [0.1, 0.05] and found["careful_seconds"] == [5.0, 2.5]
    assert found["return"] == [41, 41] and found["fall_rate"] == [0.002, 0.02]


@pytest.mark.parametrize("falls", [[0.0, 0.02], [0.0, np.nan]])
def test_a_seed_that_never_walks_fails(monkeypatch, tmp_path, falls):
    written(monkeypatch, [[39, 39]], [falls])
    with pytest.raises(on_gpu.Failed):
        on_gpu.walks(place(tmp_path, "gpu"))


def test_a_step_that_fails_stops_no_other(monkeypatch):
    def fails(place):
        raise on_gpu.Failed("a line")

    def breaks(place):
        return {"n": int((place.folder / "missing").read_text())}

    def works(place):
        assert not [*place.folder.iterdir()]
        return {"n": 1}

    monkeypatch.setattr(on_gpu, "STEPS", {fails: 9, breaks: 9, works: 9})
    taken = [on_gpu.take(step, "cpu", []) for step in on_gpu.STEPS]
    assert [step["ok"] for step in taken] == [False, False, True]
    assert taken[0]["failed"] == "a line" and "FileNotFoundError: " in taken[1]["failed"]
    assert taken[2]["n"] == 1 and taken[2]["took_s"] >= 0


def test_a_process_that_hangs_or_dies_fails_its_step(tmp_path, capsys):
    here = place(tmp_path)
    dies = on_gpu.start(here, "dies", ["-c", "import os; print('why', flush=True); os.abort()"])
    with pytest.raises(on_gpu.Failed, match="dies ended with status -6"):
        on_gpu.wait(dies, here, "dies")
    assert "    why\n" in capsys.readouterr().out
    late = here._replace(deadline=time.monotonic() + 0.2)
    hangs = on_gpu.start(late, "hangs", ["-c", "import time; time.sleep(600)"])
    with pytest.raises(on_gpu.Failed, match="hangs took too long"):
        on_gpu.wait(hangs, late, "hangs")
    assert hangs.poll() is not None


def test_without_pytest_a_line_says_so(monkeypatch, tmp_path):
    monkeypatch.setattr(on_gpu, "find_spec", lambda name: None)
    with pytest.raises(on_gpu.Failed, match="pytest is not installed"):
        on_gpu.kernel(place(tmp_path))


def test_every_test_of_warp_runs_on_the_gpu_and_all_steps_fit_into_ten_minutes():
    found = [
        p for p in (ROOT / "tests").rglob("test_*.py") if 'importorskip("warp")' in p.read_text()
    ]
    names = {str(p.relative_to(ROOT)) for p in found} - {"tests/test_on_gpu.py"}
    assert names == {name for name in on_gpu.SIZES["gpu"].tests if name.endswith(".py")}
    assert [step.__name__ for step in on_gpu.STEPS] == STEPS
    assert sum(on_gpu.STEPS.values()) <= 600


# --- the command ---


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only=walk"], "no step is called 'walk'; expected kernel, walks"),
        (["--only=speed", f"--out={on_gpu.COMMITTED}"], "for whole runs on a GPU"),
        (["--device=cpu", f"--out={on_gpu.COMMITTED}"], "for whole runs on a GPU"),
        (["--device=tpu"], "invalid choice"),
        (["--quick"], "--quick: no such flag"),
        (["--device=cpu", "--out=/proc/none/x.json"], "cannot write there"),
    ],
)
def test_what_cannot_be_done_is_one_line(arguments, words):
    assert words in refused(on_gpu.parse, arguments)


def test_without_a_gpu_it_says_so(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(on_gpu, "graphics", list)
    out = tmp_path / "out.json"
    assert "shows no NVIDIA GPU" in mistake(on_gpu.main, [f"--out={out}"], capsys)
    assert not out.exists()


def test_a_failed_step_is_status_1_and_is_written(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(on_gpu, "graphics", lambda: [["NVIDIA H100", "580.1", "81559 MiB"]])
    monkeypatch.setattr(on_gpu, "find_spec", lambda name: None)
    out = tmp_path / "out.json"
    with pytest.raises(SystemExit) as end:
        on_gpu.main(["--only=kernel", f"--out={out}", "--commit=abc"])
    assert end.value.code == 1
    written = json.loads(out.read_text())
    assert written["commit"] == "abc"
    assert written["gpus"] == [["NVIDIA H100", "580.1", "81559 MiB"]] and not written["smoke"]
    assert written["steps"]["kernel"]["failed"].startswith("pytest is not installed")
    assert re.search("kernel +FAILED .* pytest is not installed", capsys.readouterr().out)


def jax_of_ci():
    return re.findall(r"^jax==(\S+)$", (ROOT / "constraints.txt").read_text(), re.M)[0]


def test_the_page_names_the_jax_of_ci():
    assert f"JAX {jax_of_ci()}" in (ROOT / "docs" / "install.md").read_text()


@pytest.mark.skipif(not on_gpu.COMMITTED.exists(), reason="no run on a GPU is committed yet")
def test_the_committed_run_was_whole_and_the_pages_name_its_jax_and_what_failed():
    last = json.loads(on_gpu.COMMITTED.read_text())
    assert not last["smoke"] and last["gpus"] and [*last["steps"]] == STEPS
    failed = {f"- `{name}`: " for name, step in last["steps"].items() if not step["ok"]}
    page = (ROOT / "tests" / "README.md").read_text()
    said = {f"- `{name}`: " for name in STEPS if f"\n- `{name}`: " in page}
    assert said == failed
    assert f"JAX {last['versions']['jax']}" in (ROOT / "docs" / "install.md").read_text()


@pytest.mark.slow
@pytest.mark.timeout(7200)
def test_all_steps_at_tiny_sizes_on_a_cpu(tmp_path, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "")  # eight devices, of conftest.py
    before = on_gpu.COMMITTED.exists() and on_gpu.COMMITTED.read_text()
    out = tmp_path / "out.json"
    done = shell(ROOT / "tests" / "on_gpu.py", "--device=cpu", f"--out={out}", timeout=7000)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "a smoke run, which measures nothing" in done.stdout and done.stderr == ""
    found = json.loads(out.read_text())
    assert found["smoke"] and found["gpus"] == [] and found["jax_of_ci"] == jax_of_ci()
    steps = found["steps"]
    assert [*steps] == STEPS and all(step["ok"] for step in steps.values())
    assert steps["kernel"]["passed"] == 1 and steps["kernel"]["skipped"] == 0
    assert steps["walks"]["evaluations"] == 2 and steps["walks"]["walks_m_steps"] == [None, None]
    assert steps["resume"]["same_bits"] and steps["resume"]["killed_after"] >= on_gpu.HALF
    assert steps["processes"]["on"] == "CPU" and steps["processes"]["apart"] < 0.02
    assert steps["speed"]["engine"] == "c" and steps["speed"]["with_tail_ms"] > 0
    assert before == (on_gpu.COMMITTED.exists() and on_gpu.COMMITTED.read_text())
