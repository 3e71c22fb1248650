"""A whole run on rough ground, two seeds under one vmap in C MuJoCo: what the curriculum logs, and that a run
which was stopped goes on to the bit."""

import jax
import numpy as np
import pytest
import workdirs
from toy_runs import assert_same
from workdirs import one_program  # noqa: F401, a fixture

from dynappo import config as config_lib
from dynappo import train

pytestmark = pytest.mark.slow
ROWS, ROBOTS, ITERATIONS = 4, 16, 6
# small tiles and quick starts: within an episode some robots fall, which makes the next row easier, and some
# leave their tile, which makes it harder
SMALL = (
    f"run.num_seeds=2 run.num_iterations={ITERATIONS} run.log_every=1 run.checkpoint_every=1 run.eval_envs=0 "
    "run.video_seconds=0.0 run.tensorboard=False run.device=cpu physics.impl=c physics.threads=1 "
    f"rollout.num_envs={ROBOTS} rollout.horizon=12 schedule.end_iteration=3 schedule.end_steps=4 "
    "schedule.rounds=2 model.hidden=(16,) model.minibatches=2 ppo.hidden=(16,) task.episode_length=40 "
    f"task.reset.velocity=2.0 task.tiles.rows={ROWS} task.tiles.columns=6 task.tiles.start_rows=3 "
    "task.tiles.size=2.0 task.tiles.cell=0.1 task.tiles.stairs_border=0.2 task.tiles.stairs_platform=1.0 "
    "task.tiles.platform=1.0 task.tiles.shares=(1.0,1.0,1.0,1.0,1.0,1.0)"
).split()


def settings(*fields):
    config = config_lib.load("configs/go2.py:rough")
    for text in [*SMALL, *fields]:
        config_lib.override(config, *text.split("=", 1))
    return config


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """`(state, metrics, workdir)` of a run without interruption."""
    folder = tmp_path_factory.mktemp("whole")
    return *train.train(settings(), folder), folder


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    """`(state, metrics, workdir)` of its first half."""
    folder = tmp_path_factory.mktemp("half")
    return *train.train(settings(f"run.num_iterations={ITERATIONS // 2}"), folder), folder


def test_each_seed_has_a_curriculum_of_its_own_which_is_logged(whole, half):
    """Rows of both seeds differ, and became harder and easier on the way; the shares of the rows are of all
    robots, and their mean is the mean row."""
    (state, metrics, folder), middle = whole, half[0].env_state.tile
    tile = state.env_state.tile
    assert tile.row.shape == (2, ROBOTS)
    assert (tile.row[0] != tile.row[1]).any() and (tile.column[0] != tile.column[1]).any()
    for seed in (0, 1):
        moved = np.asarray(tile.row[seed]) - np.asarray(middle.row[seed])
        assert moved.min() < 0 < moved.max(), moved
    shares = np.stack([metrics[f"terrain_row_{row}"] for row in range(ROWS)], -1)
    assert shares.shape == (ITERATIONS, 2, ROWS)
    np.testing.assert_allclose(shares.sum(-1), 1, atol=1e-6)
    np.testing.assert_allclose(shares @ np.arange(ROWS), metrics["terrain_row"], atol=1e-5)
    assert (shares[0] != shares[-1]).any(-1).all() and (shares[-1, 0] != shares[-1, 1]).any()
    assert (metrics["crossings"].sum(0) > 0).all()
    # of the robots at the end, before the last control step, a seed's column each
    head = set(workdirs.table(folder)[0])
    assert {"terrain_row", *(f"terrain_row_{row}" for row in range(ROWS))} <= head


def test_a_run_that_was_stopped_goes_on_to_the_bit(whole, half):
    """Every leaf of the state, the curriculum's tiles among them, and every number that is logged."""
    _, _, folder = half
    state, metrics = train.train(settings(), folder)
    assert_same(state, whole[0])
    assert jax.tree.structure(state) == jax.tree.structure(whole[0])
    assert metrics.keys() == whole[1].keys() and len(metrics["iteration"]) == ITERATIONS
    for name in metrics.keys() - {
        "seconds"
    }:  # those of the first half come from the CSV, with six digits
        later = slice(ITERATIONS // 2, None)
        np.testing.assert_array_equal(metrics[name][later], whole[1][name][later], name)
    assert workdirs.table(folder) == workdirs.table(whole[2])
