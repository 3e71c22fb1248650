"""What a CPU does with the learner: products, activations, and PPO's update by the size of its networks.

taskset -c 0,1 python experiments/04_laptop/learner.py OUT.json
"""

import os
import resource
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp

from dynappo import config as config_lib
from dynappo.config import files
from dynappo.learner import networks, ppo
from dynappo.program import devices
from experiments import paper

ROWS = 3072  # of a minibatch: 512 robots, 24 rows, 4 minibatches
SHAPES = ((ROWS, 128, 128), (ROWS, 48, 256), (ROWS, 64, 64), (512, 48, 256))


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    devices.own_process("cpu")
    found = {"cores": len(os.sched_getaffinity(0))}
    found |= {"products": products(), "activations": activations(), "updates": updates()}
    files.write_json(args.out, found)


def timed(function, *args, seconds: float = 1.0) -> dict[str, float]:
    """Of a call of the compiled function: ms, and the cores that it kept busy."""

    def spent():
        used = resource.getrusage(resource.RUSAGE_SELF)
        return used.ru_utime + used.ru_stime

    compiled = jax.jit(function)
    jax.block_until_ready(compiled(*args))
    began, before, calls = time.perf_counter(), spent(), 0
    while time.perf_counter() - began < seconds:
        jax.block_until_ready(compiled(*args))
        calls += 1
    took = time.perf_counter() - began
    return {"ms": took / calls * 1e3, "cores": (spent() - before) / took}


def products() -> dict:
    """The three products of a layer: forward, of the weights' gradient, of the inputs'."""
    out = {}
    for rows, inputs, outputs in SHAPES:
        keys = jax.random.split(jax.random.key(0), 3)
        shapes = (rows, inputs), (inputs, outputs), (rows, outputs)
        x, w, g = map(jax.random.normal, keys, shapes)
        for name, f, a in (
            ("x w", jnp.matmul, (x, w)),
            ("x' g", lambda x, g: x.T @ g, (x, g)),
            ("g w'", lambda g, w: g @ w.T, (g, w)),
        ):
            row = timed(f, *a)
            row["gflops"] = 2e-6 * rows * inputs * outputs / row["ms"]
            out[f"{rows} x {inputs} x {outputs}, {name}"] = row
            print(
                f"{rows} x {inputs} x {outputs}, {name:5s} {row['gflops']:6.0f} GFLOP/s", flush=True
            )
    return out


def activations() -> dict:
    """Of an array [ROWS, 256], with the gradient."""
    x, out = jax.random.normal(jax.random.key(0), (ROWS, 256)), {}
    for name, f in {**networks.ACTIVATIONS, "elu of flax": jax.nn.elu}.items():
        slope = jax.grad(lambda x, f=f: f(x).sum())
        out[name] = {"value": timed(f, x), "gradient": timed(slope, x)}
        ms = [out[name][what]["ms"] for what in ("value", "gradient")]
        print(f"{name:12s} {ms[0]:.3f} ms, gradient {ms[1]:.3f} ms", flush=True)
    return out


def updates() -> dict:
    """`ppo.update` of 512 robots and 24 rows: five epochs of four minibatches."""
    out = {}
    for hidden in ((128, 128, 128), (64, 64, 64), (128, 64)):
        for activation in ("elu", "swish"):
            config = config_lib.load("configs/go1.py:laptop")
            config.ppo.update(hidden=hidden, activation=activation)
            static, hyper = config_lib.split(config_lib.validate(config))
            sizes = config.rollout.horizon, config.rollout.num_envs
            keys = jax.random.split(jax.random.key(0), 8)
            draw = iter(keys)
            obs, action = (jax.random.normal(next(draw), (*sizes, n)) for n in (48, 12))
            rest = [jax.random.normal(next(draw), sizes) for _ in range(4)]
            batch = ppo.Batch(obs, action, action * 0, *rest)
            learner = ppo.init(static, hyper, 48, 12, next(draw))
            row = timed(partial(ppo.update, static, hyper), learner, batch, next(draw), seconds=3)
            weights = sum(p.size for p in jax.tree.leaves(learner.params))
            flops = 6e-6 * weights * sizes[0] * sizes[1] * config.ppo.epochs
            row["gflops"] = flops / row["ms"]
            out[f"{hidden} {activation}"] = row
            print(
                f"{hidden} {activation}: {row['ms']:.0f} ms, {row['gflops']:.0f} GFLOP/s",
                flush=True,
            )
    return out


if __name__ == "__main__":
    main()
