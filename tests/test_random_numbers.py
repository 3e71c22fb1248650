"""No key is used twice: those of a run with every option on, as `random_keys.py` records them."""

import collections
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pytest
import random_keys
from toy_env import configure

from dynappo import algorithm, schedule, scores
from dynappo import config as config_lib
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib

ROBOTS, REAL, TAIL, ROUNDS, ITERATIONS, STEPS = 4, 2, 2, 2, 2, 2
DRAWN, SPLIT, FOLDED = random_keys.RANDOM.values()
# `deploy` varies every body, has pushes, noise, an onboard observation, a clean model with falls, symmetry;
# this adds the rest of what draws, but carry_on, which is of flat ground alone, and makes it small
EVERYTHING = {
    "rollout.num_envs": ROBOTS,
    "rollout.horizon": REAL + TAIL,
    "run.num_iterations": ITERATIONS,
    "run.log_every": ITERATIONS,
    "schedule.end_iteration": 0,
    "schedule.start_steps": TAIL,
    "schedule.end_steps": TAIL,
    "schedule.rounds": ROUNDS,
    "schedule.last_iteration": None,
    "model.hidden": (8, 8),
    "model.epochs": 2,
    "model.late_epochs": None,
    "model.minibatches": 2,
    "ppo.hidden": (8, 8),
    "ppo.minibatches": 2,
    "ppo.shuffle_blocks": 4,
    "task.formulation": "isaaclab_exact",
    "task.heading": True,
    "task.terrain": "rough",
    "task.carry_on": False,
    "task.scan": "grid",
    "task.tiles.rows": 2,
    "task.tiles.columns": 6,
    "task.resample_steps": 5,
    "task.standing": 0.3,
    "task.slow_commands": 0.4,
    "task.history": 3,
    "task.random_clock": True,
    "task.reset.velocity": 0.5,
    "task.reset.joint_scale": (0.9, 1.1),
    "physics.contacts": "full",
    "physics.impl": "c",
    "physics.threads": 1,
}
FLAT = {"task.terrain": "flat", "task.scan": "none", "task.carry_on": True}
# robots and settings with which a function takes another way to its draws
OTHERS = {
    "all": ("go1", {}),
    "one command and no clock": ("go1", {"task.resample_steps": 0, "task.random_clock": False}),
    "a biped with a gait clock": ("g1", {"task.gait_frequency": (1.25, 1.5)}),
    "that on flat ground": ("g1", FLAT | {"task.gait_frequency": (1.25, 1.5)}),
    "flat ground": ("go1", FLAT),
}
# more imagined robots than real ones, whose tails begin in a memory and under new commands
FEW = {
    "task.formulation": "isaaclab",
    "task.heading": False,
    **FLAT,
    "rollout.imagined": 2,
    "model.memory": 8,
    "model.remembered": 2,
    "model.symmetry": True,
    "schedule.anchors": 8,
    "schedule.new_commands": True,
}


def built(name, fields):
    """Settings and environment of the `deploy` of a robot with `EVERYTHING` and `fields`."""
    config = configure(EVERYTHING | fields, f"configs/{name}.py:deploy")
    config, robot = motors.fitted(config, robot_lib.load(config.robot))
    static, hyper = config_lib.split(config)
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    return SimpleNamespace(config=config, static=static, hyper=hyper, env=env)


@pytest.fixture(scope="module")
def every():
    return built("go1", {})


@pytest.fixture(scope="module")
def uses(every):
    """`{name: uses}` of a run's calls, each with the key that `train --config.run.seed=0` gives it."""
    static, env, hyper = every.static, every.env, every.hyper
    init = partial(algorithm.init, env, static=static)
    run = partial(algorithm.run, env, static=static)
    episodes = dict(static=static, num_envs=ROBOTS, num_steps=STEPS, randomize=True)
    columns = {name: jnp.asarray(column) for name, column in schedule.columns(every.config).items()}
    first, state = random_keys.record(init, hyper, jax.random.key(0))
    two, (after, _) = random_keys.record(run, hyper, state, columns)
    evaluate = partial(scores.evaluate, env, **episodes)
    shown, _ = random_keys.record(evaluate, hyper, after.learner.params, jax.random.key(0))
    return {"init": first, "run": two, "evaluate": shown}


def test_a_run_with_every_option_uses_no_key_twice(uses):
    for name, used in uses.items():
        assert not random_keys.faults(used), f"in {name}:\n" + "\n".join(random_keys.faults(used))


def test_a_run_and_the_evaluation_of_the_same_seed_share_no_key(uses):
    """Both get `jax.random.key(0)`."""
    faults = random_keys.faults([use for used in uses.values() for use in used])
    assert not faults, "\n".join(faults)


def test_a_run_has_as_many_draws_as_its_rows_robots_and_rounds_need(uses):
    """So the recorder sees them all: draws of each file of dynappo, from keys that all differ."""

    def draws(name):
        files = [use.where.split(" > ")[-1].split(":")[0] for use in uses[name] if use.how == DRAWN]
        return dict(collections.Counter(files))

    # a body; a tile, a pose and the two draws of a clock; command, and whether it is slow; noise, also of
    # the scan
    start = dict.fromkeys(("randomize.py", "view.py", "surroundings.py"), 1)
    start = collections.Counter(start | {"env.py": 4, "commands.py": 2})
    # a step's command, push, noise; a reset's tile and pose, command, noise
    row = dict.fromkeys(("view.py", "surroundings.py"), 2)
    row = collections.Counter(row | {"env.py": 2, "pushes.py": 1, "commands.py": 4})
    assert draws("init") == times(ROBOTS, start) | {"networks.py": 3}  # actor, critic, model
    assert draws("evaluate") == times(ROBOTS, start + times(STEPS, row))
    made = ROUNDS * TAIL
    expected = times(ROBOTS * REAL, row)
    expected["view.py"] += ROBOTS * made  # noise on what the model predicts
    expected["surroundings.py"] += ROBOTS * made  # and on the scan, which it does not
    expected["algorithm.py"] = ROBOTS * (REAL + made)  # actions
    # an epoch's order, and two for where the robots start in it; two for the anchors of a round
    expected["dynamics.py"] = 3 * EVERYTHING["model.epochs"] + 2 * ROUNDS
    expected["ppo.py"] = (
        ROUNDS * EVERYTHING["ppo.shuffle_blocks"]
    )  # of so few rows, each shuffle is one
    assert draws("run") == times(ITERATIONS, expected)


def test_a_run_with_a_memory_uses_no_key_twice():
    """Nor do two imagined robots of a real one share a key."""
    world = built("go1", FEW)
    columns = {name: jnp.asarray(column) for name, column in schedule.columns(world.config).items()}
    init = partial(algorithm.init, world.env, static=world.static)
    state = jax.eval_shape(init, world.hyper, jax.random.key(0))
    state = state.replace(key=jax.random.key(0), robot_index=jnp.arange(ROBOTS))
    run = partial(algorithm.run, world.env, static=world.static)
    used, _ = random_keys.record(run, world.hyper, state, columns)
    assert not random_keys.faults(used), "\n".join(random_keys.faults(used))
    drawn = [use.where for use in used if use.how == DRAWN]
    actions = [where for where in drawn if where.split(" > ")[-1].startswith("algorithm.py")]
    assert len(actions) == ITERATIONS * ROBOTS * (REAL + 2 * ROUNDS * TAIL)
    commands = [where for where in drawn if "memory.py" in where and "commands.py" in where]
    assert (
        len(commands) == ITERATIONS * ROUNDS * 2 * ROBOTS * 2
    )  # a command, and whether it is slow


def times(n, counts):
    return collections.Counter({name: n * count for name, count in counts.items()})


@pytest.mark.parametrize(("name", "fields"), OTHERS.values(), ids=OTHERS)
def test_one_reset_step_and_autoreset_use_no_key_twice(name, fields, every):
    world = built(name, fields) if fields else every
    env, hyper, key = world.env, world.hyper, jax.random.key(3)
    body = jax.eval_shape(env.randomize, hyper, key)
    state = jax.eval_shape(env.reset, hyper, body, key)
    action = jax.ShapeDtypeStruct((env.action_size,), jnp.float32)
    after = jax.eval_shape(env.step, hyper, body, state, action, key)
    parts = state.prop, jax.ShapeDtypeStruct((env.obs_size - env.prop_size,), jnp.float32)
    calls = {
        "randomize": (env.randomize, hyper, key),
        "reset": (env.reset, hyper, body, key),
        "step": (env.step, hyper, body, state, action, key),
        "autoreset": (env.autoreset, hyper, body, *after, key),
        "sense": (env.sense, hyper, *parts, key),
    }
    for called, call in calls.items():
        used, _ = random_keys.record(*call)
        assert used and not random_keys.faults(used), f"{called}: {random_keys.faults(used)}"


# --- the recorder itself ---


def branchy(key, x):
    """Draws in a scan, a while loop, a vmap, both branches of a cond that depends on `x`, and jit."""
    one, two, three, four = jax.random.split(key, 4)

    def row(carry, t):
        now, later = jax.random.split(carry)
        return later, jax.random.normal(jax.random.fold_in(now, t)) + x

    last, values = jax.lax.scan(row, one, jnp.arange(3), reverse=True)
    total = values.sum() + jax.jit(jax.random.uniform)(last)
    total += jax.lax.fori_loop(2, 4, lambda t, s: s + jax.random.uniform(fold(two, t)), total)
    total += jax.vmap(lambda t: jax.random.uniform(fold(three, t)))(jnp.arange(2)).sum()
    low, high = jax.random.split(four)
    draw = [partial(jax.random.uniform, k) for k in (low, high)]
    return total + jax.lax.cond(x > 0, *draw), last


fold = jax.random.fold_in


def test_the_recorder_finds_the_keys_of_draws_in_loops_branches_and_calls():
    key = jax.random.key(7)
    one, two, three, four = jax.random.split(key, 4)
    expected = []
    for t in (2, 1, 0):
        now, one = jax.random.split(one)
        expected.append(fold(now, t))
    expected += [one, fold(two, 2), fold(two, 3), fold(three, 0), fold(three, 1)]
    expected += [*jax.random.split(four)]
    used, (total, last) = random_keys.record(branchy, key, jax.ShapeDtypeStruct((), jnp.float32))
    found = [use.key for use in used if use.how == DRAWN]
    assert sorted(found) == sorted(tuple(jax.random.key_data(k).tolist()) for k in expected)
    assert last == one and isinstance(total, jax.ShapeDtypeStruct)
    assert not random_keys.faults(used)


def draws(*keys):
    return [jax.random.uniform(key) for key in keys]


@pytest.mark.parametrize(
    "function, ways",
    [
        (lambda k: draws(k, k), {DRAWN}),
        (lambda k: draws(k, jax.random.split(k)[0]), {DRAWN, SPLIT}),
        (lambda k: draws(k, fold(k, 1)), {DRAWN, FOLDED}),
        (lambda k: draws(jax.random.split(k, 3)[1], fold(k, 2)), {SPLIT, FOLDED}),
        (lambda k: draws(jax.random.split(k)[0], jax.random.split(k)[1]), {SPLIT}),
        (lambda k: draws(fold(k, 1), jax.random.split(k, 3)[1]), {DRAWN}),
        (lambda k: jax.lax.fori_loop(0, 2, lambda t, s: s + jax.random.uniform(k), 0.0), {DRAWN}),
        (lambda k: jax.vmap(lambda t: jax.random.uniform(k) + t)(jnp.arange(2)), set()),  # one draw
        (lambda k: draws(fold(k, 1), fold(k, 2)), set()),
    ],
)
def test_a_key_that_is_used_twice_is_named_with_its_uses(function, ways):
    faults = random_keys.faults(random_keys.record(function, jax.random.key(1))[0])
    found = {way for way in random_keys.RANDOM.values() if any(way in line for line in faults)}
    assert found >= ways and bool(found) == bool(ways), faults


def test_a_key_that_depends_on_what_is_computed_is_refused():
    def of_a_number(key, x):
        return jax.random.uniform(fold(key, (x > 0).astype(jnp.int32)))

    with pytest.raises(ValueError, match="depends on what is computed"):
        random_keys.record(of_a_number, jax.random.key(0), jax.ShapeDtypeStruct((), jnp.float32))
