"""Evaluates a policy of another package's environment (`config.env`): episodes of that, by `scores.py`.

There is no grid of commands in C MuJoCo, as robots have it: what such a task asks is its own.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError, files
from dynappo.evaluate import episodes
from dynappo.policy.policy_file import Other
from dynappo.program import build, devices
from dynappo.tasks import by_name


def check(policy: Other, flags) -> Any:
    """The config of the evaluation, validated; ConfigError for what cannot be done."""
    for name in ("fast", "stress", "randomize"):
        if getattr(flags, name):
            raise ConfigError(
                f"--{name}: the policy is of {policy.config.env}, which has its own episodes alone"
            )
    config = policy.config
    config.run.update(device="auto", num_seeds=1, mesh_seed=1, mesh_env=1)
    config.run.eval_envs = flags.episodes or 0
    return config_lib.validate(config)


def run(policy: Other, config, flags, named: str, out: Path) -> None:
    """Print and write the numbers of the episodes."""
    import jax

    from dynappo import scores

    devices.own_process()
    build.check(config)
    number = flags.episodes or episodes.NUMBER.get(jax.default_backend(), episodes.NUMBER["cpu"])
    impl = devices.engine(config)
    print(f"dynappo evaluates {config.env}: {named}")
    for line in filter(None, [by_name.about(config)]):
        print(line)
    length = config.run.eval_steps or config.task.episode_length
    print(f"{number} episodes of {length} control steps; it compiles and runs", flush=True)
    env = by_name.make(config, impl=impl)
    static, hyper = config_lib.split(config)
    assess = partial(scores.evaluate, env, static=static, num_envs=number, num_steps=length)
    metrics = jax.device_get(jax.jit(assess)(hyper, policy.params, jax.random.key(flags.seed or 0)))
    numbers = {name: float(x) if np.isfinite(x) else None for name, x in metrics.items()}
    for name, value in numbers.items():
        print(f"{name:18s} {'-' if value is None else f'{value:.4g}'}")
    about = {"env": config.env, "policy": named, "episodes": number, "control_steps": length}
    about |= {"seed": flags.seed or 0, "device": jax.devices()[0].device_kind, "impl": impl}
    files.write_json(out / "evaluation.json", about | numbers)
    print(f"written to {out}: evaluation.json")
