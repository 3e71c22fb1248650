"""Several runs as one program: compiled once, stepped together, taken apart to be written.

All runs' seeds share one batch axis; each keeps its run's hyperparameters, and the keys that the run would
give it alone. So each run gives what it would give alone, up to the last digits of a float. A single run is
not batched further, and gives the same to the bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import ConfigError, fields
from dynappo.program import build
from dynappo.program.build import Program


def config(configs: list) -> Any:
    """The validated config of the program of several runs: the first's, with the seeds of all.

    ConfigError where these are too many.
    """
    joined = fields.copied(configs[0])  # a copy: ConfigDict(config) would share its groups
    joined.run.num_seeds *= len(configs)
    try:
        return config_lib.validate(joined)
    except ConfigError as error:
        raise too_many(error, configs) from None


def too_many(error: ConfigError, configs: list) -> ConfigError:
    """The line for runs that do not fit into one program, with what to do."""
    if len(configs) == 1:
        return error
    seeds = configs[0].run.num_seeds
    return ConfigError(
        f"{error}. {len(configs)} combinations x {seeds} seeds of the sweep train at once: name fewer "
        "values, and add the others in a second command"
    )


def with_log_every(config, log_every: int) -> Any:
    """`config` with chunks of another length."""
    config = fields.copied(config)  # a copy
    config.run.log_every = log_every
    return config_dict.FrozenConfigDict(config)


def program(configs: list, env: Any, meanwhile: Callable[[], None]) -> Program:
    """The compiled program of all seeds of runs whose configs differ in floats alone (`build.program`)."""
    if len(configs) == 1:
        return build.program(configs[0], env, meanwhile=meanwhile)
    import jax
    import jax.numpy as jnp

    from dynappo import seeds

    run = configs[0].run

    def each(*values):
        if len(set(values)) == 1:
            return values[0]
        return jnp.repeat(jnp.asarray(values, jnp.float32), run.num_seeds)

    hyper = jax.tree.map(each, *build.floats(configs, env))
    keys = jnp.concatenate([seeds.keys(run.seed, run.num_seeds)] * len(configs))
    try:
        return build.program(config(configs), env, (hyper, keys), meanwhile=meanwhile)
    except ConfigError as error:  # the memory of a device
        raise too_many(error, configs) from None


def part(tree: Any, i: int, axis: int = 0, *, runs: int, seeds: int) -> Any:
    """What belongs to run number `i` of `runs`, in arrays with all seeds along `axis`.

    A run with one seed has no such axis, as when it is alone; of one run it is all.
    """
    import jax

    if runs == 1:
        return tree
    at = i if seeds == 1 else slice(i * seeds, (i + 1) * seeds)
    return jax.tree.map(lambda x: x[(slice(None),) * axis + (at,)], tree)


def join(states: list, seeds: int) -> Any:
    """The state of all runs: the inverse of `part`."""
    import jax
    import jax.numpy as jnp

    if len(states) == 1:
        return states[0]
    side_by_side = jnp.stack if seeds == 1 else jnp.concatenate
    return jax.tree.map(lambda *leaves: side_by_side(leaves), *states)
