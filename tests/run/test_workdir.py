"""The folder of a run: one run at a time, no other config, and the best of its policies in a file."""

import errno
import json
import os
import shutil
import socket
from functools import partial
from pathlib import Path

import filelock
import jax
import numpy as np
import pytest
import workdirs
from answers import refused
from toy_policy import GO1, params_in
from toy_runs import assert_same
from workdirs import opened

from dynappo import config as config_lib
from dynappo import train
from dynappo.policy import policy_file
from dynappo.program import build
from dynappo.run import checkpoint, finish, restore
from dynappo.run import workdir as workdir_lib
from dynappo.train import command as train_command

OTHER = workdirs.config(ppo__clip_epsilon=0.3)
HELD = f"pid {os.getpid()} on {socket.gethostname()}"


# ---- held by one run


def test_a_folder_is_one_runs_at_a_time(config, tmp_path):
    """The line names the process; `fresh` moves nothing away; an end of any kind lets go."""
    workdir = tmp_path / "run"
    with pytest.raises(RuntimeError), workdir_lib.open_workdir(workdir, config):
        for fresh in (False, True):
            line = refused(opened, workdir, config, fresh=fresh)
            assert f"--workdir={workdir}: another run is writing in this folder ({HELD})" in line
            assert "wait for it, or take another --workdir" in line
        assert [p.name for p in tmp_path.iterdir()] == ["run"]
        raise RuntimeError
    for fresh in (False, True, False):
        opened(workdir, config, fresh=fresh)


def test_a_lock_that_a_killed_run_left_holds_nobody_up(config, tmp_path):
    """The file is there, nobody holds it."""
    (tmp_path / "lock").write_text("pid 1 on a machine far away, with a long name\n")
    with workdir_lib.open_workdir(tmp_path, config):
        assert (tmp_path / "lock").read_text() == f"{HELD}\n"


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOTSUP, errno.EIO])
def test_a_file_system_without_locks_is_used_without(config, tmp_path, monkeypatch, number):
    """A disk that fails is the machine's fault (status 1), not the folder's."""

    def acquire(self, **how):
        raise OSError(number, "no")

    monkeypatch.setattr(filelock.FileLock, "acquire", acquire)
    if number == errno.EIO:
        with pytest.raises(OSError, match="no"):
            opened(tmp_path, config)
    else:
        opened(tmp_path, config)
        assert (tmp_path / "config.json").exists()


def test_train_holds_its_folder_until_it_ends(config, tmp_path, monkeypatch):
    """Also where it is interrupted; then the next call in the same process trains there."""
    ends = []

    def program(*_, **__):
        assert "another run is writing" in refused(opened, tmp_path, config)
        ends.append(1)
        raise KeyboardInterrupt

    monkeypatch.setattr(build, "program", program)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            train.train(config, tmp_path)
    assert len(ends) == 2 and {p.name for p in tmp_path.iterdir()} <= {"config.json", "lock"}


# ---- of one config


def test_the_settings_are_kept(whole, config):
    """config.json holds every field, resolved."""
    kept = json.loads(whole.files["config.json"])
    assert kept == json.loads(json.dumps(config.to_dict()))
    assert kept["rollout"]["num_envs"] == 16 and kept["task"]["air_time"] == "touchdown"


def test_a_folder_of_another_config_is_refused(whole):
    """By the field that differs, with both values; nothing in the folder changes."""
    before = workdirs.everything(whole.workdir)
    line = refused(train.train, OTHER, whole.workdir)
    assert f"--workdir={whole.workdir} holds a run of another config" in line
    assert "(ppo.clip_epsilon 0.2 there, 0.3 here); choose another folder, or --fresh" in line
    after = workdirs.everything(whole.workdir)
    assert {str(p) for p in after if after[p] != before.get(p)} <= {"lock"}


def test_the_config_in_the_newest_checkpoint_counts_as_much_as_config_json(config, whole, tmp_path):
    """A config.json that lacks the field, or a checkpoint that came from another run."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    (workdir / "config.json").write_text('{"robot": "go1", "rollout": {}, "run": {}}')
    line = refused(opened, workdir, OTHER)
    assert "holds a run of another config (ppo.clip_epsilon 0.2 there, 0.3 here)" in line
    shutil.copy(whole.workdir / "config.json", workdir)
    about = workdir / "checkpoints" / "4" / "about" / "metadata"
    text = json.loads(about.read_text())
    text["config"]["run"]["seed"] = 7
    about.write_text(json.dumps(text))
    assert "(run.seed 7 there, 0 here)" in refused(opened, workdir, config)


@pytest.mark.parametrize("name", ["config.json", "metrics.csv"])
def test_a_pipe_in_a_workdir_is_not_waited_for(config, tmp_path, name):
    os.mkfifo(tmp_path / name)
    assert "cannot write there (Not a regular file)" in refused(opened, tmp_path, config)


@pytest.mark.parametrize("begun", ["checkpoints/2", "damaged-2", "metrics.csv"])
def test_a_folder_in_which_nothing_was_computed_takes_another_config(config, tmp_path, begun):
    """After ctrl-C while it compiled; from the first checkpoint or row on it is a run."""
    opened(tmp_path, OTHER)
    (tmp_path / "checkpoints").mkdir()
    (tmp_path / "metrics.csv").write_text("iteration,seconds\n")
    opened(tmp_path, config)
    assert json.loads((tmp_path / "config.json").read_text())["ppo"]["clip_epsilon"] == 0.2
    if begun == "metrics.csv":
        (tmp_path / begun).write_text("iteration,seconds\n1,2\n")
    else:
        (tmp_path / begun).mkdir()
    assert "ppo.clip_epsilon 0.2 there, 0.3 here" in refused(opened, tmp_path, OTHER)


def test_what_changes_no_number_may_differ(whole, config, tmp_path):
    """A run goes on with other devices, logs and evaluations, and not with another seed."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    other = dict(run__eval_envs=16, run__tensorboard=False, run__video_seconds=1.0)
    other |= dict(run__log_every=1, run__eval_steps=5)
    opened(workdir, workdirs.config(**other, run__num_iterations=8, physics__impl="jax"))
    assert "run.seed 0 there, 1 here" in refused(opened, workdir, workdirs.config(run__seed=1))


@pytest.mark.parametrize("text", ["", "{", "[]", "\udcff", "gone"])
def test_a_lost_config_is_that_of_the_checkpoint(whole, config, tmp_path, text):
    """The run goes on with the config it had, and with no other; then the file is whole again."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    path = workdir / "config.json"
    path.unlink() if text == "gone" else path.write_bytes(text.encode(errors="surrogateescape"))
    assert "ppo.clip_epsilon 0.2 there, 0.3 here" in refused(opened, workdir, OTHER)
    if text == "gone":  # `--workdir` alone finds it too
        found = train_command.parse([f"--workdir={workdir}", "--config.run.log_every=1"]).config
        assert config_lib.flat(found) == config_lib.flat(config) | {"run.log_every": 1}
    opened(workdir, config)
    assert path.read_bytes() == whole.files["config.json"]


def test_without_config_and_checkpoints_nobody_knows_what_the_rows_are_of(config, tmp_path):
    """Rows alone are a run too, and it is not overwritten."""
    (tmp_path / "metrics.csv").write_text("iteration,seconds\n1,2\n")
    assert "its config.json cannot be read" in refused(opened, tmp_path, config)
    line = refused(train_command.parse, [f"--workdir={tmp_path}"])
    assert "its config.json is lost, and there is no good checkpoint that has it" in line
    opened(tmp_path, config, fresh=True)


def test_the_run_that_networks_come_from_is_remembered(whole, config, tmp_path):
    """Until there is a checkpoint each start takes them from there; another source is refused."""
    workdir, source = tmp_path / "run", whole.workdir.resolve()
    opened(workdir, config)
    start_from = partial(restore.source, workdir)
    assert start_from(None) is None
    assert start_from(whole.workdir) == source == start_from(None)
    (workdir / "metrics.csv").write_text("iteration,seconds\n1,2\n")
    assert start_from(None) == source  # it was killed before it had saved
    line = refused(start_from, tmp_path)
    assert f"--restore={tmp_path}: the run in {workdir} began from {source}; leave" in line
    shutil.copytree(whole.workdir / "checkpoints", workdir / "checkpoints")
    assert start_from(None) is None and start_from(whole.workdir) is None
    (workdir / "restored_from").unlink()
    assert "began from untrained networks; leave" in refused(start_from, whole.workdir)


FAULTS = {  # what is in the way of the last checkpoint, what the line says of it
    OSError(errno.ENOSPC, "No space left on device"): "(No space left on device); ",
    OSError(errno.EDQUOT, "Disk quota exceeded"): "(Disk quota exceeded); ",
    ValueError("OUT_OF_RANGE: Failed to write 9 bytes [os_error_code='28']"): "(No space left",
    OSError(errno.EROFS, "Read-only file system"): "(Read-only file system); ",
    ValueError("Cannot save arrays with zero size: x"): "(Cannot save arrays with zero size: x); ",
}


@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_a_last_checkpoint_that_is_not_there_is_saved_once_more(
    whole, config, program, tmp_path, monkeypatch, fault
):
    """Else the line says why; of room it speaks where room is in the way, and else not."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    made = (workdir_lib.made_by(program(), config),)
    run = workdirs.open_run(config, workdir, whole.metrics)._replace(origins=made)
    at = run, program().robot, whole.state, pytest.fail
    finish.check_saved(*at)
    (workdir / "checkpoints" / "4").rename(tmp_path / "4")

    def fails(*_, **__):
        raise fault

    with monkeypatch.context() as patch:
        patch.setattr(checkpoint, "save", fails)
        with pytest.raises(OSError, match="the checkpoint of iteration 4 could not be ") as caught:
            finish.check_saved(*at)
        line = str(caught.value)
        assert FAULTS[fault] in line and line.endswith(
            "the same command goes on from the one before"
        )
        assert ("make room" in line) == ("No space" in line or "quota" in line)
        shutil.move(workdir / "checkpoints" / "2", tmp_path)
        with pytest.raises(OSError, match="the same command starts anew"):
            finish.check_saved(*at)
    finish.check_saved(*at)
    texts = [p / "about" / "metadata" for p in (workdir / "checkpoints" / "4", tmp_path / "4")]
    assert texts[0].read_bytes() == texts[1].read_bytes()


@pytest.mark.parametrize("saved", [True, False])
def test_where_the_policy_finds_no_room_either_the_lost_checkpoint_is_told(
    whole, config, program, tmp_path, monkeypatch, saved
):
    """It weighs more than policy.npz, which it has too; where it is good, policy.npz is told."""
    workdir = shutil.copytree(whole.workdir, tmp_path / "run")
    workdirs.toy(monkeypatch)
    monkeypatch.setattr(build, "program", lambda *_, **__: program())

    def fails(*_, **__):
        raise OSError(errno.EFBIG, "File too large", "policy.npz")

    monkeypatch.setattr(policy_file, "save", fails)
    if not saved:
        shutil.rmtree(workdir / "checkpoints" / "4")
        monkeypatch.setattr(checkpoint, "save", fails)
    lost = "the checkpoint of iteration 4 could not be saved (File too large); the same command goes on"
    with pytest.raises(OSError) as caught:
        train.train(config, workdir)
    assert (lost in str(caught.value)) is not saved
    assert (caught.value.filename == "policy.npz") is saved


@pytest.mark.parametrize("text", ['{"layers": 3}', "[1]", "{"])
def test_a_config_of_something_else_is_not_overwritten(config, tmp_path, text):
    """Of another program, or no JSON."""
    (tmp_path / "config.json").write_text(text)
    line = refused(opened, tmp_path, config)
    assert f"--workdir={tmp_path} holds a config.json that is not of a run" in line
    assert (tmp_path / "config.json").read_text() == text


def test_a_folder_that_cannot_be_written_is_refused(config, tmp_path):
    """A file, or a folder below one: nothing is written over it, nor under it."""
    (tmp_path / "taken").write_text("mine")
    for name in ("taken", "taken/below"):
        line = refused(opened, tmp_path / name, config)
        assert f"--workdir={tmp_path / name}: cannot write there (" in line
    assert (tmp_path / "taken").read_text() == "mine"


IN = [
    "checkpoints/4",
    "checkpoints/4/state/new",
    "checkpoints/6",
    "checkpoints",
    "copy",
    "copy/new",
]


@pytest.mark.parametrize("fresh", [False, True])
@pytest.mark.parametrize("name", IN)
def test_no_run_begins_among_the_checkpoints_of_another(whole, config, tmp_path, name, fresh):
    """One in there would be played in the checkpoint's place; a folder of such a name alone is no matter."""
    run = shutil.copytree(whole.workdir, tmp_path / "run")
    shutil.copytree(run / "checkpoints" / "4", run / "copy")
    before = workdirs.everything(run)
    line = refused(opened, run / name, config, fresh=fresh)
    if name.startswith("copy"):
        source = run / "copy"
        assert line.startswith(
            f"--workdir={run / name}: is a checkpoint, or lies in one; --restore="
        )
    else:
        source = run / "checkpoints" / "4" if name.startswith("checkpoints/4") else run
        assert f"among the checkpoints of {run}; --workdir={run} goes on with that run" in line
    assert f"--restore={source} with another --workdir" in line
    assert workdir_lib.no_run(run / name) == line
    assert workdirs.everything(run) == before
    opened(tmp_path / "checkpoints" / "1", config)
    opened(tmp_path / "checkpoints" / "2", config)


def test_fresh_moves_the_old_run_aside(config, whole, tmp_path):
    """Twice; nothing of either is lost."""
    workdir = tmp_path / "run"
    shutil.copytree(whole.workdir, workdir)
    for number in (1, 2):
        said = []
        opened(workdir, config, fresh=True, say=said.append)
        assert said == [f"the run that was there is {tmp_path}/run.old-{number} now"]
        assert {p.name for p in workdir.iterdir()} <= {"config.json", "lock"}
        assert (tmp_path / f"run.old-{number}" / "config.json").exists()
    old = tmp_path / "run.old-1"
    assert {p.name for p in old.iterdir()} >= set(whole.files) - {"lock"}
    assert (old / "metrics.csv").read_bytes() == whole.files["metrics.csv"]


THEIRS = {  # what else is in the folder, what is said
    "thesis.txt": "holds thesis.txt, which no run writes",
    "src/main.c": "holds src, which no run writes",
    ".ssh/id": "holds .ssh, which no run writes",
    "policy.npz.part": None,
    "walk.html": None,  # of `play`, into the folder of the run
    "evaluation/evaluation.json": None,
    "evaluation-seed-3/evaluation.json": None,
    "damaged-5/x": None,
}


@pytest.mark.parametrize("run", [True, False])
@pytest.mark.parametrize("name", [n for n, said in THEIRS.items() if said])
def test_fresh_moves_nothing_that_no_run_wrote(config, tmp_path, name, run):
    """Somebody's folder, also one that a run was once started in; a line, and all is as it was."""
    workdir = tmp_path / "mine"
    (workdir / name).parent.mkdir(parents=True)
    (workdir / name).write_text("years")
    if run:
        opened(workdir, config)
    before = workdirs.everything(tmp_path)
    line = refused(opened, workdir, config, fresh=True)
    assert line.startswith(f"--workdir={workdir} {THEIRS[name]}")
    assert workdirs.everything(tmp_path) == before


@pytest.mark.parametrize("name", [n for n, said in THEIRS.items() if not said])
def test_fresh_moves_what_our_commands_wrote(config, tmp_path, name):
    workdir = tmp_path / "run"
    opened(workdir, config)
    (workdir / name).parent.mkdir(exist_ok=True)
    (workdir / name).write_text("a")
    opened(workdir, config, fresh=True)
    assert (tmp_path / "run.old-1" / name).read_text() == "a"


@pytest.mark.parametrize("name", ["walk.html", "config.json"])
def test_fresh_moves_no_folder_without_a_run(config, tmp_path, name):
    """Pictures, or another program's settings."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / name).write_text("{}")
    line = refused(opened, tmp_path / "mine", config, fresh=True)
    assert f"holds {name}, which no run" in line or "that is not of a run" in line
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert [path.name for path in (tmp_path / "mine").iterdir()] == [name]


def test_fresh_moves_no_folder_that_somebody_is_in_and_no_empty_one(config, tmp_path, monkeypatch):
    """What is written next would land in the old one."""
    workdir = tmp_path / "run"
    workdir.mkdir()
    opened(workdir, config, fresh=True)
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    (workdir / "events").mkdir()
    for inside, name in ((workdir, "."), (workdir / "events", ".."), (workdir / "events", workdir)):
        monkeypatch.chdir(inside)
        line = refused(opened, Path(name), config, fresh=True)
        assert "--fresh cannot move the folder that you are in" in line
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


# ---- the policy that is kept

NAN = float("nan")


@pytest.mark.parametrize(
    ("judged", "best"),
    [
        ({}, 0),  # never evaluated: the training episodes of an exploring policy say nothing
        ({"return": [1.0, 2.0, 3.0]}, 2),
        ({"return": [-5.0, -1.0, -3.0]}, 1),
        ({"return": [NAN, -1.0, -3.0]}, 1),
        ({"return": [NAN, NAN, NAN]}, 0),
        # who crosses its tile soon has a small return
        ({"return": [3.0, 2.0, 1.0], "crossed": [0.5, 0.9, 0.7]}, 1),
        ({"return": [3.0, 1.0, 2.0], "crossed": [0.5, 0.9, 0.9]}, 2),
        ({"return": [3.0, 3.0, 1.0], "crossed": [0.0, 0.0, 0.0]}, 0),
        ({"return": [3.0, 9.0, 1.0], "crossed": [0.5, NAN, 0.6]}, 2),
        ({"return": [3.0, NAN, 1.0], "crossed": [0.5, 0.9, 0.4]}, 0),
    ],
)
def test_the_best_of_several_seeds_is_the_best_in_the_evaluation(judged, best):
    params = {"std": np.arange(3.0), "actor": {"kernel": np.arange(12.0).reshape(3, 4)}}
    config = workdirs.config(run__num_seeds=3)
    judged = {name: np.array(value) for name, value in judged.items()}
    found = workdir_lib.best_params(config, params, judged)
    assert_same(found, jax.tree.map(lambda x: x[best], params))
    one = workdirs.config()
    assert_same(workdir_lib.best_params(one, params, {"return": np.array(3.0)}), params)


def test_a_save_has_the_worth_of_its_own_evaluation_and_the_policy_that_was_judged_best(
    whole, tmp_path, monkeypatch
):
    """The episodes in training favour the first seed, the evaluation the second."""
    config = workdirs.config(run__num_seeds=2)
    state = jax.tree.map(lambda x: jax.numpy.stack([x, x]), whole.state)
    params = jax.tree.map(lambda x: np.stack([x[0], x[1] + 1]), state.learner.params)
    state = state.replace(learner=state.learner.replace(params=params))
    saved = []
    monkeypatch.setattr(
        checkpoint,
        "save",
        lambda _, done, state, evaluation, **about: saved.append(
            (done, evaluation, about["best_seed"])
        ),
    )
    monkeypatch.setattr(checkpoint, "wait", lambda manager: None)
    monkeypatch.setattr(checkpoint, "read_back", lambda folder, state: None)
    training = np.array([[9.0, 1.0], [9.0, 1.0]])
    now = {"episode_return": training, "eval_return": np.array([[NAN, NAN], [3.0, 5.0]])}
    before = {"episode_return": training}
    crossed = now | {"eval_crossed": np.array([[NAN, NAN], [0.5, 0.25]])}
    run = workdirs.open_run(config, tmp_path)
    for done, metrics, worth, best in (
        (2, before, None, 0),
        (4, now, {"return": 4.0}, 1),
        (6, before, None, 1),  # judged earlier, not now
        (8, crossed, {"return": 4.0, "crossed": 0.375}, 0),
    ):
        counts = {"iteration": np.array([done]), "sim_steps": np.array([96 * done])}
        run.history.append(metrics | counts)
        workdir_lib.save(run, GO1, state, pytest.fail)
        assert saved[-1] == (done, worth, best)
        kept = params_in(tmp_path / "policy.npz")
        assert_same(kept, jax.tree.map(lambda x, best=best: x[best], params))
        with np.load(tmp_path / "policy.npz") as file:
            assert (file["trained/iteration"], file["trained/sim_steps"]) == (done, 96 * done)
