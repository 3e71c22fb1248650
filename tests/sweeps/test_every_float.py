"""Every float of the config that may differ between seeds of one program does something there.

What a program leaves out where a float has its nominal value (an error of 0, a range that is the robot
file's) must not look as if it could be varied. Go1 on C MuJoCo: a seed a field, all with one key.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import toy_env
from toy_runs import leaves

from dynappo import config as config_lib
from dynappo import schedule, seeds
from dynappo.config import fields
from dynappo.description import robot
from dynappo.sweeps import grid
from dynappo.tasks.velocity import env as env_lib

FIELDS = {  # 4 robots that fall, step, stand and bend their joints far, all within half a second
    "physics.impl": "c",
    "physics.threads": 1,
    "rollout.num_envs": 4,
    "rollout.horizon": 8,
    "schedule.end_iteration": 2,
    "schedule.late_from": 2,
    "run.num_iterations": 4,
    "run.log_every": 4,
    "model.hidden": (8,),
    "model.epochs": 2,
    "ppo.hidden": (8,),
    "ppo.minibatches": 2,
    "ppo.shuffle_blocks": 2,
    "ppo.learning_rate": 0.01,  # the KL lowers it and raises it
    "task.episode_length": 16,
    "task.carry_on": True,
    "task.heading": True,
    "task.command_x": (-0.1, 0.1),
    "task.command_y": (-0.1, 0.1),
    "task.command_yaw": (-0.05, 0.05),
    "task.push.interval": (0.05, 0.1),
    "task.reset.joint_scale": (0.5, 1.5),
    "task.reset.spawn_height": 0.25,
    "task.reset.soft_limit": 0.4,
    "task.kp": 3.0,
    "task.weights.foot_clearance": -2.0,  # else task.clearance_height would do nothing
    # in the program where they are not None
    "model.bound": 0.5,
    "task.clearance_ramp": 0.1,
    "task.slow_commands": 0.3,
    "task.max_tilt": 0.3,
    "task.fall_reward": -2.0,
    "task.posture_std": 0.2,
    "task.posture_std_standing": 0.1,
}
FIELDS |= {
    f"task.weights.{name}": -2.0 for name in ("upright", "posture", "foot_slip", "feet_distance")
}
# what is in the program only where it is not 0
ERRORS = ("task.randomize.encoder_bias", "task.randomize.imu_tilt", "task.joint_friction")
EACH = {name: kind for name, kind in fields.every().items() if kind.kind in (float, tuple)}
FLOATS = [name for name, kind in EACH.items() if kind.kind is float]
REFUSED = [
    n for n in FLOATS if n.startswith(("run.", "physics.", "task.tiles.")) or n == "task.armature"
]
# a Go1's feet are never so close, and it has no gait clock: test_biped.py and test_gait.py have a G1's
BIPED = tuple(
    "task." + n
    for n in "weights.feet_distance weights.feet_phase gait_frequency gait_foot_height".split()
)
# of the height scan, which there is on rough ground alone (tests/terrain)
SCAN = tuple(n for n in EACH if n.startswith("task.noise.scan"))
VARIED = [n for n in EACH if n not in BIPED + SCAN and (n in ERRORS or grid.by_vmap(n))]
OTHER = {  # where 1.5 x + 0.5 is no value of the field, or none that shows
    "ppo.learning_rate": 1e-4,
    "ppo.gamma": 0.5,
    "ppo.lambda_": 0.5,
    "ppo.clip_epsilon": 0.01,
    "ppo.desired_kl": 100.0,
    "ppo.late_kl": 1e-4,
    "ppo.max_grad_norm": 0.01,
    "ppo.max_learning_rate": 1e-3,
    "ppo.min_std": 2.0,
    "model.stats_decay": 0.5,
    "model.huber_delta": 0.01,
    "task.effort_limit": 5.0,
    "task.saturation_effort": 5.0,
    "task.velocity_limit": 5.0,
    "task.heading_gain": 0.01,
    "task.max_tilt": 0.05,
    "task.start_anew": 1.0,
    "task.keep_command": 0.5,
    "task.reset.soft_limit": 0.2,
}


def changed(field, value):
    """Another value of a field."""
    if isinstance(value, tuple):
        return tuple(1.5 * x + 0.05 for x in value)
    return OTHER.get(field, 1.5 * value + 0.5)


def of(hyper, field):
    for name in field.split("."):
        hyper = getattr(hyper, name)
    return hyper


def with_tuple(hyper, field, columns):
    """`hyper` with a tuple whose numbers have a value a seed, as a grid makes it."""
    *groups, leaf = field.split(".")
    nodes = [hyper]
    for name in groups:
        nodes.append(getattr(nodes[-1], name))
    new = nodes.pop()._replace(**{leaf: columns})
    for name in reversed(groups):
        new = nodes.pop()._replace(**{name: new})
    return new


@pytest.fixture(scope="module")
def runs():
    """`{field: numbers of the run in which it differs}`; of "" and of the last one nothing does."""
    found = FIELDS | {"task.observation": "onboard"} | dict.fromkeys(ERRORS, 0.01)
    config = toy_env.configure(found, "configs/go1.py:dyna4")
    static, hyper = config_lib.split(config)
    names = ["", *VARIED, "again"]
    for field in VARIED:
        value = of(hyper, field)

        def each(old, new, field=field):
            return [new if name == field else old for name in names]

        if isinstance(value, tuple):
            pairs = zip(value, changed(field, value), strict=True)
            columns = tuple(jnp.asarray(each(*pair), jnp.float32) for pair in pairs)
            hyper = with_tuple(hyper, field, columns)
        else:
            hyper = seeds.vary(hyper, field, each(value, changed(field, value)))
    env = env_lib.make(robot.load("go1"), config.task, config.physics, impl="c")
    keys = jnp.stack([jax.random.key(0)] * len(names))
    state = jax.jit(partial(seeds.init, env, static=static))(hyper, keys)
    step = jax.jit(partial(seeds.run, env, static=static))
    after, metrics = jax.device_get(step(hyper, state, schedule.columns(config)))
    numbers = leaves(after) | {name: np.moveaxis(x, 1, 0) for name, x in metrics.items()}
    return {name: {k: x[i] for k, x in numbers.items()} for i, name in enumerate(names)}


def differ(one, other):
    return [n for n, x in one.items() if not np.array_equal(x, other[n], equal_nan=True)]


def test_a_seed_with_no_value_of_its_own_has_the_first_ones_numbers(runs):
    assert differ(runs[""], runs["again"]) == []


@pytest.mark.parametrize("field", VARIED)
def test_a_float_that_can_be_varied_changes_the_run(runs, field):
    assert differ(runs[""], runs[field])


@pytest.mark.parametrize("field", REFUSED + list(ERRORS))
def test_a_float_that_is_built_in_is_refused_by_its_name(field):
    """The errors where they are 0, as they are by default."""
    hyper = config_lib.split(toy_env.configure(FIELDS, "configs/go1.py:dyna4"))[1]
    with pytest.raises(ValueError, match=f"{field} is .*expected"):
        seeds.vary(hyper, field, [0.01, 0.02])
    assert not grid.by_vmap(field)


@pytest.mark.parametrize("field", ["task.max_tilt", "task.weights.foot_slip"])
def test_a_float_that_is_none_is_refused_by_its_name(field):
    hyper = config_lib.split(toy_env.configure({}, "configs/go1.py:dyna4"))[1]
    with pytest.raises(ValueError, match=f"{field} is None.*expected"):
        seeds.vary(hyper, field, [0.5, 1.0])


def test_every_float_is_varied_or_refused():
    """What is left are ranges of bodies and of the ground, which are no single number: `vary` refuses these,
    and a grid gives each combination a program."""
    left = set(EACH) - {*VARIED, *REFUSED, *BIPED, *SCAN}
    hyper = config_lib.split(toy_env.configure(FIELDS, "configs/go1.py:dyna4"))[1]
    numbers = {n for n in left if type(EACH[n].like[0]) is float}
    assert left - numbers == {"model.hidden", "ppo.hidden", "ppo.critic_hidden"}
    assert all(n.startswith(("task.randomize.", "task.tiles.")) for n in numbers)
    for field in numbers:
        with pytest.raises(ValueError, match="several numbers|is .* expected"):
            seeds.vary(hyper, field, [0.01, 0.02])
        assert not grid.by_vmap(field)
