"""How many kernels a GPU launches for a row of the tail, a minibatch of the fit, one of PPO; without a GPU.

    python experiments/03_speed/compiled.py [--config go1:best] [--set FIELD=VALUE ...] [--list]

XLA compiles the three loops for an H100 that is not here. That needs the extra cuda13 on Linux. It cannot
time what it compiles, so it chooses products by rules: a GPU's own program may have a few kernels more or
less. `--list` names them.
"""

import collections
import os
import re
from functools import partial

os.environ["JAX_PLATFORMS"] = "cpu"

import jax
import jax.numpy as jnp
from jax.experimental import topologies

from dynappo import algorithm, fast, rollout
from dynappo import config as config_lib
from dynappo.learner import symmetry
from dynappo.model import dynamics, examples
from dynappo.physics import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

# XLA's own description of the card (its gpu/target_config)
H100 = """
gpu_device_info {
  threads_per_block_limit: 1024 threads_per_warp: 32 shared_memory_per_block: 49152
  shared_memory_per_core: 233472 threads_per_core_limit: 2048 core_count: 132 fpus_per_core: 128
  block_dim_limit_x: 2147483647 block_dim_limit_y: 65535 block_dim_limit_z: 65535
  memory_bandwidth: 3352320000000 l2_cache_size: 52428800 clock_rate_ghz: 1.98
  device_memory_size: 84942979072 shared_memory_per_block_optin: 232448
  cuda_compute_capability { major: 9 } registers_per_core_limit: 65536 registers_per_block_limit: 65536
}
platform_name: "CUDA" dnn_version_info { major: 9 minor: 8 } device_description_str: "NVIDIA H100 80GB HBM3"
"""
LAUNCHED = "fusion", "custom-call", "copy", "sort", "dynamic-slice", "dynamic-update-slice"


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--config", default="go1:best")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument("--list", action="store_true", help="name the kernels")
    args = parser.parse_args()
    config = config_lib.load(args.config)
    for text in args.set:
        config_lib.override(config, *text.split("=", 1))
    topology = topologies.get_topology_desc(
        "h100", platform="cuda", target_config=H100, topology="1x1x1"
    )
    place = jax.sharding.SingleDeviceSharding(topology.devices[0])
    for name, (function, given) in loops(config_lib.validate(config)).items():
        compiled = jax.jit(function, in_shardings=place, out_shardings=place).lower(*given)
        kernels = inside(compiled.compile().as_text())
        print(
            f"{name:24s} {len(kernels):3d} kernels",
            dict(collections.Counter(k[0] for k in kernels)),
        )
        for kind, label in kernels if args.list else ():
            print(f"    {kind:12s} {label}")


def loops(config) -> dict:
    """`name -> (function with one loop, its arguments' shapes)`."""
    static, hyper = config_lib.split(config)
    robot = robot_lib.load(config.robot)
    env = env_lib.make(robot, config.task, config.physics, impl="jax")
    horizon, robots = static.rollout.horizon, static.rollout.num_envs
    key, one = jax.eval_shape(lambda: jax.random.key(0)), jax.ShapeDtypeStruct((), jnp.int32)
    state = jax.eval_shape(partial(algorithm.init, env, static=static), hyper, key)
    rows = jax.eval_shape(lambda: rollout.allocate(env, horizon, robots))
    image = symmetry.policy_image(static, env)

    def tail(hyper, model, params, rows, n_real, key):
        start = dynamics.anchors(static, env, rows, n_real, key)
        keys = rollout.row_keys(key, jnp.arange(robots))
        act = algorithm.policy(static, env, params)
        step = fast.step(static, hyper, env, model)
        return fast.fill(rows, n_real, jnp.int32(horizon), start, keys, act=act, step=step)[0]

    def update(hyper, learner, rows, n_real, key):
        real = (jnp.arange(horizon) < n_real)[:, None]
        batch = algorithm.estimate(static, hyper, env, learner.params, rows, real)
        return fast.update(static, hyper, learner, batch, key, image)

    out = {"PPO, a minibatch": (update, (hyper, state.learner, rows, one, key))}
    if state.model is not None:
        params = state.learner.params
        out["the tail, a row"] = tail, (hyper, state.model, params, rows, one, key)

        def fit(hyper, model, rows, n_real, epochs, key):
            learned = examples.examples(static, hyper, env, rows, n_real)
            return fast.fit(static, hyper, model, learned, epochs, key)

        out["the fit, a minibatch"] = fit, (hyper, state.model, rows, one, one, key)
    return out


def inside(text: str) -> list[tuple[str, str]]:
    """`(kind, JAX's name)` of the kernels in the body of a compiled program's loop."""
    body = re.search(r"body=%?([\w.\-]+)", text)
    assert body, "no loop"
    lines = re.search(rf"^%?{re.escape(body[1])} \(.*?\{{\n(.*?)^\}}", text, re.M | re.S)
    assert lines, "no body"
    found = []
    for line in lines[1].splitlines():
        kind = re.match(r"\s*(?:ROOT )?%?[\w.\-]+ = (?:\(.*?\)|\S+) ([\w\-]+)\(", line)
        if kind and kind[1] in LAUNCHED:
            label = re.search(r'op_name="([^"]*)"', line)
            found.append((kind[1], label[1] if label else ""))
    return found


if __name__ == "__main__":
    main()
