"""From a config to a compiled program: what does not fit is refused before, nothing else is changed."""

import gc
import runpy
import threading

import jax
import numpy as np
import pytest
import workdirs
from answers import PATIENCE, refused
from toy_runs import assert_close, assert_same

from dynappo import config as config_lib
from dynappo import scores
from dynappo.config import ConfigError
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.program import build, memory


def first_chunk(program):
    """State and metrics after the first two iterations."""
    columns = {name: column[:2] for name, column in program.columns.items()}
    return program.step(program.hyper, program.state, columns)


def test_chunks_of_any_length_are_one_run_and_multiples_share_a_program(monkeypatch):
    """Two calls of two iterations, or four of one, are the same run, to the bit. Where `run.log_every` is
    another multiple of the same divisor, nothing else is compiled."""
    workdirs.toy(monkeypatch)
    monkeypatch.setattr(build, "TOGETHER", 2)
    lowered, compile_ = [], jax.stages.Lowered.compile

    def compiled(one, *options):
        lowered.append(one.as_text())
        return compile_(one, *options)

    def evaluate(env, hyper, params, key, **asked):
        judged.append((asked["num_envs"], asked["num_steps"]))
        return {"return": 0.0}

    judged = []
    monkeypatch.setattr(scores, "evaluate", evaluate)
    monkeypatch.setattr(jax.stages.Lowered, "compile", compiled)
    program = build.program(
        workdirs.config(run__log_every=2, run__checkpoint_every=4, run__eval_envs=8)
    )
    program.evaluate(program.state)
    assert judged == [(8, 20)]
    texts = lowered[:]
    single = build.program(
        workdirs.config(run__log_every=1, run__checkpoint_every=4, run__eval_envs=0)
    )
    assert not set(lowered[len(texts) :]) <= set(texts)
    whole, results = len(lowered), []
    for of, parts in ((program, (2, 2)), (program, (4,)), (single, (1, 3)), (single, (4,))):
        state, found, done = jax.tree.map(lambda x: x.copy(), program.state), [], 0
        for count in parts:
            columns = {n: column[done : done + count] for n, column in program.columns.items()}
            state, metrics = of.step(program.hyper, state, columns)
            assert {len(x) for x in metrics.values()} == {count}
            found, done = [*found, metrics], done + count
        results.append((state, {n: np.concatenate([m[n] for m in found]) for n in found[0]}))
    for other in results[1:]:
        assert_same(other, results[0])
    assert len(lowered) == whole  # nothing of ours was compiled for another length

    class Enough(Exception):
        """Both programs are lowered."""

    def noted(one, *options):
        lowered.append(one.as_text())
        raise Enough

    lowered.clear()
    monkeypatch.setattr(jax.stages.Lowered, "compile", noted)
    with pytest.raises(Enough):
        build.program(workdirs.config(run__log_every=4, run__checkpoint_every=4, run__eval_envs=0))
    assert set(lowered) <= set(texts) and lowered


@pytest.mark.parametrize("long", [False, True])
def test_the_evaluation_compiles_beside_the_run_or_where_captures_are_long_when_it_is_asked(
    long, monkeypatch
):
    """XLA, which times kernels, would end a capture."""
    workdirs.toy(monkeypatch)
    monkeypatch.setattr(scores, "evaluate", lambda *_, **__: {"return": 0.0})
    monkeypatch.setattr(build, "_captures_long", lambda *_: long)
    compile_, begun, handed_out = jax.stages.Lowered.compile, [], threading.Event()

    def compiled(lowered, *options):
        begun.append(lowered)
        if len(begun) > 2:  # after an iteration and the first state
            assert handed_out.wait(PATIENCE)
        return compile_(lowered, *options)

    monkeypatch.setattr(jax.stages.Lowered, "compile", compiled)
    program = build.program(workdirs.config(run__eval_envs=8))
    assert not program.ready()
    handed_out.set()
    assert program.evaluate(program.state) == {"return": 0.0}
    assert program.ready() is not long and len(begun) == (2 if long else 3)


@pytest.mark.parametrize(
    ("job", "impl", "long"),
    [
        ("go1:best", "warp", False),
        ("go1:best", "jax", False),
        ("g1:best", "warp", False),
        ("go1:best:physics.contacts=full", "warp", True),
        ("go1:best:physics.contacts=full", "jax", False),
        ("go2:rough", "warp", False),
        ("anymal_c:rough", "warp", False),
        ("go1:rough:physics.contacts=full", "warp", True),
    ],
)
def test_graphs_take_long_to_capture_where_no_kernel_of_ours_takes_the_robot(job, impl, long):
    name, variant, *fields = job.split(":")
    config = config_lib.load(f"configs/{name}.py:{variant}")
    for field in fields:
        config_lib.override(config, *field.split("="))
    config, robot = motors.fitted(config_lib.validate(config), robot_lib.load(config.robot))
    assert build._captures_long(config, robot, impl) is long


def test_what_another_environment_captures_is_long_where_it_names_warp():
    """Playground's do; of one's own the engine is not known."""
    assert build._captures_long(None, None, "warp")
    assert not build._captures_long(None, None, "own")


def size(tree):
    return sum(x.nbytes for x in jax.tree.leaves(tree))


@pytest.mark.slow
def test_a_mesh_of_devices_computes_what_one_does_and_changes_no_setting(monkeypatch):
    """Two seeds with their robots on two devices each; the partitioner is JAX's own again."""
    workdirs.toy(monkeypatch)
    names = "jax_platforms jax_use_shardy_partitioner jax_compilation_cache_dir".split()
    before, checked = [getattr(jax.config, name) for name in names], []
    monkeypatch.setattr(memory, "check_compiled", lambda *of: checked.append(of))
    plain = dict(schedule__end_steps=0, run__num_seeds=2, run__num_iterations=2)
    configs = workdirs.config(**plain), workdirs.config(**plain, run__mesh_seed=2, run__mesh_env=2)
    traced, compile_ = [], jax.stages.Lowered.compile
    waited = threading.Event()

    def compiled(lowered, *options):  # waits until `meanwhile` was called
        traced.append(lowered)
        assert waited.wait(PATIENCE)
        return compile_(lowered, *options)

    with monkeypatch.context() as patch:
        patch.setattr(jax.stages.Lowered, "compile", compiled)
        one = build.program(configs[0], meanwhile=waited.set)
    four = build.program(configs[1])
    assert len(traced) > 1  # the first state, an iteration; the evaluation follows by itself
    for config, program, devices, seen in zip(configs, (one, four), (1, 4), checked, strict=True):
        assert len(program.state.env_state.prop.sharding.device_set) == devices
        limit = memory.limit(jax.devices("cpu")[0])
        assert seen == (config, program.bytes_needed, limit)
        assert program.bytes_needed > size(program.state) / devices
    (state, metrics), (spread, same) = first_chunk(one), first_chunk(four)
    assert_close(metrics, same, 1e-3)
    np.testing.assert_allclose(state.env_state.prop, spread.env_state.prop, atol=1e-3)
    judged = four.evaluate(four.place(jax.device_get(spread)))
    assert judged["return"].shape == (2,) and isinstance(judged["return"], np.ndarray)
    assert [getattr(jax.config, name) for name in names] == before


def test_a_hopeless_size_is_refused_before_anything_is_compiled(monkeypatch):
    """In one line: a rollout that no compiler can make smaller."""
    monkeypatch.setattr(jax, "jit", lambda *_, **__: pytest.fail("compiled"))
    monkeypatch.setattr(memory, "limit", lambda device: 8 * 2**30)
    run = workdirs.config(rollout__num_envs=2**26)
    assert "the rollout alone needs" in refused(build.check, run)
    build.check(workdirs.config())


@pytest.mark.parametrize("robot", ["go1", "go2", "anymal_c", "anymal_d", "g1"])
def test_every_variant_of_every_robot_can_be_built(robot):
    """A range that does not fit one robot's body, for example, was found on the GPU."""
    variants = runpy.run_path("configs/default.py")["VARIANTS"]
    for variant in (*variants, *["ppo"] * (robot == "g1")):
        if robot == "g1" and variant.startswith("logs"):  # it has a gait clock, which no log tells
            with pytest.raises(ConfigError, match="without a gait clock"):
                config_lib.load(f"configs/{robot}.py:{variant}")
            continue
        build.check(config_lib.validate(config_lib.load(f"configs/{robot}.py:{variant}")))


def test_garbage_is_collected_after_a_build_also_after_one_that_failed(monkeypatch):
    seen = []

    def fails(config):
        seen.append(gc.isenabled())
        raise ConfigError("run.device is wrong")

    monkeypatch.setattr(build.devices, "engine", fails)
    refused(build.program, workdirs.config())
    assert seen == [False] and gc.isenabled()
    gc.disable()  # as the caller had it
    try:
        refused(build.program, workdirs.config())
        assert not gc.isenabled()
    finally:
        gc.enable()
