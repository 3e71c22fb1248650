"""Which tiles of a rough ground a policy crosses: by kind and by row, on tiles that it was not trained on.

A robot begins in the middle of a tile, anywhere in the whole grid, turned anyhow, and is told to walk
`SPEED` ahead, where it looks. It crosses its tile
if it leaves it, farther from the middle than half of its side, within `SECONDS` and without a fall, and no
more than `ASIDE` beside the way that it was told. No noise, nominal bodies, the policy's mean action. The
ground is that of the policy's config with another seed; of a policy that was trained on a map, that map.

JAX is imported only when it runs.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from ml_collections import config_dict

from dynappo import config as config_lib
from dynappo.config import terms
from dynappo.description import motors
from dynappo.description.robot import Robot
from dynappo.evaluate import episodes
from dynappo.physics import engine_contract
from dynappo.policy import policy_source
from dynappo.policy.policy_file import Policy
from dynappo.program import devices
from dynappo.terrain import tiles as tiles_lib

NUMBER = {"gpu": 1000, "cpu": 100}
SECONDS, SPEED, ASIDE = 20.0, 0.8, 45.0  # s, m/s, degrees
OTHER_GROUND = 1000  # added to `task.tiles.seed`


def run(
    policy: Policy, number: int | None = None, seed: int = 0, robot: Robot | None = None
) -> dict[str, Any]:
    """Tries and crossings on this machine's device: `all`, by `kinds`, and by `rows` of each kind.

    Without a number: 1000 tries on a GPU, 100 on a CPU, in C MuJoCo. `robot`: None for the policy's own.
    """
    return prepared(policy, number, robot)(policy, seed)


def prepared(
    policy: Policy, number: int | None = None, robot: Robot | None = None
) -> Callable[[Policy, int], dict[str, Any]]:
    """`(policy, seed) -> numbers` as `run`, for all policies of this one's config: compiled once."""
    import jax

    from dynappo.tasks.velocity import env as env_lib

    config = on_other_ground(episodes.settings(policy))
    number = number or NUMBER.get(jax.default_backend(), NUMBER["cpu"])
    robot = robot or policy_source.robot(policy)[0]
    in_c = jax.default_backend() == "cpu" and not engine_contract.lacks(robot, config.physics, "c")
    impl = "c" if in_c else devices.engine(config)
    config, robot = motors.fitted(config, episodes.driven(policy, robot))
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot, config.task, config.physics, impl=impl)
    measure = jax.jit(
        partial(tries, env, static=static, num_envs=number, num_steps=config.task.episode_length)
    )

    def measured(policy: Policy, seed: int) -> dict[str, Any]:
        params = {"std": np.ones(len(policy.joint_names), np.float32)} | policy.params
        found = jax.device_get(measure(hyper, params, jax.random.key(seed)))
        return {
            "tries": number,
            "seconds": SECONDS,
            "speed": SPEED,
            "seed": seed,
            "tiles_seed": config.task.tiles.seed,
            "stairs": tuple(config.task.tiles.stairs),
            "device": jax.devices()[0].device_kind,
            "impl": impl,
        } | counted(config.task.tiles, found)

    return measured


def on_other_ground(config):
    """The config of these tries: other tiles, every row, one command."""
    config = config_dict.ConfigDict(config)
    terms.without_command(config)
    task, tiles = config.task, config.task.tiles
    tiles.update(seed=tiles.seed + OTHER_GROUND, start_rows=tiles.rows)
    steps = round(SECONDS / (config.physics.substeps * config.physics.timestep))
    task.terrain = "rough"
    task.update(episode_length=steps, carry_on=False, random_clock=False, resample_steps=0)
    task.update(command_x=(SPEED, SPEED), command_y=(0.0, 0.0), standing=0.0, slow_commands=None)
    if not task.heading:
        task.command_yaw = (0.0, 0.0)
    return config_lib.validate(config, robot_here=False)


def tries(
    env, hyper, params: dict, key, *, static, num_envs: int, num_steps: int
) -> dict[str, Any]:
    """Of each try [num_envs]: its `row` and `column`, and whether it `crossed` its tile, and `fell`.

    A robot whose try has ended stays as it is.
    """
    import jax
    import jax.numpy as jnp

    from dynappo import scores
    from dynappo.tasks.velocity import observe

    hyper = scores.nominal(hyper)
    body_keys, reset_keys, keys = (jax.random.split(k, num_envs) for k in jax.random.split(key, 3))
    bodies = jax.vmap(env.randomize, (None, 0))(hyper, body_keys)
    start = jax.vmap(env.reset, (None, 0, 0))(hyper, bodies, reset_keys)
    told = jax.vmap(observe.heading)(start.qpos[:, 3:7])
    if static.task.heading:
        # a heading drawn at random may be behind: a robot that turns while it walks leaves beside its way.
        # Its first observation, one row, still has the old one
        start = start.replace(goal=start.goal.replace(heading=told))
    act = scores.mean_actions(env, static, params)

    def step(carry, t):
        state, alive, crossed, fell = carry
        step_keys = jax.vmap(jax.random.fold_in, (0, None))(keys, t)
        action = act(state)
        after, outcome = jax.vmap(env.step, (None, 0, 0, 0, 0))(
            hyper, bodies, state, action, step_keys
        )

        def keep(new, old):
            return jnp.where(alive.reshape(-1, *[1] * (new.ndim - 1)) > 0, new, old)

        crossed += alive * outcome.metrics["crossings"]
        fell += alive * (1 - outcome.discount)
        still = alive * outcome.discount * (1 - outcome.truncation)
        return (jax.tree.map(keep, after, state), still, crossed, fell), None

    zero = jnp.zeros(num_envs)
    carry = start, zero + 1, zero, zero
    (end, _, crossed, fell), _ = jax.lax.scan(step, carry, jnp.arange(num_steps))
    way = end.qpos[:, :2] - start.qpos[:, :2]
    off = jnp.arctan2(way[:, 1], way[:, 0]) - told
    aside = jnp.abs((off + jnp.pi) % (2 * jnp.pi) - jnp.pi)
    crossed = crossed * (aside <= jnp.radians(ASIDE))
    return dict(row=start.tile.row, column=start.tile.column, crossed=crossed, fell=fell)


def counted(tiles, found: dict[str, np.ndarray]) -> dict[str, Any]:
    """`all`, `kinds` and, of each kind, `rows`: how many tries, crossings and falls. On a map of one's own
    the only kind is `map`."""
    kinds = np.zeros_like(found["column"]) if tiles.map else tiles_lib.kinds(tiles)[found["column"]]

    def of(which) -> dict[str, int]:
        sums = {name: int(found[name][which].sum()) for name in ("crossed", "fell")}
        return {"tries": int(which.sum())} | sums

    out: dict[str, Any] = {"all": of(kinds >= 0), "kinds": {}, "rows": {}}
    for kind, name in enumerate(["map"] if tiles.map else tiles_lib.KINDS):
        here = kinds == kind
        if here.any():
            out["kinds"][name] = of(here)
            rows = [of(here & (found["row"] == row)) for row in range(tiles.rows)]
            out["rows"][name] = rows
    return out
