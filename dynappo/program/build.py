"""Turns a validated config into a compiled program: `program(config)`. `check(config)` finds mistakes before
that, in a second.

A `Program` has the robot, the environment, the first state, the one compiled call that a run repeats, and
the evaluation.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import gc
import math
import threading
import time
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.program import devices, distributed, memory

if TYPE_CHECKING:  # it imports JAX, and a mistake is answered without
    from dynappo.tasks import by_name
    from dynappo.types import Hyper, Static

TOGETHER = 10  # iterations, at most, in one call of the compiled program


class Program(NamedTuple):
    """A run that is compiled and ready to start."""

    robot: Any  # None for an environment of your own
    env: Any
    static: Static
    hyper: Hyper
    state: Any
    columns: dict[str, np.ndarray]  # [I]
    step: Callable  # (hyper, state, columns of one chunk) -> state, metrics
    evaluate: Callable  # (state) -> metrics of deterministic episodes
    evaluated_on: str  # the engine of these
    ready: Callable[[], bool]  # whether `evaluate` is compiled
    place: Callable  # (state) -> the state, placed on the devices as `step` expects
    impl: str
    device: str
    bytes_needed: int  # on each device, as the compiler counts
    compile_seconds: float


def check(config, env: Any = None) -> None:
    """ConfigError if the machine, the robot's file or `env` cannot run it; compiles nothing."""
    from dynappo.description import motors, robot
    from dynappo.physics import engine_contract, ground
    from dynappo.program import environment
    from dynappo.tasks import by_name, env_contract, of_robots

    if env is not None:
        devices.engine(config)
        return env_contract.check(env, config, schedule.uses_model(config))
    if config.env:
        impl = devices.engine(config)
        by_name.check(config)
        if config.ppo.symmetry:  # whether there is a mirror image, only the task that is made tells
            _named(config, impl)
        return
    environment.check_robot(config)
    impl = devices.engine(config)
    if impl == "warp":
        threading.Thread(target=_begin_warp, daemon=True).start()
    config, loaded = motors.fitted(config, robot.load(config.robot))
    of_robots.check(config, loaded)
    engine_contract.check(loaded, config.physics, impl, ground.under(config.task))
    memory.check(config, loaded, memory.limit(devices.local(config.run.device)))
    if config.run.logs:
        of_robots.about_log(config, loaded)


def engine_note(program: Program, config) -> str:
    """A line on a robot whose physics are slower or coarser on this engine, and why; or on where another
    package's environment comes from, or what is in a log; else ""."""
    from dynappo.physics import engine_contract, ground
    from dynappo.physics.warp import scope
    from dynappo.tasks import by_name, of_robots

    if config.env:
        return by_name.about(config)
    if config.run.logs:
        return of_robots.about_log(config, program.robot)
    if program.impl == "jax":
        return engine_contract.coarse(program.robot)
    if program.impl != "warp":
        return ""
    return scope.slower(program.robot, config.physics, ground.under(config.task))


def spawn_note(program: Program, config) -> str:
    """A line on a robot that is dropped from far above its default pose, or begins far below; else ""."""
    from dynappo.description import robot

    if not config.robot or config.run.logs:  # a log's robot begins where it was
        return ""
    return robot.spawn_note(program.robot, config.task.reset.spawn_height)


def _begin_warp() -> None:
    """Starting Warp takes 2 s, most of them outside of Python; meanwhile JAX traces."""
    import warp  # pyright: ignore[reportMissingImports]

    # else it prints its version, and each kernel that it loads
    warp.config.quiet = True  # pyright: ignore[reportAttributeAccessIssue]
    warp.init()


@contextlib.contextmanager
def _uncollected():
    """Without garbage collection: tracing makes objects but no garbage, and the search for garbage takes a
    quarter of its time (4.7 s of CPU time with it, 3.5 without, `best` on MJX-JAX)."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


@contextlib.contextmanager
def _compilers():
    """Threads that compile; an interruption does not wait for them."""
    pool = concurrent.futures.ThreadPoolExecutor(2)
    try:
        yield pool
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


@_uncollected()
def program(
    config,
    env: Any = None,
    each: tuple[Any, Any] | None = None,
    meanwhile: Callable[[], None] = lambda: None,
) -> Program:
    """Build robot, environment and first state, and compile the program that a run repeats.

    `env` is an environment of your own (a `types.Env`), with a config from `environment.config_for`.
    `each` is `(hyper, keys)` where the `run.num_seeds` seeds have values (`seeds.vary`) and keys of
    their own. `meanwhile()` is called when all is traced, while XLA compiles. ConfigError as `check`, and
    if the compiled program needs more memory than a device has.
    """
    import jax
    import jax.numpy as jnp
    from jax.sharding import NamedSharding, PartitionSpec

    impl = devices.engine(config)
    from dynappo import algorithm, scores, seeds
    from dynappo.tasks import env_contract, of_robots

    began = time.perf_counter()
    run = config.run
    mesh = seeds.mesh(run.mesh_seed, run.mesh_env, devices.available(run.device))
    config, robot, made, impl = _environment(config, env, impl)
    env, evaluated_on = made.env, impl
    static, hyper = config_lib.split(config)
    env = env._replace(mesh=mesh)
    source = of_robots.logged(config, robot, env) if run.logs else env  # of the rows
    length = run.eval_steps or config.task.episode_length
    key = jax.random.key(run.seed)
    init, step, episodes = algorithm.init, algorithm.run, scores.evaluate
    if run.num_seeds > 1:
        init, step, episodes = seeds.init, seeds.run, seeds.evaluate
        hyper, key = each or (hyper, seeds.keys(run.seed, run.num_seeds))
    init, step = partial(init, source, static=static), partial(step, source, static=static)
    episodes = partial(episodes, env, static=static, num_envs=run.eval_envs, num_steps=length)
    columns = schedule.columns(config)
    # a divisor of `log_every`: all multiples of 10 share a program
    together = math.gcd(run.log_every, TOGETHER)
    part = {name: column[:together] for name, column in columns.items()}
    everywhere = NamedSharding(mesh, PartitionSpec())
    shapes = jax.eval_shape(init, hyper, key)
    spread = seeds.shardings(mesh, shapes, run.num_seeds)
    shapes = jax.tree.map(_placed, shapes, spread)
    init = jax.jit(init, out_shardings=spread)
    step = jax.jit(step, donate_argnums=1, out_shardings=(spread, everywhere))
    episodes = jax.jit(episodes, out_shardings=everywhere)

    # Python traces one after the other, what compiles longest first; XLA compiles beside it
    repeated, once = _xla_options()
    with seeds.partitioner(mesh), _compilers() as pool:
        if robot is None:  # the first state of an environment of your own may be wrong
            starting = pool.submit(init.lower(hyper, key).compile, once)
            env_contract.check_start(starting.result()(hyper, key).env_state)
        stepping = pool.submit(step.lower(hyper, shapes, part).compile, repeated)
        if robot is not None:
            starting = pool.submit(init.lower(hyper, key).compile, once)
        # several devices or processes share settings and steps of a compilation: at the first call
        soon = run.eval_envs and mesh.size == 1 and jax.process_count() == 1
        soon = soon and not _captures_long(config, robot, impl)
        if soon:
            evaluated_on = made.engine
            with made.evaluating:
                lowered = episodes.lower(hyper, shapes.learner.params, jax.random.key(0))
        meanwhile()
        # the state last: XLA times kernels while it compiles, on a GPU with nothing else to do
        compiled = stepping.result()
        state = starting.result()(hyper, key)
        if robot is not None:
            of_robots.check_start(config, robot, state.env_state)
        evaluating = None
        if soon:  # while the run trains
            later = concurrent.futures.ThreadPoolExecutor(1)
            evaluating = later.submit(lowered.compile, repeated)
            later.shutdown(wait=False)
    size = memory.needed(compiled)
    memory.check_compiled(config, size, memory.limit(mesh.local_devices[0]))
    distributed.barrier()
    if impl == "warp":  # what is left to load is loaded at the first call
        from dynappo.physics.warp import building

        building.wait()
        single = {name: np.minimum(column, 1) for name, column in part.items()}
        jax.block_until_ready(compiled(hyper, jax.tree.map(jnp.copy, state), single))

    return Program(
        robot=robot,
        env=env,
        static=static,
        hyper=hyper,
        state=state,
        columns=columns,
        step=partial(_step, compiled, together),
        evaluate=partial(_evaluate, mesh, hyper, episodes, evaluating),
        evaluated_on=evaluated_on,
        ready=lambda: evaluating is not None and evaluating.done(),
        place=partial(jax.device_put, device=spread),
        impl=impl,
        device=devices.local(run.device).device_kind,
        bytes_needed=size,
        compile_seconds=time.perf_counter() - began,
    )


def _captures_long(config, robot, impl: str) -> bool:
    """Whether XLA must not compile beside training: the evaluation is then compiled when it is first asked.

    XLA times kernels while it compiles for a GPU. If it waits for the whole device, CUDA ends the capture of
    a graph that is under way (error 901). A kernel of ours is captured in 0.01 s, and has never met that;
    MuJoCo Warp's step takes 0.07 (experiments/03_speed). Three of six runs with it ended so, three at a time
    on an H200 with nothing in a cache, and none of three since (experiments/21_less/results/captures.csv.xz);
    that this is why is likely, not shown. An environment of one's own may step MuJoCo Warp, too, which is not
    known here.
    """
    from dynappo.physics import ground
    from dynappo.physics.warp import scope

    if impl != "warp":
        return False
    return robot is None or bool(scope.slower(robot, config.physics, ground.under(config.task)))


def _step(compiled: Callable, together: int, hyper: Hyper, state, columns: dict[str, np.ndarray]):
    """`(state, metrics)` after a chunk: calls of `together` iterations, queued one after the other.

    How many is known when the program is compiled. A loop whose length is an argument would serve every
    `run.log_every`, but the host waits for each of its rounds (`ppo16` on an H200: 10 % longer). Calls of a
    single iteration cost 3 ms of Python each (experiments/03_speed).
    """
    import jax
    import jax.numpy as jnp

    parts = []
    for begin in range(0, len(columns["iteration"]), together):
        rows = {name: column[begin : begin + together] for name, column in columns.items()}
        state, metrics = compiled(hyper, state, rows)
        parts.append(metrics)
    return state, parts[0] if len(parts) == 1 else jax.tree.map(lambda *x: jnp.concat(x), *parts)


def _xla_options() -> tuple[Any, Any]:
    """XLA's options for programs that repeat, and for those that run once.

    On a GPU XLA compiles on all cores (19.5 instead of 22.4 s of a start). On a CPU it does not optimise the
    first state, which takes 10 ms instead of 3, but 2.5 s of CPU time to compile instead of 6.3.
    """
    import jax

    from dynappo.physics.cores import cores

    if jax.default_backend() == "gpu":
        at_once = {"xla_gpu_force_compilation_parallelism": cores()}
        return at_once, at_once
    return {}, {"xla_backend_optimization_level": 0}


def _placed(array, sharding):
    import jax

    return jax.ShapeDtypeStruct(array.shape, array.dtype, sharding=sharding)


def _evaluate(mesh, hyper: Hyper, episodes: Callable, compiled, state):
    """Metrics of deterministic episodes; the first call waits for the compilation, or compiles."""
    import jax

    from dynappo import seeds

    with seeds.partitioner(mesh):
        run = compiled.result() if compiled else episodes
        return jax.device_get(run(hyper, state.learner.params, jax.random.key(0)))


def floats(configs: list, env: Any = None) -> list[Hyper]:
    """The `hyper` of each config, all of one robot or of another environment."""
    from dynappo.config import per_joint
    from dynappo.description import robot

    if env is None and configs[0].robot:
        of = robot.load(configs[0].robot)
        configs = [per_joint.resolved(one, of.joint_names, of.name) for one in configs]
    return [config_lib.split(one)[1] for one in configs]


def _environment(config, env: Any, impl: str) -> tuple[Any, Any, by_name.Made, str]:
    """`(config, robot, environment, engine)`: the task of the config's robot, or the user's `env`."""
    import jax

    from dynappo.description import motors
    from dynappo.description import robot as robot_lib
    from dynappo.program import environment
    from dynappo.tasks import by_name, of_robots

    if env is not None:
        return config, None, by_name.Made(env), "own"
    if config.env:
        made = _named(config, impl)
        return config, None, made, "own" if made.engine == "own" else impl
    environment.check_robot(config)
    config, robot = motors.fitted(config, robot_lib.load(config.robot))
    with jax.default_device(devices.local(config.run.device)):
        env = of_robots.make(config, robot, impl=impl)
    return config, robot, by_name.Made(env, engine=impl), impl


def _named(config, impl: str) -> by_name.Made:
    """The environment of another package, made on the device of the run."""
    import jax

    from dynappo.tasks import by_name

    device = devices.local(config.run.device)
    with jax.default_device(device):
        return by_name.make(config, impl=impl, platform=device.platform)
