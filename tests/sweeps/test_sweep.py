"""A sweep over the toy environment: its runs are those without a sweep, and it goes on."""

import csv
import json
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
import workdirs
from answers import refused, status
from ml_collections import config_dict
from rich.console import Console

from dynappo import config as config_lib
from dynappo.policy import checkpoint_file, policy_source
from dynappo.program import build, devices
from dynappo.run import learning_curves, training
from dynappo.run import loop as loop_lib
from dynappo.sweeps import folder, grid, table
from dynappo.sweeps import sweep as sweeps
from dynappo.train import command as train_command

SWEEP = ["ppo.entropy_coef=0.003,0.3", "ppo.epochs=1,2"]
# plain PPO: half the program; what the model learns in a sweep, test_seeds.py compares on a mesh
WHOLE = {"run__num_seeds": 2, "schedule__end_steps": 0}
NAMES = [f"ppo.entropy_coef={c},ppo.epochs={e}" for c in (0.003, 0.3) for e in (1, 2)]


@pytest.fixture(autouse=True, scope="module")
def toy():
    """The toy environment; what the command sets for its own process stays out of this one."""
    with pytest.MonkeyPatch.context() as patch:
        workdirs.toy(patch)
        patch.setattr(build, "program", workdirs.compiled_once(build.program))
        patch.setattr(devices, "own_process", lambda device: None)
        patch.setattr(learning_curves, "draw", lambda *_: "no picture")
        yield


@pytest.fixture
def stop():
    return SimpleNamespace(status=0, patient=False)


def asked(texts, **fields):
    """What a command line with these `--sweep`s asks for."""
    config = workdirs.config(**fields)
    swept = grid.read(texts)
    config = config_dict.ConfigDict(config.to_dict())
    return sweeps.Sweep(swept, config, grid.combinations(config, swept))


def sweep(workdir, stop, texts=SWEEP, fresh=False, restore=None, **fields):
    out = Console(highlight=False)
    return sweeps.train_all(out, asked(texts, **fields), workdir, fresh, restore, None, stop)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep of two seeds without interruption; both floats in one program."""
    workdir = tmp_path_factory.mktemp("whole") / "sweep"
    sweep(workdir, SimpleNamespace(status=0, patient=False), **WHOLE)
    return workdir


def arrays(workdir):
    return checkpoint_file.read(workdir / "checkpoints" / "4")


def same(one, other, tolerance):
    """Two runs have the same rows, evaluation and arrays."""
    rows, expected = workdirs.table(one), workdirs.table(other)
    assert [row.keys() for row in rows] == [row.keys() for row in expected]
    for row, wanted in zip(rows, expected, strict=True):
        found = [[float(x or "nan") for x in r.values()] for r in (row, wanted)]
        np.testing.assert_allclose(*found, tolerance, 10 * tolerance)
    a, b = (json.loads((w / "summary.json").read_text())["evaluation"] for w in (one, other))
    for name in b:
        np.testing.assert_allclose(a[name], b[name], tolerance, 10 * tolerance)
    a, b = arrays(one), arrays(other)
    assert a.keys() == b.keys()
    for name in b:
        np.testing.assert_allclose(a[name], b[name], tolerance, 10 * tolerance, err_msg=name)


@pytest.mark.parametrize(
    "name", [NAMES[0], *(pytest.param(name, marks=pytest.mark.slow) for name in NAMES[1:])]
)
def test_a_combination_is_the_run_without_a_sweep(whole, name, tmp_path):
    """Every number of metrics.csv, evaluation and checkpoint of both seeds, to 1e-4."""
    coef, epochs = (float(part.partition("=")[2]) for part in name.split(","))
    config = workdirs.config(**WHOLE, ppo__entropy_coef=coef, ppo__epochs=int(epochs))
    training.train(config, tmp_path)
    same(whole / name, tmp_path, 1e-4)
    others = [other for other in NAMES if other != name]
    for other in others:
        with pytest.raises(AssertionError):
            same(whole / other, tmp_path, 1e-4)
    assert json.loads((whole / name / "config.json").read_text()) == json.loads(
        (tmp_path / "config.json").read_text()
    )


@pytest.mark.slow
def test_combinations_of_one_seed_are_runs_of_one_seed(tmp_path, stop):
    """In one program as alone; arrays have no axis of seeds."""
    sweep(tmp_path / "sweep", stop, SWEEP[:1])
    training.train(workdirs.config(ppo__entropy_coef=0.3), tmp_path / "run")
    same(tmp_path / "sweep" / "ppo.entropy_coef=0.3", tmp_path / "run", 1e-4)


@pytest.mark.slow
def test_a_combination_alone_in_its_program_is_the_run_to_the_bit(tmp_path, stop, whole, capsys):
    """And so are pairs and a second field in one program, to float tolerance."""
    sweep(tmp_path / "sweep", stop, ["ppo.epochs=1"], run__num_seeds=2, run__eval_every=2)
    name = "ppo.epochs=1"
    config = workdirs.config(run__num_seeds=2, run__eval_every=2, ppo__epochs=1)
    training.train(config, tmp_path / "run")
    same(tmp_path / "sweep" / name, tmp_path / "run", 0)
    assert "eval_return" in workdirs.table(tmp_path / "run")[0]


@pytest.mark.slow
def test_pairs_share_a_program_and_evaluations_on_the_way_are_each_runs_own(tmp_path, stop, capsys):
    texts = ["task.command_x=(-0.5,0.5),(0.2,1.0)", "model.learning_rate=1e-3,3e-3"]
    sweep(tmp_path / "sweep", stop, texts, run__eval_every=2)
    assert "sweeps 4 combinations: 1 program to compile" in capsys.readouterr().out
    fields = {"task__command_x": (0.2, 1.0), "model__learning_rate": 1e-3, "run__eval_every": 2}
    training.train(workdirs.config(**fields), tmp_path / "run")
    name = "task.command_x=0.2x1.0,model.learning_rate=0.001"
    same(tmp_path / "sweep" / name, tmp_path / "run", 1e-4)


def test_the_table_has_every_combination_best_first(whole):
    """Numbers are those of its summary.json; the best's policy is the sweep's."""
    with (whole / "sweep.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert sorted(row["folder"] for row in rows) == sorted(NAMES)
    means = [float(row["return_mean"]) for row in rows]
    assert means == sorted(means, reverse=True) and len(set(means)) == 4
    for row in rows:
        summary = json.loads((whole / row["folder"] / "summary.json").read_text())
        returns = summary["evaluation"]["return"]
        expected = np.mean(returns), np.mean(summary["evaluation"]["fall_rate"])
        found = float(row["return_mean"]), float(row["fall_rate"])
        np.testing.assert_allclose(found, expected, 1e-5)
        np.testing.assert_allclose([float(x) for x in row["returns"].split()], returns, 1e-5)
        assert int(row["sim_steps"]) == summary["sim_steps"] and row["seeds"] == "2"
        values = [f"{field}={row[field]}" for field in ("ppo.entropy_coef", "ppo.epochs")]
        assert row["folder"] == ",".join(values) and row["note"] == ""
    assert (whole / "sweep.png").stat().st_size > 10_000
    best = (whole / rows[0]["folder"] / "policy.npz").read_bytes()
    assert (whole / "policy.npz").read_bytes() == best
    assert policy_source.locate(str(whole)) == whole / "policy.npz"  # what `play` takes of a sweep
    with np.load(whole / "policy.npz") as file:
        config = json.loads(str(file["about"]))["config"]
    assert str(config["ppo"]["epochs"]) == rows[0]["ppo.epochs"]
    assert policy_source.locate(str(whole / NAMES[1]), 1).name == "4"


def test_a_sweep_that_has_ended_is_only_told_again(whole, tmp_path, stop, capsys, monkeypatch):
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    monkeypatch.setattr(training, "train_together", lambda *_: pytest.fail("trained again"))
    sweep(workdir, stop, **WHOLE)
    said = capsys.readouterr().out
    assert "0 programs to compile, 4 are done" in said and "evaluated return" in said
    assert "see it: " in said
    for path in workdir.glob("*/summary.json"):  # where its film failed, as `play` would
        path.write_text(json.dumps(json.loads(path.read_text()) | {"playable": False}))
    sweep(workdir, stop, **WHOLE)
    said = capsys.readouterr().out
    assert "its policy is" in said and "see it: " not in said


SUMMARIES = [
    "{",
    "[]",
    '{"iterations": 4}',
    '{"iterations": 4, "sim_steps": null, "seconds": 1}',
    '{"iterations": 4, "sim_steps": 8, "seconds": "long"}',
    '{"iterations": 4, "sim_steps": 8, "seconds": 1, "return": {}}',
    '{"iterations": 4, "sim_steps": 8, "seconds": 1, "evaluation": 3}',
    '{"iterations": 4, "sim_steps": 8, "seconds": 1, "evaluation": {"return": ["x"]}}',
]


@pytest.mark.parametrize("text", SUMMARIES)
def test_a_damaged_summary_is_none(whole, tmp_path, text):
    """Such a combination is summed up again."""
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    one = asked(SWEEP, **WHOLE).combinations[1]
    assert folder.summary(workdir, one)
    (workdir / one.name / "summary.json").write_text(text)
    assert folder.summary(workdir, one) == {}
    assert table.row(workdir, one)["note"] == "at iteration 4"


def test_a_combination_whose_film_was_interrupted_has_not_ended(whole, tmp_path):
    """Its summary is written before the film, so that no evaluation is lost."""
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    one = asked(SWEEP, **WHOLE).combinations[1]
    config, place = config_dict.ConfigDict(one.config), workdir / one.name
    config.run.video_seconds = 1.0
    one = one._replace(config=config)
    (place / "config.json").write_text(config_lib.to_json(config) + "\n")
    assert folder.summary(workdir, one) == {}
    found = json.loads((place / "summary.json").read_text())
    (place / "summary.json").write_text(json.dumps(found | {"video": "no video: no ffmpeg"}))
    assert folder.summary(workdir, one)


def test_a_lost_file_of_a_combination_is_written_again(whole, tmp_path, stop, capsys):
    """Rows that are lost stay empty; the table is as before."""
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    for name, lost in zip(NAMES, ("metrics.csv", "policy.npz", "summary.json"), strict=False):
        (workdir / name / lost).unlink()
    (workdir / NAMES[3] / "metrics.csv").write_text("hello\n")  # whose curve the picture lacks
    (workdir / "policy.npz").unlink()
    sweep(workdir, stop, **WHOLE)
    said = capsys.readouterr().out.replace("\n", " ")
    assert "1 are done" in said and "stay empty" in said
    for name in NAMES:
        assert {p.name for p in (workdir / name).iterdir()} >= {
            p.name for p in (whole / name).iterdir()
        }
    rows = [list(csv.DictReader((w / "sweep.csv").open())) for w in (workdir, whole)]
    for one, other in zip(*rows, strict=True):
        for name in ("folder", "return_mean", "fall_rate", "sim_steps"):
            assert one[name] == other[name]
    best = workdir / rows[0][0]["folder"] / "policy.npz"
    assert (workdir / "policy.npz").read_bytes() == best.read_bytes()
    assert not [*workdir.glob("*.part")]


def test_a_sweep_that_was_stopped_goes_on_to_the_same_bits(
    whole, tmp_path, stop, capsys, monkeypatch
):
    """In the first chunk of the second program: what is done is left alone, the rest goes on."""
    workdir = tmp_path / "sweep"
    with monkeypatch.context() as patch:
        loop = loop_lib.loop
        loops = []

        def stopped(runs, *state, **how):
            loops.append(runs)
            if len(loops) == 2:
                stop.status = 130
            return loop(runs, *state, **how)

        patch.setattr(loop_lib, "loop", stopped)
        assert sweep(workdir, stop, **WHOLE) == "saved at iteration 2 and stopped"
    reached = {name: max(map(int, workdirs.steps(workdir / name))) for name in NAMES}
    assert list(reached.values()) == [4, 2, 4, 2]
    first = workdirs.everything(workdir / NAMES[0])
    stop.status = 0
    sweep(workdir, stop, **WHOLE)
    assert workdirs.everything(workdir / NAMES[0]) == first
    for name in NAMES:
        same(workdir / name, whole / name, 0)


@pytest.mark.slow
def test_runs_of_one_program_that_were_killed_between_two_saves_go_on(
    whole, tmp_path, stop, capsys
):
    """One saved iteration 4, the other only 2: they are two programs now."""
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    late = workdir / NAMES[2]
    shutil.rmtree(late / "checkpoints" / "4")
    for name in NAMES[:3:2]:
        (workdir / name / "summary.json").unlink()
    sweep(workdir, stop, **WHOLE)
    assert "2 programs to compile, 2 are done" in capsys.readouterr().out
    for name in NAMES:
        same(workdir / name, whole / name, 1e-4)


@pytest.mark.slow
def test_a_damaged_checkpoint_sets_its_own_run_back(whole, tmp_path, stop, capsys):
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    for name in NAMES[:3:2]:
        (workdir / name / "summary.json").unlink()
    workdirs.other_hash(workdir / NAMES[2] / "checkpoints" / "4")
    sweep(workdir, stop, **WHOLE)
    assert "checkpoint 4 is damaged" in capsys.readouterr().out.replace("\n", " ")
    for name in NAMES:
        same(workdir / name, whole / name, 1e-4)


def test_values_may_be_added_and_nothing_else_may_change(whole, tmp_path, stop, monkeypatch):
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    more = ["ppo.entropy_coef=0.003,0.1,0.3", "ppo.epochs=1,2"]
    trained = []
    monkeypatch.setattr(
        training,
        "train_together",
        lambda runs, *_: trained.append(runs) or setattr(stop, "status", 130),
    )
    for texts, fields, expected in (
        (["ppo.entropy_coef=0.003", SWEEP[1]], {}, f"with {NAMES[2]}, which is missing here"),
        (SWEEP[:1], {}, "holds a sweep over ppo.entropy_coef, ppo.epochs, not over ppo.entropy_c"),
        (SWEEP, {"ppo__gamma": 0.9}, "another config (ppo.gamma 0.99 there, 0.9 here)"),
        (SWEEP, {"run__num_seeds": 3}, "run.num_seeds 2 there, 3 here"),
    ):
        before = workdirs.everything(workdir)
        line = refused(sweep, workdir, stop, texts, **(WHOLE | fields))
        assert expected in line
        assert workdirs.everything(workdir) == before
    sweep(workdir, stop, more, **WHOLE)
    assert [[run.workdir.name for run in runs] for runs in trained] == [
        ["ppo.entropy_coef=0.1,ppo.epochs=1"]
    ]


@pytest.mark.slow
def test_a_combination_that_blows_up_is_told_and_the_others_end(whole, tmp_path, stop, capsys):
    """Status 1 at the end; the same command does not train it again, until its folder is removed."""
    workdir, texts = tmp_path / "sweep", ["model.learning_rate=1e-3,1e9"]
    good, bad = "model.learning_rate=0.001", "model.learning_rate=1000000000.0"
    for _ in range(2):
        with pytest.raises(FloatingPointError, match="1 of 2 combinations blew up"):
            sweep(workdir, stop, texts)
        said = " ".join(capsys.readouterr().out.split())
        assert "1000000000.0 1 blew up" in said
    training.train(workdirs.config(model__learning_rate=1e-3), tmp_path / "run")
    same(workdir / good, tmp_path / "run", 1e-4)
    assert not workdirs.steps(workdir / bad) and not (workdir / bad / "summary.json").exists()
    assert "is not finite" in json.loads((workdir / bad / folder.BLOWN_UP).read_text())["problem"]


def test_fresh_moves_a_sweep_and_nothing_else(whole, tmp_path, stop, monkeypatch):
    workdir = shutil.copytree(whole, tmp_path / "sweep")
    monkeypatch.setattr(training, "train_together", lambda *_: setattr(stop, "status", 130))
    (workdir / "thesis.txt").write_text("years")
    assert "holds thesis.txt, which no sweep writes" in refused(
        sweep, workdir, stop, fresh=True, **WHOLE
    )
    (workdir / "thesis.txt").unlink()
    kept = workdirs.everything(workdir / NAMES[0])
    sweep(workdir, stop, SWEEP[:1], fresh=True)
    assert workdirs.everything(tmp_path / "sweep.old-1" / NAMES[0]) == kept
    assert {p.name for p in workdir.iterdir()} == {"lock", "sweep.json", "sweep.csv"}


@pytest.mark.slow
def test_restore_is_for_every_combination_and_remembered(whole, tmp_path, stop):
    """Also for those that begin in a second command."""
    workdir, start = tmp_path / "sweep", whole / NAMES[0]
    texts, fields = ["ppo.entropy_coef=0.1,0.2"], WHOLE
    assert "run.num_seeds is 2 there, 1 here" in refused(
        sweep, workdir, stop, texts, restore=start, schedule__end_steps=0
    )
    assert not workdir.exists()
    sweep(workdir, stop, texts, restore=start, **fields)
    more = ["ppo.entropy_coef=0.1,0.2,0.4"]
    assert "--restore=" in refused(sweep, workdir, stop, more, restore=whole / NAMES[1], **fields)
    sweep(workdir, stop, more, **fields)
    config = workdirs.config(**WHOLE, ppo__entropy_coef=0.4)
    run = train_command.Command(config, tmp_path / "run", restore=start)
    train_command.train_run(Console(), run, stop)
    same(workdir / "ppo.entropy_coef=0.4", tmp_path / "run", 0)
    taken = (workdir / "ppo.entropy_coef=0.1" / "restored_from").read_text()
    assert taken == (tmp_path / "run" / "restored_from").read_text()


# ---- what the command reads


def test_a_sweep_has_a_folder_of_its_own_and_its_workdir_alone_goes_on_with_it(
    whole, tmp_path, monkeypatch
):
    argv = ["--config=configs/go1.py:dyna4", "--sweep=ppo.epochs=3,5", "--sweep", "ppo.gamma=0.9"]
    found = train_command.parse(argv)
    assert str(found.workdir) == "runs/go1-dyna4-sweep" and found.sweep
    assert [c.name for c in found.sweep.combinations] == [
        f"ppo.epochs={e},ppo.gamma=0.9" for e in (3, 5)
    ]
    again = train_command.parse([f"--workdir={whole}", "--config.run.num_iterations=8"]).sweep
    assert again and [one.name for one in again.combinations] == NAMES
    assert {one.config.run.num_iterations for one in again.combinations} == {8}


def test_runs_and_sweeps_are_not_mixed_in_a_folder(whole, tmp_path, stop):
    line = refused(train_command.parse, ["--config=go1", f"--workdir={whole}"])
    assert "holds a sweep" in line
    inside = whole / NAMES[0] / "checkpoints" / "4"
    assert f"among the checkpoints of {whole / NAMES[0]}" in refused(sweep, inside, stop)
    workdir = tmp_path / "run"
    workdir.mkdir()
    (workdir / "config.json").write_text("{}")
    assert "holds config.json of a run, expected a sweep" in refused(sweep, workdir, stop)
    (workdir / "config.json").unlink()
    (workdir / "sweep.json").write_text("[]")
    assert "it is not the JSON of a sweep" in refused(sweep, workdir, stop)
    assert "it is not the JSON" in refused(train_command.parse, [f"--workdir={workdir}"])


@pytest.mark.parametrize(
    "wrong",
    [
        {"sweep": ["ppo.epochs"]},
        {"sweep": {"ppo.epochs": 3}},
        {"sweep": {"ppo.epochs": [3]}},
        {"config": "go1"},
        {"own_env": None},
        {"restore": 3},
        {"combinations": []},
    ],
)
def test_a_sweep_json_of_other_types_is_one_line(tmp_path, wrong):
    about = {"sweep": {"ppo.epochs": ["3"]}, "own_env": False, "restore": None, "combinations": {}}
    about |= {"config": config_lib.load("go1").to_dict()}
    (tmp_path / "sweep.json").write_text(json.dumps(about))
    assert train_command.parse([f"--workdir={tmp_path}"]).sweep
    (tmp_path / "sweep.json").write_text(json.dumps(about | wrong))
    line = refused(train_command.parse, [f"--workdir={tmp_path}"])
    assert "sweep.json: it is not the JSON of a sweep" in line


def test_a_wrong_combination_is_one_line_and_nothing_is_written(tmp_path, capsys, monkeypatch):
    """The second of two is wrong; before anything is compiled."""
    monkeypatch.chdir(tmp_path)
    for text, expected in (
        ("ppo.minibatches=4,7", "expected a multiple of ppo.minibatches = 7 (the combination"),
        ("task.randomize.base_mass=(-1,1),(-9,0)", "expected more than -5.20 kg"),
        ("robot=go1,horse", "robot is 'horse'"),
    ):
        argv = ["--config=go1:dyna4", f"--sweep={text}", "--workdir=sweep"]
        assert status(train_command.main, *argv) == 2
        said = capsys.readouterr()
        assert said.err.startswith("dynappo: --sweep: ") and said.err.count("\n") == 1
        assert expected in said.err and said.out == ""
        assert not list(tmp_path.iterdir())
