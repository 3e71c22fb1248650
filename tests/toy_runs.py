"""What a run over a toy environment did: its columns, the rollout inside an iteration, comparisons."""

import functools
import importlib.metadata
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jax_core

from dynappo import algorithm, schedule
from dynappo.types import Transition

N, R, ITERATIONS = 8, 16, 6  # of `toy_env.settings`
# of `jax.jit`: what conftest.py turns off; jaxlib 0.11 has lost the flag
OLD = tuple(map(int, importlib.metadata.version("jaxlib").split(".")[:2])) < (0, 11)
AS_USERS = {"xla_cpu_use_fusion_emitters": True} if OLD else {}
FIELDS = len(Transition.__dataclass_fields__)


def columns(config, n_real=None, epochs=None, first=1):
    """The schedule on the device; `n_real` and `epochs` replace it, `first` is the iteration."""
    out = schedule.columns(config)
    out["iteration"] = out["iteration"] + np.int32(first - 1)
    if n_real is not None:
        out["n_real"] = np.broadcast_to(np.int32(n_real), out["n_real"].shape)
    if epochs is not None:
        out["model_epochs"] = np.broadcast_to(np.int32(epochs), out["n_real"].shape)
    return {name: jnp.asarray(column, jnp.int32) for name, column in out.items()}


def row(config, **kwargs):
    """The first row of `columns`."""
    return {name: column[0] for name, column in columns(config, **kwargs).items()}


def carries_a_rollout(equation, robots):
    """Whether an equation is the loop of rounds, which carries the rollout's fields."""
    shapes = [v.aval.shape for v in equation.outvars]
    return equation.primitive.name in ("while", "scan") and shapes.count((N, robots, 6)) >= 2


@functools.cache
def observe(env, static, as_users=False):
    """`f(hyper, state, row) -> (rollout, state, metrics)`: `iterate`, and the rollout inside it.

    The rollout, of the imagined robots, is what the last loop of rounds leaves in the program of `iterate`:
    the program itself is asked for it. `as_users`: its bits are compared with those of another program.
    """

    robots = R * static.rollout.imagined

    def call(hyper, state, row):
        closed, shape = jax.make_jaxpr(
            partial(algorithm.iterate, env, static=static), return_shape=True
        )(hyper, state, row)
        program = closed.jaxpr
        carried = [e for e in program.eqns if carries_a_rollout(e, robots)][-1].outvars
        begin = [v.aval.shape for v in carried].index((N, robots, 6))
        program = program.replace(
            outvars=[*carried[begin : begin + FIELDS], *program.outvars],
            debug_info=program.debug_info.with_unknown_names(),
        )
        out = jax_core.jaxpr_as_fun(closed.replace(jaxpr=program))(
            *jax.tree.leaves((hyper, state, row))
        )
        return Transition(*out[:FIELDS]), *jax.tree.unflatten(
            jax.tree.structure(shape), out[FIELDS:]
        )

    return jax.jit(call, compiler_options=AS_USERS if as_users else None)


def leaves(tree):
    """`{path: NumPy array}` of a pytree; keys as their data."""
    out = {}
    for path, x in jax.tree.leaves_with_path(tree):
        is_key = hasattr(x, "dtype") and jax.dtypes.issubdtype(x.dtype, jax.dtypes.prng_key)
        out[jax.tree_util.keystr(path)] = np.asarray(jax.random.key_data(x) if is_key else x)
    return out


def assert_same(one, other):
    """Two pytrees are equal to the bit; NaN equals NaN."""
    one, other = leaves(one), leaves(other)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name)


def assert_close(one, other, tolerance):
    """Two pytrees agree within `tolerance`, relative or absolute."""
    one, other = leaves(one), leaves(other)
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_allclose(one[name], other[name], tolerance, tolerance, err_msg=name)


def advantages(rows, value, last, *, gamma, lambda_):
    """Advantages [N, R] of NumPy rows, by loops over robots and rows from the last to the first.

    The next value is `last`, V(next_obs), at a time limit and in the last row, elsewhere the next row's
    `value`.
    """
    out, later = np.zeros((N, R)), np.zeros(R)
    for t in reversed(range(N)):
        for r in range(R):
            cut = rows.truncation[t, r] == 1
            after = last[t, r] if cut or t == N - 1 else value[t + 1, r]
            alive = rows.discount[t, r] * gamma
            delta = rows.reward[t, r] + alive * after - value[t, r]
            later[r] = delta + alive * lambda_ * (not cut) * later[r]
        out[t] = later
    return out
