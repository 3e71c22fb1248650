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
from dynappo.tasks import by_name, names

TERM = "reward_"  # in front of a metric that is a term of the reward
# how numbers are printed, in this order
UNITS = {
    "return": "{:.2f}",
    "return_std": "{:.2f} between episodes",
    "length": "{:.0f} control steps",
    "fall_rate": "{:.3f} of the episodes",
    "tracking_error": "{:.3f} m/s",
    "yaw_error": "{:.3f} rad/s",
}


def check(policy: Other, flags) -> Any:
    """The config of the evaluation, validated; ConfigError for what cannot be done."""
    for name in ("record", "stress", "crossing", "fast", "randomize"):
        if getattr(flags, name):
            raise ConfigError(
                f"--{name}: the policy is of {policy.config.env}, which has its own episodes alone"
            )
    config = policy.config
    names.check(config.env)  # before anything is read or written
    config.run.update(device="auto", num_seeds=1, mesh_seed=1, mesh_env=1)
    config.physics.impl = "auto"  # it may have been trained on another machine
    config.run.update(eval_envs=flags.episodes or 0, eval_every=0)
    return config_lib.validate(config)


def run(policy: Other, config, flags, named: str, out: Path) -> None:
    """Print and write the numbers of the episodes."""
    import jax

    from dynappo import scores

    devices.own_process()
    build.check(config)
    number = flags.episodes or episodes.NUMBER.get(jax.default_backend(), episodes.NUMBER["cpu"])
    impl = devices.engine(config)
    length = config.run.eval_steps or config.task.episode_length
    print(f"dynappo evaluates {config.env}: {named}")
    for line in filter(None, [by_name.about(config)]):
        print(line)
    print(
        f"{number} episodes of {length} control steps; it compiles{a_while()}, and runs", flush=True
    )
    made = by_name.make(config, impl=impl, platform=jax.default_backend())
    env, impl = made.env, impl if made.engine == "own" else made.engine
    static, hyper = config_lib.split(config)
    terms = tuple(name for name in env.metrics if name.startswith(TERM))
    sizes = {"static": static, "num_envs": number, "num_steps": length, "totals": terms}
    assess = jax.jit(partial(scores.evaluate, env, **sizes))
    with made.evaluating:
        metrics = assess(hyper, policy.params, jax.random.key(flags.seed or 0))
    numbers = {n: float(x) if np.isfinite(x) else None for n, x in jax.device_get(metrics).items()}
    of_terms = {name.removeprefix(TERM): numbers.pop(f"total_{name}") for name in terms}
    for name, text in table(numbers, of_terms, env.dt):
        print(f"{name:24s} {text}")
    about = {"env": config.env, **episodes.measured(policy.params, named)}
    about |= {"episodes": number, "control_steps": length}
    about |= {"seed": flags.seed or 0, "device": jax.devices()[0].device_kind, "impl": impl}
    files.write_json(out / "evaluation.json", about | numbers | {"reward_terms": of_terms})
    print(f"written to {out}: evaluation.json")


def a_while() -> str:
    """How long it compiles, where that is long: C MuJoCo's physics are called from the task's own code."""
    import jax

    return ", up to a minute on a CPU" if jax.default_backend() == "cpu" else ""


def table(numbers: dict[str, float | None], terms: dict[str, float | None], dt: float):
    """The rows (name, value) to print."""
    named = [name for name in UNITS if name in numbers] + [n for n in numbers if n not in UNITS]

    def text(value, form):
        return "-" if value is None else form.format(value)

    rows = [(n.replace("_", " "), text(numbers[n], UNITS.get(n, "{:.4g}"))) for n in named]
    if any(terms.values()):
        rows.append(
            ("terms of the reward", "their sum over an episode, and times the control step:")
        )
    for name, total in sorted(terms.items(), key=lambda item: -(item[1] or 0.0)):
        step = None if total is None else dt * total
        rows.append((f"  {name}", f"{text(total, '{:10.2f}')} {text(step, '{:9.3f}')}"))
    return rows
