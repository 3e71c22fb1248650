"""Python functions in compiled CPU programs, and processes that run such programs: of C MuJoCo.

The processes are started as a user starts them, with one device and XLA's optimisation.
"""

import gc
import json
import os
import pathlib
import signal
import subprocess
import sys
import threading
import time
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from answers import PATIENCE, ROOT
from jax.sharding import PartitionSpec

from dynappo import config as config_lib
from dynappo import seeds
from dynappo.description import robot as robot_lib
from dynappo.physics import engine as engine_lib
from dynappo.physics import randomize, xla_call

HERE = pathlib.Path(__file__)
ROBOTS = 8
FOREVER = 10**9  # steps


def call(name, shapes, *arguments):
    """The function registered as `name`, as a compiled program."""
    shapes = [jax.ShapeDtypeStruct(shape, jnp.float32) for shape in shapes]
    return jax.jit(jax.ffi.ffi_call(name, shapes, vmap_method="broadcast_all"))(*arguments)


# --- a function ---


def sums(arguments, results):
    """The first result is the sum of the arguments' sums, the second the last argument doubled."""
    if any((x < 0).any() for x in arguments):
        raise ValueError("a number below zero: Größe")
    results[0][...] = sum(x.sum() for x in arguments)
    results[1][...] = 2 * arguments[-1]


@pytest.fixture(scope="module", autouse=True)
def registered():
    xla_call.register("test_sums", sums)
    xla_call.register("test_rows", lambda a, out: np.copyto(out[0], a[0].sum(-1)))


@pytest.mark.parametrize(
    "shapes", [[(2, 3), (4,)], [(5, 1, 2), (), (1,)], [(0, 5), (3,)], [(2, 0)]]
)
def test_a_function_computes_from_arrays_of_any_shapes(shapes):
    rng = np.random.default_rng(0)
    arguments = [rng.uniform(0, 1, shape).astype(np.float32) for shape in shapes]
    total, double = call("test_sums", [(), shapes[-1]], *arguments)
    np.testing.assert_allclose(total, sum(x.sum() for x in arguments), rtol=1e-6)
    np.testing.assert_array_equal(double, 2 * arguments[-1])
    (filled,) = call("test_rows", [(3, 4)], np.arange(24, dtype=np.float32).reshape(3, 4, 2))
    np.testing.assert_array_equal(filled, np.arange(24).reshape(3, 4, 2).sum(-1))


def test_in_a_loop_and_under_vmap_it_is_called_each_time_with_all_rows():
    def one(x):
        step = jax.ffi.ffi_call(
            "test_rows", jax.ShapeDtypeStruct((), jnp.float32), vmap_method="broadcast_all"
        )
        return jax.lax.scan(lambda x, _: (x + step(x), step(x)), x, None, length=4)

    x = np.random.default_rng(1).uniform(0, 1, (2, 3, 5)).astype(np.float32)
    end, told = jax.jit(jax.vmap(jax.vmap(one)))(x)
    for i in range(4):
        np.testing.assert_allclose(told[..., i], x.sum(-1), rtol=1e-5)
        x = x + x.sum(-1, keepdims=True)
    np.testing.assert_allclose(end, x, rtol=1e-5)


def test_an_exception_ends_the_program_with_its_text_and_the_process_lives_on():
    for _ in range(3):
        with pytest.raises(
            jax.errors.JaxRuntimeError, match="ValueError: a number below zero: Größe"
        ):
            jax.block_until_ready(call("test_sums", [(), (2,)], -np.ones(2, np.float32)))
        assert call("test_sums", [(), (2,)], np.ones(2, np.float32))[0] == 2


@pytest.mark.parametrize("dtype", [np.int32, np.float16, np.bool_])
def test_only_float32_is_taken(dtype):
    with pytest.raises(jax.errors.JaxRuntimeError, match="TypeError: .*expected float32"):
        jax.block_until_ready(call("test_sums", [(), (2,)], np.ones(2, dtype)))


def test_a_name_keeps_the_function_that_it_was_registered_with():
    xla_call.register("test_rows", lambda arguments, results: None)
    assert call("test_rows", [()], np.ones(3, np.float32))[0] == 3


# --- programs of C MuJoCo ---


def control_steps(steps, threads=2):
    """`many(qpos [R, 19], kp_scale [R])`: Go1s after so many control steps, standing."""
    config = config_lib.load("configs/go1.py")
    config.physics.threads = threads
    config = config_lib.validate(config)
    robot, hyper = robot_lib.load("go1"), config_lib.split(config)[1]
    engine = engine_lib.make(robot, config.physics, frozenset(), "c")
    com = jnp.asarray(robot.mj_model.body_ipos[robot.base_body], jnp.float32)

    def many(qpos, kp_scale):
        body = randomize.Body(jnp.ones(()), com, jnp.full((), 0.8), kp_scale, jnp.ones(()))
        none, clocks = jnp.zeros(18), jnp.zeros(4, jnp.int32)
        clocks = dict.fromkeys(("air_steps", "contact_steps", "last_air_steps"), clocks)
        peaks = dict.fromkeys(("peak", "last_peak"), jnp.zeros(4))
        state = dict(qpos=qpos, qvel=none, qacc_warmstart=none, **clocks, **peaks)

        def once(state, _):
            last = SimpleNamespace(**state)
            after = engine_lib.simulate(engine, hyper, body, last, jnp.zeros(12))
            return {name: getattr(after, name) for name in state}, None

        return jax.lax.scan(once, state, None, length=steps)[0]

    return jax.vmap(many)


def robots():
    """Arguments of `control_steps`."""
    rng, home = np.random.default_rng(0), robot_lib.load("go1").home_qpos
    qpos = np.tile(home, (ROBOTS, 1)) + np.r_[0, 0, 0.02, [0] * 16]
    qpos[:, 7:] += rng.normal(0, 0.1, (ROBOTS, 12))
    return qpos.astype(np.float32), rng.uniform(0.8, 1.2, ROBOTS).astype(np.float32)


def same(found, expected):
    """Equal bit by bit."""
    for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def test_two_programs_at_once_compute_what_each_does_alone():
    """Several engines and several programs of one engine, from Python threads; none waits for ever."""
    programs = [jax.jit(control_steps(*how)) for how in ((40, 2), (60, 2), (40, 1), (50, 3))]
    alone = [jax.device_get(program(*robots())) for program in programs]
    found: dict[int, list] = {}

    def work(i):
        found[i] = [jax.device_get(programs[i](*robots())) for _ in range(4)]

    threads = [threading.Thread(target=work, args=(i,), daemon=True) for i in range(len(programs))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE)
    assert len(found) == len(programs)
    for i, several in found.items():
        for one in several:
            same(one, alone[i])


@pytest.mark.skipif(jax.device_count() < 2, reason="one device")
def test_every_device_of_a_mesh_steps_its_own_robots():
    mesh, spec, many = seeds.mesh(1, 2), PartitionSpec("env"), control_steps(5)
    spread = jax.shard_map(many, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
    same(jax.jit(spread)(*robots()), jax.jit(many)(*robots()))


STATM = pathlib.Path("/proc/self/statm")


@pytest.mark.skipif(not STATM.exists(), reason="Linux only")
def test_calls_leave_no_memory_behind():
    """Nor do bodies that are not the same as in the last call."""
    step, (qpos, kp_scale), resident = jax.jit(control_steps(1)), robots(), []
    for calls in (100, 300):
        for i in range(calls):
            jax.block_until_ready(step(qpos, kp_scale + np.float32(i % 3)))
        gc.collect()  # conftest.py has made it rare
        pages = int(STATM.read_text().split()[1])
        resident.append(pages * os.sysconf("SC_PAGE_SIZE") / 2**20)
    assert resident[1] - resident[0] < 0.3  # MiB; measured 0.02


# --- processes ---


def main(steps, cores=0, more=0):
    """What a process below does: `steps` control steps, on the first `cores` of this machine; and as often
    again as `more` says, which it does not wait for."""
    hits = []
    jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))
    if cores:
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    lowered = jax.jit(control_steps(steps)).lower(*robots())
    hits.clear()
    many, cached = lowered.compile(), "/jax/compilation_cache/cache_hits" in hits
    print("begins", flush=True)
    after = many(*robots())
    print(json.dumps([cached, np.asarray(after["qpos"]).tolist()]))
    for _ in range(more):
        after = many(after["qpos"], robots()[1])


def start(*arguments, cache=""):
    """A process that runs `main(*arguments)`."""
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    environment |= {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}:{HERE.parent}", "JAX_PLATFORMS": "cpu"}
    if cache:
        limits = dict(MIN_COMPILE_TIME_SECS="0", MIN_ENTRY_SIZE_BYTES="-1")
        environment |= {f"JAX_PERSISTENT_CACHE_{name}": value for name, value in limits.items()}
        environment["JAX_COMPILATION_CACHE_DIR"] = str(cache)
    command = [sys.executable, "-c", f"import {HERE.stem} as test; test.main(*{arguments})"]
    pipes = dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    return subprocess.Popen(command, env=environment, start_new_session=True, **pipes)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="Linux only")
def test_it_runs_on_one_core_and_the_next_process_finds_the_program_in_the_cache(tmp_path):
    """With a pool of two threads, one of XLA's, and no second core: none waits for ever. A process that
    ends waits for its programs, as for any other of JAX; otherwise XLA calls into a Python that is gone."""
    seen = []
    for cores, more in ((1, 0), (0, 16)):
        process = start(50, cores, more, cache=tmp_path)
        output, errors = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, errors
        seen.append(json.loads(output.splitlines()[-1]))
        assert len(list(tmp_path.glob("jit_many-*-cache"))) == 1
    assert [cached for cached, _ in seen] == [False, True]
    assert seen[0][1] == seen[1][1]
    expected = jax.jit(control_steps(50))(*robots())["qpos"]  # without XLA's optimisation
    np.testing.assert_allclose(seen[0][1], expected, rtol=0, atol=1e-5)


def test_a_signal_ends_a_process_inside_a_program():
    """And nothing is left of it."""
    process = start(FOREVER)
    try:
        assert process.stdout.readline() == "begins\n", process.stderr.read()
        time.sleep(0.5)
        assert process.poll() is None
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=PATIENCE) == -signal.SIGTERM
        with pytest.raises(ProcessLookupError):  # of its group
            os.killpg(process.pid, 0)
    finally:
        process.kill()
