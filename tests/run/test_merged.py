"""Several runs as one program: their seeds side by side, each with its own numbers, and taken apart again."""

import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
import workdirs
from answers import refused
from toy_runs import assert_same

from dynappo.program import build
from dynappo.run import merged


def test_a_program_has_the_seeds_of_all_and_leaves_the_runs_as_they_are():
    config = toy_env.settings({"run.num_seeds": 3})[0]
    assert merged.config([config] * 2).run.num_seeds == 6
    assert merged.config([config] * 2).run.num_seeds == 6 and config.run.num_seeds == 3
    said = "4000 combinations x 3 seeds of the sweep train at once"
    assert said in refused(merged.config, [config] * 4000)


def test_every_run_has_its_own_floats_and_the_keys_it_has_alone(monkeypatch):
    """What the runs share stays one number; else there is one a seed, run after run."""
    given = []
    monkeypatch.setattr(build, "program", lambda *of, meanwhile: given.append((*of, meanwhile)))
    configs = [workdirs.config(run__num_seeds=2, ppo__entropy_coef=c) for c in (0.1, 0.2)]
    merged.program(configs, "env", "meanwhile")
    ((config, env, (hyper, keys), meanwhile),) = given
    assert (env, meanwhile, config.run.num_seeds) == ("env", "meanwhile", 4)
    np.testing.assert_array_equal(hyper.ppo.entropy_coef, np.float32([0.1, 0.1, 0.2, 0.2]))
    assert hyper.ppo.clip_epsilon == 0.2 and not np.shape(hyper.ppo.clip_epsilon)
    assert keys.shape == (4,) and (keys[:2] == keys[2:]).all() and keys[0] != keys[1]


@pytest.mark.parametrize("seeds", [1, 2])
@pytest.mark.parametrize("runs", [1, 3])
def test_states_that_are_joined_come_apart_as_they_were(runs, seeds):
    """Of one run nothing is copied; of one seed there is no axis."""
    shape = (seeds, 5) if seeds > 1 else (5,)
    states = [{"a": i + jnp.arange(5 * seeds).reshape(shape), "none": None} for i in range(runs)]
    state = merged.join(states, seeds)
    assert (state is states[0]) == (runs == 1)
    for i, one in enumerate(states):
        assert_same(merged.part(state, i, runs=runs, seeds=seeds), one)
    metrics = {"x": np.arange(4 * runs * seeds).reshape(4, -1)}
    if runs == 3:
        last = merged.part(metrics, 2, axis=1, runs=runs, seeds=seeds)["x"]
        np.testing.assert_array_equal(last, metrics["x"][:, -1 if seeds == 1 else slice(-2, None)])
