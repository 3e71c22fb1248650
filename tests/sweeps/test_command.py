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

from dynappo import config as config_lib
from dynappo.policy import checkpoint_file, source
from dynappo.program import devices
from dynappo.sweeps import command as sweeps
from dynappo.sweeps import folder, grid, together
from dynappo.train import command as train_command
from dynappo.train import run as run_lib

SWEEP = ["ppo.entropy_coef=0.003,0.3", "ppo.epochs=1,2"]
NAMES = [f"ppo.entropy_coef={c},ppo.epochs={e}" for c in (0.003, 0.3) for e in (1, 2)]


@pytest.fixture(autouse=True, scope="module")
def toy():
    """The toy environment; what the command sets for its own process stays out of this one."""
    with pytest.MonkeyPatch.context() as patch:
        workdirs.toy(patch)
        patch.setattr(devices, "own_process", lambda device: None)
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
    sweeps.train_and_show(asked(texts, **fields), workdir, fresh, restore, None, stop)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A sweep of two seeds without interruption; both floats in one program."""
    workdir = tmp_path_factory.mktemp("whole") / "sweep"
    sweep(workdir, SimpleNamespace(status=0, patient=False), run__num_seeds=2)
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


@pytest.mark.parametrize("name", NAMES)
def test_a_combination_is_the_run_without_a_sweep(whole, name, tmp_path):
    """Every number of metrics.csv, evaluation and checkpoint of both seeds, to 1e-4."""
    coef, epochs = (float(part.partition("=")[2]) for part in name.split(","))
    config = workdirs.config(run__num_seeds=2, ppo__entropy_coef=coef, ppo__epochs=int(epochs))
    run_lib.train(config, tmp_path)
    same(whole / name, tmp_path, 1e-4)
    others = [other for other in NAMES if other != name]
    for other in others:
        with pytest.raises(AssertionError):
            same(whole / other, tmp_path, 1e-4)
    assert json.loads((whole / name / "config.json").read_text()) == json.loads(
        (tmp_path / "config.json").read_text()
    )
