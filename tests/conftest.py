"""What several test files need: small settings, values recorded from rsl_rl, checked shapes."""

import functools
import gc
import importlib.metadata
import inspect
import os
import pathlib
import runpy
import signal
import typing

import numpy as np
import pytest

# before JAX starts: eight devices for the tests of meshes, all else runs on the first; and three quarters
# of the time of these tests would be the optimisation of programs that run for a second. Tests of equal
# bits in different programs turn on what users have (`toy_runs.AS_USERS`). On a GPU all is as users have it
ON_GPU = os.environ.get("DYNAPPO_TEST_DEVICE") == "gpu"  # set by on_gpu.py
if not ON_GPU:
    flags = "--xla_force_host_platform_device_count=8 --xla_backend_optimization_level=0"
    flags += " --xla_cpu_parallel_codegen_split_count=1"
    # XLA ends the process, and pytest hides why, at a flag that it does not know: 0.11 has lost this one
    if tuple(map(int, importlib.metadata.version("jaxlib").split(".")[:2])) < (0, 11):
        flags += " --xla_cpu_use_fusion_emitters=false"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"
# where a program was traced is in its text, which takes a tenth of lowering it
os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
# tracing makes many objects and no garbage: collecting it as often as Python does is a third of the work
gc.set_threshold(50_000, 20, 100)
# a shell that starts these tests in the background has them ignore ctrl-C, and all that they start
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
TESTS = pathlib.Path(__file__).parent
PEERS = TESTS / "peers"
LONGEST = """
test_algorithm tasks/test_playground run/test_run tasks/test_env train/test_command run/test_checkpoint
learner/test_ppo program/test_distributed test_fast sweeps/test_sweep test_random_numbers
physics/test_kernel_scope physics/test_rough_ground test_seeds model/test_dynamics model/test_memory
web/test_task_page adopt/test_command physics/test_c_mujoco physics/test_warp_call sweeps/test_every_float
physics/test_xla_call program/test_build model/test_options terrain/test_rough_task policy/test_render
tasks/test_brax_env tasks/test_logged run/test_faults test_environment_page learner/test_symmetry
web/test_browser evaluate/test_command results/test_controls test_commands_in_pages results/test_paper
results/test_few description/test_feet config/test_stop
tasks/test_change test_scores learner/test_networks tasks/test_draws tasks/test_brax_named
""".split()  # files that take more than ten seconds of a processor, about in this order (README.md)


def pytest_sessionstart():
    """Where the GPU is to be tested, nothing passes on the CPU instead."""
    if not ON_GPU:
        return
    import jax
    import warp as wp

    if jax.default_backend() != "gpu" or not wp.get_preferred_device().is_cuda:
        raise pytest.UsageError(
            f"DYNAPPO_TEST_DEVICE is gpu, but JAX has {jax.devices()} and Warp "
            f"{wp.get_preferred_device()}; expected CUDA devices"
        )


def pytest_collection_modifyitems(items):
    """The files that take longest begin first, so that no core waits for one of them in the end."""
    place = {TESTS / f"{name}.py": i for i, name in enumerate(LONGEST)}
    assert all(path.is_file() for path in place), "LONGEST names a file that is gone"
    items.sort(key=lambda item: place.get(item.path, len(place)))  # else as they were


def pytest_collection_finish():
    """What importing left is never garbage."""
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def patience():
    """A test that interrupts a command in this process is not ended where the machine is busy."""
    from answers import PATIENCE

    from dynappo.config import stop

    stop.PATIENCE = PATIENCE


@pytest.fixture(scope="session", autouse=True)
def kept_programs(request):
    """Programs that are the same as in an earlier run are read, from .pytest_cache (README.md)."""
    if ON_GPU or not hasattr(request.config, "cache"):
        return
    import jax

    jax.config.update("jax_compilation_cache_dir", str(request.config.cache.mkdir("jax")))
    # small programs too: thousands of them, half of the seconds of each, and the other process reads them
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.fixture(scope="module", autouse=True)
def one_context():
    """MLIR's context is made once a file: of lowering a small program that is three quarters."""
    from jax._src.interpreters import mlir

    with pytest.MonkeyPatch.context() as patch:
        if hasattr(
            mlir, "make_ir_context"
        ):  # JAX's own affair: without it tests are slower, no more
            patch.setattr(mlir, "make_ir_context", functools.cache(mlir.make_ir_context))
        yield


@pytest.fixture(scope="session", autouse=True)
def compiled_once():
    """A config file, and default.py, which each of them runs, are compiled again only where they changed."""
    plain, made = runpy._get_code_from_file, {}  # type: ignore[attr-defined]

    def code(*args):
        found = os.stat(args[-1])
        of = (*args, found.st_mtime_ns, found.st_size, found.st_ino)
        if of not in made:
            made[of] = plain(*args)
        return made[of]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runpy, "_get_code_from_file", code)
        yield


@pytest.fixture(scope="session")
def settings():
    """`settings(fields, spec) -> (static, hyper)`: a valid config with `fields` set, split."""
    from toy_env import configure  # not above: it starts JAX

    from dynappo import config as config_lib

    return lambda fields=None, spec="configs/go1.py:dyna4": config_lib.split(
        configure(fields, spec)
    )


@pytest.fixture(scope="session")
def peer():
    """`peer(name) -> {name: array}`: what tests/peers/rsl_rl_reference.py recorded."""
    return functools.cache(lambda name: dict(np.load(PEERS / f"{name}.npz")))


@pytest.fixture(scope="session")
def from_torch():
    """`from_torch(z, prefix)`: parameters as `networks.init_policy`'s, of rsl_rl's weights."""

    def layer(z, name):
        return {"kernel": z[f"{name}.weight"].T, "bias": z[f"{name}.bias"]}

    def make(z, prefix=""):
        params = {"std": z[f"{prefix}std"]}
        for net in ("actor", "critic"):  # layers 1, 3, 5 are activations
            layers = {f"Dense_{i}": layer(z, f"{prefix}{net}.{2 * i}") for i in range(4)}
            params[net] = {"params": layers}
        return params

    return make


@pytest.fixture(scope="session")
def typed():
    """`typed(f)` is `f`, with its jaxtyping shape strings checked at every call."""
    from jaxtyping import AbstractArray, jaxtyped

    def check(where, hint, value):
        if typing.get_origin(hint) is tuple:
            for part, x in zip(typing.get_args(hint), value, strict=True):
                check(where, part, x)
        elif isinstance(hint, type) and issubclass(hint, AbstractArray):
            assert isinstance(value, hint), f"{where} has shape {value.shape}, expected {hint}"

    def wrap(function):
        hints, signature = typing.get_type_hints(function), inspect.signature(function)

        @jaxtyped(typechecker=None)
        def checked(*args, **kwargs):
            out = function(*args, **kwargs)
            values = signature.bind(*args, **kwargs).arguments | {"return": out}
            for name, value in values.items():
                check(f"{name} of {function.__name__}", hints.get(name), value)
            return out

        return checked

    return wrap
