"""What a run needs of a device's memory, counted before anything is compiled.

The parts of an iteration follow each other in the same memory. The largest is what a robot costs,
beside the state that is carried:

    rollout      the buffer, and what JAX has of one physics step
    advantages   the buffer, the batch, and two layers of the critic on all rows
    update       the batch, its shuffled copy, and the activations of a minibatch
    fit          the buffer, its scaled rows, and the activations of a minibatch

Sizes follow from the config and the robot's model, without JAX. How many copies the compiler makes was
fitted to what XLA allots on a CPU, which is 0.86 to 1.04 of this over 17 configs of networks alone, and
0.96 for a whole Go1 with `dyna4` (tests/test_memory.py; for GPUs experiments/02_scaling/memory.py).
MuJoCo Warp has arrays of its own (warp_physics.py) in the quarter of a GPU that JAX leaves free, for
the robots that train and for those of an evaluation; its scratch there is not counted.
"""

from __future__ import annotations

import bisect
import math
import os
from typing import NamedTuple

from dynappo import contacts, observe, schedule
from dynappo import robot as robot_lib
from dynappo.config import ConfigError

FLOAT = 4  # bytes
PROP, OBS, ACTION = observe.PROP_SIZE, observe.PROP_SIZE + observe.CONTEXT_SIZE, 12
PRIVATE = 15  # env.private
STATE = 178 * FLOAT  # EnvState, and the robot's own physical parameters
STATES = 3  # before a chunk, after it, and the host's copy
BESIDE = 3  # JAX's share of a GPU, of what it leaves to Warp; a run may have set another one
FIXED = 300 << 20  # the program and its constants, workspaces of the libraries
# of a CPU's memory: Python, JAX, and the compiler while it compiles (a Go1 with dyna4: 1.45 GiB)
PROCESS = 1500 << 20
CURES = {
    "update": ", raise ppo.minibatches",
    "fit": ", raise model.minibatches",
    "evaluation": ", lower run.eval_envs",
    "engine": ", lower run.eval_envs",
}


class Estimate(NamedTuple):
    """Bytes; `estimate` makes it, `total` sums it up."""

    robot: int  # of each robot of each seed, while it trains
    judged: int  # of each robot of each seed, in an evaluation
    engine: int  # of each robot that trains or is judged: Warp's own arrays
    seed: int  # of each seed: networks, moments, gradients
    fixed: int
    largest: str  # the part of an iteration that decides `robot`


def estimate(config, impl: str = "auto") -> Estimate:
    """What a validated config needs; `impl` is the engine, "auto" counts as both."""
    parts = phases(config, impl)
    largest = max(parts, key=lambda name: parts[name])
    state = STATES * STATE
    networks = [(OBS, *config.ppo.hidden, ACTION), (OBS, *config.ppo.hidden, 1)]
    if schedule.uses_model(config):
        private = PRIVATE * config.model.private
        network = (OBS + private + ACTION, *config.model.hidden, PROP + private + 1)
        networks += config.model.ensemble * [network]
    weights = sum((a + 1) * b for sizes in networks for a, b in zip(sizes, sizes[1:], strict=False))
    return Estimate(
        robot=parts[largest] + state + STATES * past(config),
        judged=physics(config, impl) + state,
        engine=0 if impl == "jax" else beside(config),
        seed=6 * FLOAT * weights,  # with Adam's two moments, and as many again while they change
        fixed=FIXED,
        largest=largest,
    )


def phases(config, impl: str = "auto") -> dict[str, int]:
    """Bytes of one robot in each part of an iteration; the module says what they hold."""
    rows, ppo, model = config.rollout.horizon, config.ppo, config.model
    private = PRIVATE * model.private
    buffer = FLOAT * (2 * OBS + 2 * ACTION + 2 * (PROP + private) + 8)  # a row of types.Transition
    batch = FLOAT * (OBS + 2 * ACTION + 5)  # a row of ppo.Batch
    critic = FLOAT * (OBS + max(a + b for a, b in zip((0, *ppo.hidden), ppo.hidden, strict=False)))
    # before and after the activation, and its slope, of actor and critic
    width = 2 if ppo.precision == "bfloat16" else 4
    activations = 6 * width * sum(ppo.hidden)
    out = {
        "rollout": rows * buffer + physics(config, impl),
        "advantages": rows * (buffer + batch + critic),
        "update": rows * (2 * batch + activations // ppo.minibatches),
    }
    if schedule.uses_model(config):
        data = FLOAT * (OBS + ACTION + PROP + 2 * private + 2)  # a row of inputs, targets, weight
        width = 2 if model.precision == "bfloat16" else 3
        activations = model.ensemble * width * FLOAT * sum(model.hidden)
        activations = model.unroll * (activations + 2 * data + 2 * FLOAT * (PROP + 1))
        out["fit"] = rows * (buffer + data + activations // model.minibatches)
        if model.history:  # put together with this iteration's
            out["fit"] += rows * data + past(config)
    return out


def past(config) -> int:
    """Bytes of one robot in the rows of earlier iterations (model_rows.remember)."""
    if not schedule.uses_model(config):
        return 0
    kept = config.rollout.horizon - config.schedule.end_steps
    sizes = OBS + ACTION + PROP + 2 + 2 * PRIVATE * config.model.private + config.model.falls
    return FLOAT * config.model.history * kept * sizes


def physics(config, impl: str = "auto") -> int:
    """Bytes of one robot in a physics step that are JAX's: mjx.Data, or what MuJoCo Warp is called with."""
    model, touching, rows = _sizes(config, "jax")
    if impl == "warp":
        state = model.nq + 2 * model.nv + model.nu
        return FLOAT * (state + 7 * model.nbody + 15 * model.ngeom)
    # fields of one size for every quadruped, then those of each geom, contact and constraint row
    data = 10812 + 48 * model.ngeom + 128 * touching + (28 + FLOAT * model.nv) * rows
    return data + FLOAT * (model.nv + 2) * rows  # the solver holds the Jacobian once more


def beside(config) -> int:
    """Bytes of one robot in MuJoCo Warp's own arrays, with its share of the contact buffer."""
    model, touching, rows = _sizes(config, "warp")
    padded = math.ceil(rows / 16) * 16
    return 13900 + 48 * model.ngeom + 60 * rows + 88 * padded + 156 * touching


def _sizes(config, engine: str):
    """`(model, contacts, constraint rows)` that an engine keeps room for."""
    model = robot_lib.physics_model(robot_lib.load(config.robot), config.physics)
    return model, *contacts.most(model, engine)


def total(config, impl: str = "auto") -> int:
    """Bytes that a run needs on each device of its mesh."""
    return _total(config, estimate(config, impl), config.rollout.num_envs, config.run.num_seeds)


def _total(config, e: Estimate, robots: int, seeds: int) -> int:
    return max(_kinds(config, e, robots, seeds).values())


def _kinds(config, e: Estimate, robots: int, seeds: int) -> dict[str, int]:
    """What training and evaluation need of JAX's memory, and what it must be for Warp's to suffice."""
    run = config.run
    robots, judged = -(-robots // run.mesh_env), -(-run.eval_envs // run.mesh_env)
    seeds = seeds // run.mesh_seed
    kept = STATES * (STATE + past(config))
    sets = seeds + (seeds > 1)  # Warp also gets arrays for the robots of one seed
    return {
        "training": e.fixed + seeds * (e.seed + robots * e.robot),
        "evaluation": e.fixed + seeds * (e.seed + robots * kept + judged * e.judged),
        "engine": e.fixed + BESIDE * sets * (robots + judged) * e.engine,
    }


def fits(config, limit: int, impl: str = "auto") -> list[tuple[int, int]]:
    """`(robots, seeds)` that fit: the most robots with the config's seeds, the most seeds with its robots.

    Where neither is to be had, the most robots of the fewest seeds; empty if there are none. Only
    numbers that `validate` takes, which minibatches and mesh must divide.
    """
    e, robots, seeds = estimate(config, impl), config.rollout.num_envs, config.run.num_seeds
    ppo, by = config.ppo, config.run.mesh_seed
    step = ppo.shuffle_blocks * ppo.minibatches // math.gcd(ppo.minibatches, config.rollout.horizon)

    def most(needs):
        return bisect.bisect_right(range(1, 1 << 24), limit, key=needs)

    def robots_of(seeds):
        return step * most(lambda k: _total(config, e, step * k, seeds)), seeds

    seeds_of = robots, by * most(lambda k: _total(config, e, robots, by * k))
    found = [pair for pair in (robots_of(seeds), seeds_of) if min(pair)]
    return found or [pair for pair in (robots_of(by),) if min(pair)]


def check(config, limit: int | None, impl: str = "auto") -> None:
    """ConfigError if a run needs more than the `limit` bytes of a device, with what would fit."""
    needs = total(config, impl)
    if limit is None or needs <= limit:
        return
    pairs = [f"{robots} x {seeds}" for robots, seeds in fits(config, limit, impl)]
    most = f"at most {' or '.join(pairs)} fit" if pairs else "no number of robots fits"
    e = estimate(config, impl)
    kinds = _kinds(config, e, config.rollout.num_envs, config.run.num_seeds)
    largest = max(kinds, key=lambda name: kinds[name])
    cure = CURES.get(e.largest if largest == "training" else largest, "")
    raise ConfigError(
        f"rollout.num_envs x run.num_seeds is {config.rollout.num_envs} x {config.run.num_seeds} and "
        f"needs about {needs / 2**30:.1f} GiB on each device, which has {limit / 2**30:.1f}; {most}. "
        f"Lower one of them{cure}, or use more devices (run.mesh_seed, run.mesh_env)"
    )


def limit() -> int | None:
    """Bytes that JAX may use of one device; None where it does not say.

    On a GPU its own limit; on a CPU the machine's memory less `PROCESS`, in equal shares of the devices.
    """
    import jax

    device = jax.local_devices()[0]
    stats = device.memory_stats() or {}
    if "bytes_limit" in stats:
        return stats["bytes_limit"]
    if device.platform != "cpu" or "SC_PHYS_PAGES" not in os.sysconf_names:
        return None
    whole = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return max(0, whole - PROCESS) // jax.local_device_count()
