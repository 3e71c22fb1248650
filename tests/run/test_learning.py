"""A Go1 learns to walk: the shipped `:laptop`, all of its 400 iterations, in a process as users start it.

The level is that of policy/walks.py. Its 200 episodes tell 3 % of falls from none, not 1 % from 2 %. Only
the film is left out.
"""

import json
import os
import subprocess
import sys

import pytest
from answers import ROOT

from dynappo import config as config_lib
from dynappo.evaluate import changes
from dynappo.policy import policy_source, walks

MOST_FALLS = 0.03
TRAIN = """\
import sys
from dynappo import config, train
settings = config.load("configs/go1.py:laptop")
settings.run.video_seconds = 0.0
train.train(settings, sys.argv[1])
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The workdir of the run. conftest.py lets XLA optimise little, which users do not."""
    folder = tmp_path_factory.mktemp("learning") / "laptop"
    theirs = os.environ | {"XLA_FLAGS": "", "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", TRAIN, folder], cwd=ROOT, env=theirs, check=True)
    return folder


@pytest.mark.slow
@pytest.mark.timeout(3600)  # 90 s of two idle cores
def test_laptop_walks_at_its_end(folder):
    summary = json.loads((folder / "summary.json").read_text())
    config = config_lib.load("configs/go1.py:laptop")
    assert summary["iterations"] == config.run.num_iterations == 400
    assert (config.run.eval_envs, config.run.eval_steps) == (200, 1000)  # 20 s each
    assert summary["versions"]["jax"] and summary["impl"] == "c"
    least = walks.level(walks.best(config.task.weights))
    assert least == pytest.approx(38)
    found = summary["evaluation"]
    print(f"return {found['return']:.2f}, falls {100 * found['fall_rate']:.1f} %")
    assert walks.at(found["return"], least), found
    assert walks.seldom(found["fall_rate"], MOST_FALLS), found


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_its_policy_walks_the_tours_of_film_and_live_page(folder):
    """In C MuJoCo, as `play` shows them. Of two runs of this seed, with other bits, one fell once in two
    rounds on the page, when it was told 1.0 m/s ahead: so one fall is let pass there."""
    body, _ = policy_source.player(policy_source.load(str(folder))[0], None)
    film, page = changes.tours(body)
    assert (film["tour"], page["tour"]) == ("film", "live page")
    assert not film["fell_at"] and len(page["fell_at"]) <= 1
