"""How many rows of each iteration the transition model writes: the paper's equation 5.

    N_s(i) = min(max(x + (i - a) / (b - a) * (y - x), x), y),    i = 1 ... I

with a, b = `schedule.start_iteration, end_iteration` and x, y = `start_steps, end_steps`.

After `last_iteration` all rows are real: physics alone improves a policy that walks already.

Why floor(. + 0.5) and i from 1: only this rounding gives the 19.64 M simulator steps of the paper's
Table VI for its scheduled tail (floor gives 19.83 M, ceil 19.44 M, counting from 0 19.65 M).
For a = b the equation is 0 / 0; the paper means y in every iteration (`dyna2`).
"""

import numpy as np


def table(config) -> np.ndarray:
    """N_s of every iteration, int32 `[I]`; `config` is a whole config (groups schedule, run)."""
    s = config.schedule
    i = np.arange(1, config.run.num_iterations + 1)
    steps = np.full(len(i), float(s.end_steps))
    if s.start_iteration != s.end_iteration:
        # multiply before dividing: an exact half then stays a half, and rounds up
        rise = (i - s.start_iteration) * (s.end_steps - s.start_steps)
        steps = s.start_steps + rise / (s.end_iteration - s.start_iteration)
    steps = np.floor(np.clip(steps, s.start_steps, s.end_steps) + 0.5)
    return np.where(_over(config, i), 0, steps).astype(np.int32)


def late(config, iteration):
    """Whether an iteration comes after `schedule.late_from`."""
    after = config.schedule.late_from
    return iteration < 0 if after is None else iteration > after


def _over(config, iteration):
    """Whether an iteration comes after the last one with a tail."""
    last = config.schedule.last_iteration
    return False if last is None else iteration > last


def uses_model(config) -> bool:
    """Whether the schedule has a tail; if not, the compiled program contains no model."""
    s = config.schedule
    return max(s.start_steps, s.end_steps) > 0 and s.last_iteration != 0


def columns(config) -> dict[str, np.ndarray]:
    """What `algorithm.run` scans over, each int32 `[I]`: `iteration`, from 1, and `n_real`, N_r;
    with a tail `model_epochs`, the passes of the model's fit; with several rounds `rounds`; with a memory
    `memory_begin`, the place of the first new row in the ring, and `memory_count`, the rows that it then
    holds."""
    i = np.arange(1, config.run.num_iterations + 1, dtype=np.int32)
    tail = table(config)
    out = {"iteration": i, "n_real": np.int32(config.rollout.horizon) - tail}
    if uses_model(config):
        m = config.model
        fewer = m.epochs if m.late_epochs is None else m.late_epochs
        epochs = np.where(i > m.late_from, fewer, m.epochs)
        out["model_epochs"] = np.where(_over(config, i), 0, epochs).astype(np.int32)
        if config.schedule.rounds > 1:  # one where there is no tail
            out["rounds"] = np.where(tail > 0, config.schedule.rounds, 1).astype(np.int32)
        if m.memory:
            after = np.cumsum(out["n_real"], dtype=np.int64)
            out["memory_begin"] = ((after - out["n_real"]) % m.memory).astype(np.int32)
            out["memory_count"] = np.minimum(after, m.memory).astype(np.int32)
    return out


def sim_steps(config) -> np.ndarray:
    """Simulator (control) steps of one seed up to and including each iteration, int64 `[I]`."""
    return np.cumsum(columns(config)["n_real"].astype(np.int64)) * config.rollout.num_envs
