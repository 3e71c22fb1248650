"""A run that goes on: with other code, another engine, longer evaluations, or beside another run."""

import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import workdirs
from answers import refused
from ml_collections import config_dict
from workdirs import opened

from dynappo import config as config_lib
from dynappo.config import files, own_code
from dynappo.policy import checkpoint_file
from dynappo.run import blowups, show
from dynappo.run import workdir as workdir_lib

# ---- its code

FILE = '''
"""A task."""
import helper
SCALE = 2.0

def get_config(variant=""):
    from dynappo import config
    found = config.load("go1:dyna4")
    found.run.num_iterations = 4
    return found

def get_env(config):
    """Ours."""
    return helper.env(SCALE)  # an environment
'''
CHANGED = {  # what is changed in the file, and whether it is another environment
    "a number": ("SCALE = 2.0", "SCALE = -2.0", True),
    "the reward": ("helper.env(SCALE)", "helper.env(100 * SCALE)", True),
    "a comment": ("# an environment", "# the environment", False),
    "a docstring": ('"""Ours."""', '"""Mine."""', False),
    "layout": ("SCALE = 2.0", "\n\nSCALE  =  2.0", False),
    "how long it trains": ("num_iterations = 4", "num_iterations = 40", False),
}


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A folder with mine.py, which imports helper.py beside it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("mine.py").write_text(FILE)
    Path("helper.py").write_text("import math\n\ndef env(scale):\n    return scale\n")
    return Path("mine.py")


@pytest.mark.parametrize("name", CHANGED)
def test_changed_code_is_another_environment(own, name):
    before, after, other = CHANGED[name]
    first = own_code.digest(own)
    assert first == own_code.digest(own) and before in FILE
    own.write_text(FILE.replace(before, after, 1))
    assert (own_code.digest(own) != first) == other


def test_a_file_that_it_imports_counts_too(own):
    """In any depth; one of another name in the folder does not."""
    first = own_code.digest(own)
    Path("other.py").write_text("x = 1")
    assert own_code.digest(own) == first
    Path("helper.py").write_text("from deep import env\n")
    Path("deep.py").write_text("def env(scale):\n    return scale\n")
    second = own_code.digest(own)
    Path("deep.py").write_text("def env(scale):\n    return -scale\n")
    assert len({first, second, own_code.digest(own)}) == 3


def with_code(code):
    """The config of the small run, as if it were of such a file."""
    config = config_dict.ConfigDict(workdirs.config().to_dict())
    config.code = code
    return config_lib.validate(config)


def test_a_run_does_not_go_on_with_other_code(own, whole):
    """By the config of the file; the line says what may change."""
    config, get_env = config_lib.load_both("mine.py")
    assert config.code == own_code.digest(own) and get_env is not None
    here = with_code(config.code)
    shutil.copytree(whole.workdir, "run")
    kept = whole.workdir / "config.json"
    for name in ("config.json", *(f"checkpoints/{n}/about/metadata" for n in (2, 4))):
        text = Path("run", name).read_text().replace('"code": ""', f'"code": "{config.code}"')
        assert text != (whole.workdir / name).read_text()
        Path("run", name).write_text(text)
    opened(Path("run"), here)
    own.write_text(FILE.replace("SCALE = 2.0", "SCALE = -2.0"))
    changed = with_code(config_lib.load("mine.py").code)
    line = refused(opened, Path("run"), changed)
    assert (
        "the file with get_env, or one that it imports, has changed; comments and get_config may"
        in line
    )
    assert kept.read_bytes() == whole.files["config.json"]


# ---- what computes it


def test_another_engine_device_or_commit_is_said_and_kept(config, program, tmp_path):
    """On the line that it goes on; summary.json of such a run lists both."""
    first = program()._replace(impl="jax", device="NVIDIA H200")
    workdirs.loop(config, first, tmp_path, stop=True)
    said: list[str] = []
    workdirs.loop(config, program()._replace(impl="c"), tmp_path, say=said.append)
    there = "engine c (jax before), device cpu (NVIDIA H200 before)"
    assert said == [f"goes on from iteration 2 of {tmp_path}, now with {there}"]
    about = checkpoint_file.about(tmp_path / "checkpoints" / "4")
    assert [one["engine"] for one in about["origins"]] == ["jax", "c"]
    made = workdir_lib.made_by(program(), config)
    again = workdir_lib.origins(tmp_path, made | {"engine": "c"})
    assert len(again) == 2  # the same as last time
    more = workdir_lib.origins(tmp_path, made | {"engine": "c", "commit": "0123456789ab"})
    assert (
        workdir_lib._elsewhere(more) == f", now with commit 0123456789ab ({made['commit']} before)"
    )
    assert workdir_lib._elsewhere(more[:1]) == workdir_lib._elsewhere(()) == ""


# ---- its evaluations


def test_longer_episodes_are_not_mixed_with_shorter_ones(tmp_path, config):
    """Where a run evaluates on its way; at the end alone their length may change."""
    for every, fine in ((2, False), (0, True)):
        workdir = tmp_path / str(every)
        opened(workdir, workdirs.config(run__eval_every=every, run__eval_steps=20))
        (workdir / "metrics.csv").write_text("iteration\n1\n")
        longer = workdirs.config(run__eval_every=every, run__eval_steps=40)
        if fine:
            opened(workdir, longer)
        else:
            assert "(run.eval_steps 20 there, 40 here)" in refused(opened, workdir, longer)
            opened(
                workdir,
                workdirs.config(run__eval_every=every, run__eval_steps=20, run__eval_envs=9),
            )


# ---- physics that blow up


def rows(*counts, seeds=1):
    """Metrics of iterations with 10 real rows of 16 robots, of which so many blew up."""
    blown = np.array(counts, float)
    blown = blown if seeds == 1 else np.stack([0 * blown] * (seeds - 1) + [blown], 1)
    return {
        "blowups": blown,
        "n_real": np.full(len(counts), 10),
        "iteration": 5 + np.arange(len(counts)),
    }


@pytest.mark.parametrize("seeds", [1, 3])
def test_blow_ups_are_counted_of_all_real_rows(seeds):
    """Of several seeds in the worst of them; some are told, most end the run."""
    check = partial(blowups.check, num_envs=16)
    assert blowups.share(rows(8, 24, seeds=seeds), 16) == pytest.approx(0.1)
    assert check(rows(1, 1, seeds=seeds)) == "" == check({"iteration": np.ones(1)})
    line = check(rows(8, 24, seeds=seeds))
    assert (
        line.startswith("physics blew up in 10% of the rows of iterations 5 to 6")
        and "falls" in line
    )
    with pytest.raises(
        FloatingPointError, match="100% of the rows of iterations 5 to 6: nothing can be"
    ):
        check(rows(160, 160, seeds=seeds))


def test_a_run_says_once_that_its_physics_blow_up_and_ends_where_most_do(
    config, program, tmp_path, monkeypatch, capsys
):
    """The loop itself, with the columns of a program whose robots blow up; the table has the share."""
    run, share = program(), 0.0

    def step(*given):
        state, metrics = run.step(*given)
        count = share * 16 * np.asarray(given[2]["n_real"], float)
        return state, metrics | {"blowups": count}

    said: list[str] = []
    share = 0.25
    workdirs.loop(config, run._replace(step=step), tmp_path / "some", say=said.append)
    assert len(said) == 1 and said[0].startswith(
        "physics blew up in 25% of the rows of iterations 1 to 2"
    )
    share = 1.0
    with pytest.raises(FloatingPointError, match="physics blew up in 100%"):
        workdirs.loop(config, program()._replace(step=step), tmp_path / "all", say=said.append)
    from rich.console import Console

    summary = {"return": 1.0, "return_max": 1.0, "sim_steps": 9, "seconds": 1.0, "impl": "c"}
    summary |= {"compile_seconds": 1.0, "blowups": 0.25}
    show.summary(Console(width=100), config, tmp_path, summary)
    assert "physics blew up" in (text := capsys.readouterr().out) and "in 25% of the rows" in text


# ---- beside another run


def test_a_run_whose_lock_was_deleted_ends_before_it_mixes_rows(config, program, tmp_path):
    """A second one has begun there: the first ends at its next rows, and the second's file stays whole."""
    lines = []

    def second(iteration, last):  # begins while the first trains
        (tmp_path / "lock").write_text("pid 1 on another machine\n")
        lines.append((tmp_path / "metrics.csv").read_bytes() if iteration == 4 else b"")

    assert workdir_lib.check_held(tmp_path) is None  # there is no lock
    (tmp_path / "lock").write_text(files.holder())
    with pytest.raises(OSError, match="another run has begun in this folder .pid 1 on another"):
        workdirs.loop(config, program(), tmp_path, progress=second)
    assert len(workdirs.table(tmp_path)) == 2


def test_rows_of_two_runs_in_one_file_are_said(whole, config, program, tmp_path):
    """Each iteration is there once afterwards, and the run goes on."""
    workdir, said = tmp_path / "run", []
    shutil.copytree(whole.workdir, workdir)
    text = (workdir / "metrics.csv").read_text()
    (workdir / "metrics.csv").write_text(text + "".join(text.splitlines(keepends=True)[2:4]))
    workdirs.loop(config, program(), workdir, say=said.append)
    assert said[
        0
    ] == f"{workdir / 'metrics.csv'} has 2 rows twice, as if two runs had written it; " + (
        "the last of each is kept"
    )
    assert [row["iteration"] for row in workdirs.table(workdir)] == ["1", "2", "3", "4"]


def test_a_folder_without_locks_has_the_name_of_who_came_last(tmp_path, monkeypatch):
    """So a second run is seen there, too."""
    import errno

    import filelock

    def none(self, **how):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(filelock.FileLock, "acquire", none)
    with files.locked(tmp_path / "lock"):
        assert (tmp_path / "lock").read_text() == files.holder()
