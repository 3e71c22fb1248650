"""Which random keys a function uses, and how: drawn from, split, or folded.

`record` traces the function and goes through its jaxpr in Python, loops row by row. Only what is known
is computed: keys and whole numbers. All else is `UNKNOWN`: states, networks, physics, the numbers that are
drawn. So two iterations of a run take a second, whatever they would compute. A key, or the number
of a fold, that is unknown is an error, so no draw is missed.

`faults` is the rule: a key is drawn from once, or split once, or folded, and never two of these.
In threefry `split(key)[i]` is `fold_in(key, i)`; and to draw is to hash the same counters.
"""

from __future__ import annotations

import collections
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend import core as jax_core

UNKNOWN = object()
RANDOM = {"random_bits": "drawn from", "random_split": "split", "random_fold_in": "folded"}


class Use(NamedTuple):
    """One use of one key."""

    key: tuple[int, ...]  # its data
    how: str  # a value of RANDOM
    where: str  # the lines of dynappo, outermost first


def record(function, *args) -> tuple[list[Use], Any]:
    """`(uses, out)` of `function(*args)`; leaves of `args` that are a ShapeDtypeStruct are unknown.

    So are those of `out`, which can be an argument of the next call.
    """
    closed, shapes = jax.make_jaxpr(function, return_shape=True)(*args)
    leaves = jax.tree.leaves(args)
    known = [UNKNOWN if isinstance(x, jax.ShapeDtypeStruct) else jnp.asarray(x) for x in leaves]
    uses: list[Use] = []
    out = _run(closed.jaxpr, [*closed.consts, *known], uses)
    flat, tree = jax.tree.flatten(shapes)
    flat = [x if value is UNKNOWN else value for x, value in zip(flat, out, strict=True)]
    return uses, jax.tree.unflatten(tree, flat)


def faults(uses: list[Use]) -> list[str]:
    """A line for each pair of places that break the rule, with the number of keys concerned."""
    of_key = collections.defaultdict(list)
    for use in uses:
        of_key[use.key].append(use)
    lines = collections.Counter()
    for same in of_key.values():
        ways = {use.how for use in same}
        if len(ways) > 1 or (len(same) > 1 and ways != {"folded"}):
            places = sorted({f"{use.how} at {use.where}" for use in same})
            lines[" and ".join(places if len(places) > 1 else places * 2)] += 1
    return [f"{count} keys: {line}" for line, count in lines.items()]


def _run(program, args, uses, caller="") -> list[Any]:
    """The outputs of a jaxpr, and its uses of keys added to `uses`.

    `caller` is where a jitted function was called: JAX traces it once for all its callers.
    """
    if isinstance(program, jax_core.ClosedJaxpr):
        return _run(program.jaxpr, [*program.consts, *args], uses, caller)
    jaxpr = program
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], args, strict=True))

    def read(atom):
        return atom.val if isinstance(atom, jax_core.Literal) else values[atom]

    for eqn in jaxpr.eqns:
        out = _equation(eqn, [read(atom) for atom in eqn.invars], uses, caller)
        values.update(zip(eqn.outvars, out, strict=True))
    return [read(atom) for atom in jaxpr.outvars]


def _equation(eqn, args, uses, caller) -> list[Any]:
    name, params, where = eqn.primitive.name, eqn.params, caller or _where(eqn)
    nothing = [UNKNOWN] * len(eqn.outvars)
    if name in RANDOM:
        if any(x is UNKNOWN for x in args):
            raise ValueError(f"a key or a fold depends on what is computed: {where}")
        shape = np.broadcast_shapes(*(np.shape(x) for x in args))  # one key, several folds
        data = np.asarray(jax.random.key_data(args[0]))
        data = np.broadcast_to(data, (*shape, data.shape[-1])).reshape(-1, data.shape[-1])
        uses.extend(Use(tuple(key), RANDOM[name], where) for key in data.tolist())
        if name == "random_bits":
            return nothing
    inner = [x for value in params.values() for x in _programs(value)]
    all_known = not any(x is UNKNOWN for x in args)
    exact = not any(jnp.issubdtype(v.aval.dtype, jnp.inexact) for v in eqn.outvars)
    if not inner and all_known and exact:
        out = eqn.primitive.bind(*args, **params)
        return out if eqn.primitive.multiple_results else [out]
    if not inner or not (all_known or any(map(_draws, inner))):
        return nothing
    if name == "scan":
        return _scan(args, params, uses, caller)
    if name == "while":
        return _while(args, params, uses, caller)
    if name == "cond":
        if args[0] is not UNKNOWN:
            return _run(params["branches"][int(args[0])], args[1:], uses, caller)
        for branch in params["branches"]:
            _run(branch, args[1:], uses, caller)
        return nothing
    (program,) = inner  # a call: jit, checkpoint, custom derivatives
    # `algorithm.run` alone calls an iteration: places in it are more telling than that of the call
    return _run(program, args, uses, "" if params.get("name") == "iterate" else where)


def _scan(args, params, uses, caller):
    consts, carry = params["num_consts"], params["num_carry"]
    fixed, state, rows = args[:consts], args[consts : consts + carry], args[consts + carry :]
    order = range(params["length"])
    out = []
    for i in reversed(order) if params["reverse"] else order:
        row = [x if x is UNKNOWN else x[i] for x in rows]
        new = _run(params["jaxpr"], [*fixed, *state, *row], uses, caller)
        state = new[:carry]
        out.append(new[carry:])
    columns = zip(*(out[::-1] if params["reverse"] else out), strict=True)
    return [
        *state,
        *(
            UNKNOWN if any(x is UNKNOWN for x in column) else jnp.stack(column)
            for column in columns
        ),
    ]


def _while(args, params, uses, caller):
    asked, both = params["cond_nconsts"], params["cond_nconsts"] + params["body_nconsts"]
    state = args[both:]
    while True:
        (go,) = _run(params["cond_jaxpr"], [*args[:asked], *state], uses, caller)
        if go is UNKNOWN:
            raise ValueError("the end of a loop that draws depends on what is computed")
        if not go:
            return state
        state = _run(params["body_jaxpr"], [*args[asked:both], *state], uses, caller)


def _programs(value):
    """The jaxprs in a parameter of an equation."""
    parts = value if isinstance(value, (tuple, list)) else [value]
    return [x for x in parts if isinstance(x, (jax_core.Jaxpr, jax_core.ClosedJaxpr))]


def _draws(program) -> bool:
    """Whether a jaxpr has an equation of RANDOM, at any depth."""
    for eqn in getattr(program, "jaxpr", program).eqns:
        inner = [x for value in eqn.params.values() for x in _programs(value)]
        if eqn.primitive.name in RANDOM or any(map(_draws, inner)):
            return True
    return False


def _where(eqn) -> str:
    frames = eqn.source_info.traceback.frames[::-1]
    lines = [
        f"{f.file_name.split('/')[-1]}:{f.line_num}" for f in frames if "/dynappo/" in f.file_name
    ]
    return " > ".join(lines)
