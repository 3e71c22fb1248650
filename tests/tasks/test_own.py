"""Terms of one's own in the velocity task: each kind against NumPy, in training, in a tail and in play."""

import re
import textwrap
import warnings
from types import SimpleNamespace

import jax
import mujoco
import numpy as np
import pytest
from answers import refused

from dynappo import config as config_lib
from dynappo import terms
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.export import joint_order
from dynappo.learner import symmetry
from dynappo.physics import randomize
from dynappo.policy import episode, policy_file
from dynappo.tasks import of_robots
from dynappo.tasks.velocity import observe, own, reward_sum

ROBOTS, ROWS, DT = 8, 30, 0.02
FILE = """
from dynappo import terms

@terms.reward(weight=2.0, numbers={"calm": 3.0})
def slow_joints(joint_velocity, previous_action, calm, level, effort, dt):
    return calm * (joint_velocity**2).sum() + level * effort[0] + dt * previous_action[0]

@terms.reward(weight=-1.0)
def higher(height, qpos, episode_steps, feet_down):
    return height + qpos[0] + episode_steps + feet_down.sum()

@terms.reward(weight=None)
def unused(nothing_like_it=1.0):
    raise AssertionError

@terms.observation(size=None, scale=0.5)
def doubled(joint_velocity):
    return 2 * joint_velocity

@terms.observation(size=4, signs=(1, 1, 1, 1), order=(1, 0, 3, 2))
def feet_down(contact):
    return contact * 1.0

@terms.observation(size=1, signs=(-1,), shown=False)
def secret(qvel, qpos):
    return qvel[1:2] + 0 * qpos[:1]

@terms.known(start=(0.0, 0.0), signs=(1, -1))
def path(path, linear_velocity, dt):
    return path + dt * linear_velocity[:2]

@terms.known(start=(0.5,), signs=(1,))
def effort(effort, action, previous_action, feet_down):
    return effort + ((action - previous_action) ** 2).sum() + feet_down[:1]

@terms.termination(timeout=True, numbers={"goal": 0.003})
def arrived(path, goal):
    return path[0] > goal

@terms.termination()
def tipped(angular_velocity, torque, foot_position):
    return angular_velocity[0] + 0 * torque[0] + 0 * foot_position[3, 2] > 2.0

@terms.command(draws=2)
def scaled(draw, level, command_x, effort):
    xp = draw.__array_namespace__()
    return xp.stack([level * command_x[1] * draw[0], draw[1], 0 * effort[0] + 0.125])

@terms.curriculum(start=0.5, evaluated=2.0, numbers={"rise": 0.25})
def level(level, rise, fell, timed_out, episode_steps, path):
    level = level + rise * timed_out - 0.125 * fell + 0 * episode_steps + 0 * path[0]
    return level * (level > 0)
"""


def of(text, folder, spec="go1:laptop", **task):
    """The validated config of a robot with terms of this text."""
    path = folder / "own.py"
    path.write_text(textwrap.dedent(text))
    config = config_lib.load(spec)
    config.task.update(**task)
    terms.use(config, terms.read(path))
    return config_lib.validate(config)


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Rows of random actions on C MuJoCo, each followed by the reset that it asks for."""
    config = of(FILE, tmp_path_factory.mktemp("own"), random_clock=False, carry_on=False)
    config, robot = motors.fitted(config, robot_lib.load("go1"))
    of_robots.check(config, robot)
    hyper = config_lib.split(config)[1]
    env = of_robots.make(config, robot, impl="c")
    one = np.ones(ROBOTS, np.float32)
    com = robot.mj_model.body_ipos[robot.base_body].astype(np.float32)
    body = randomize.Body(one, np.tile(com, (ROBOTS, 1)), one * 0.8, one, one)

    @jax.jit
    def row(hyper, state, action, keys):
        after, outcome = jax.vmap(env.step, (None, 0, 0, 0, 0))(hyper, body, state, action, keys)
        again = jax.vmap(env.autoreset, (None, 0, 0, 0, 0))(hyper, body, after, outcome, keys)
        return after, outcome, again

    keys = jax.random.split(jax.random.key(0), ROBOTS)
    reset = jax.jit(jax.vmap(env.reset, (None, 0, 0)))
    state, rng, rows = jax.device_get(reset(hyper, body, keys)), np.random.default_rng(0), []
    for k in range(ROWS):
        action = rng.normal(0, 0.7, (ROBOTS, 12)).astype(np.float32)
        now = jax.vmap(jax.random.fold_in, (0, None))(keys, k)
        after, outcome, again = jax.device_get(row(hyper, state, action, now))
        rows.append(
            SimpleNamespace(before=state, action=action, after=after, outcome=outcome, again=again)
        )
        state = again
    mine = observe.own(config.task.terms_about)
    return SimpleNamespace(
        config=config, robot=robot, env=env, hyper=hyper, rows=rows, own=mine, body=body, keys=keys,
        reset=reset, places=observe.slices(12, own=mine),
    )  # fmt: skip


def part(world, obs, name):
    return obs[:, world.places[name]]


def test_the_layout_is_predicted_then_known_and_says_who_sees_what(world):
    names = [*world.places]
    assert names[5:8] == ["doubled", "feet_down", "secret"]
    assert names[8:] == ["command", "previous_action", "path", "effort", "level"]
    assert world.env.prop_size == 33 + 12 + 4 + 1 and world.env.obs_size == 50 + 15 + 2 + 1 + 1
    hidden = [world.places[name].start for name in ("secret", "level")]
    views = world.env.views
    assert set(range(69)) - set(views.actor.tolist()) == set(hidden)
    assert views.critic.tolist() == views.model.tolist() == [*range(69)]
    scale = world.env.input_scale[world.places["doubled"]]
    np.testing.assert_array_equal(scale, np.full(12, 0.5, np.float32))


def test_predicted_quantities_are_what_the_functions_say_of_the_state(world):
    for row in world.rows:
        after = row.after
        np.testing.assert_allclose(part(world, after.prop, "doubled"), 2 * after.qvel[:, 6:])
        down = part(world, after.prop, "feet_down")
        np.testing.assert_array_equal(down, after.contact_steps > 0)
        np.testing.assert_allclose(part(world, after.prop, "secret"), after.qvel[:, 1:2])
    assert {0.0, 1.0} == set(np.ravel([part(world, r.after.prop, "feet_down") for r in world.rows]))


def test_known_quantities_follow_from_the_row_in_training_and_in_a_tail(world):
    size = world.env.prop_size
    advance = jax.jit(jax.vmap(world.env.advance, (None, 0, 0, 0, 0)))
    for row in world.rows:
        moves = part(world, row.after.prop, "linear_velocity")[:, :2]
        expected = part(world, row.before.obs, "path") + DT * moves
        np.testing.assert_allclose(part(world, row.after.obs, "path"), expected, atol=1e-6)
        change = ((row.action - row.before.last_action) ** 2).sum(-1, keepdims=True)
        expected = part(world, row.before.obs, "effort") + change
        expected += part(world, row.after.prop, "feet_down")[:, :1]
        np.testing.assert_allclose(part(world, row.after.obs, "effort"), expected, rtol=1e-5)
        told = row.before.obs[:, size:], row.before.prop, row.action, row.after.prop
        np.testing.assert_allclose(
            advance(world.hyper, *told)[:, 3:], row.after.obs[:, size + 3 :], atol=1e-5
        )


def test_rewards_are_sums_of_their_terms_and_the_known_ones_are_computed_in_a_tail(world):
    known = reward_sum.known(reward_sum.terms_of(world.config.task), world.config.task)
    assert "slow_joints" in known and "higher" not in known and "unused" not in known
    weights = jax.tree.map(lambda w: 0.0 * w, world.hyper.task.weights)._replace(slow_joints=2.0)
    alone = world.hyper._replace(task=world.hyper.task._replace(weights=weights))
    compute = jax.jit(jax.vmap(world.env.known_reward, (None, 0, 0, 0)))
    for row in world.rows:
        joints = part(world, row.after.prop, "joint_velocity")
        expected = 3.0 * (joints**2).sum(-1) + DT * row.before.last_action[:, 0]
        expected += row.before.own["level"][:, 0] * row.before.own["effort"][:, 0]
        found = row.outcome.metrics["reward_slow_joints"]
        np.testing.assert_allclose(found, 2.0 * expected, rtol=1e-5)
        tail = compute(alone, row.before.obs, row.action, row.after.prop)
        np.testing.assert_allclose(tail, DT * found, rtol=1e-5)
        height = row.after.qpos[:, 2] + row.after.qpos[:, 0] + row.before.episode_steps
        height += part(world, row.after.prop, "feet_down").sum(-1)
        np.testing.assert_allclose(row.outcome.metrics["reward_higher"], -height, rtol=1e-5)
        assert "reward_unused" not in row.outcome.metrics


def test_ends_are_falls_or_timeouts_as_they_say(world):
    tipped, arrived = [], []
    for row in world.rows:
        tips = part(world, row.after.prop, "angular_velocity")[:, 0] > 2.0
        there = part(world, row.before.obs, "path")[:, 0] > 0.003
        np.testing.assert_array_equal(row.outcome.metrics["ended_tipped"], tips)
        np.testing.assert_array_equal(row.outcome.metrics["ended_arrived"], there)
        assert (row.outcome.discount[tips] == 0).all()
        stands = row.outcome.discount == 1
        np.testing.assert_array_equal(row.outcome.truncation[stands], there[stands])
        assert not row.outcome.truncation[~stands].any()
        tipped.append(tips.any())
        arrived.append((there & stands).any())
    assert any(tipped) and any(arrived)


def test_a_curriculum_moves_where_an_episode_ends_and_the_command_follows_it(world):
    levels = set()
    for row in world.rows:
        fell, late = row.outcome.discount == 0, row.outcome.truncation == 1
        before, after = row.after.own["level"][:, 0], row.again.own["level"][:, 0]
        np.testing.assert_allclose(
            after, np.maximum(before + 0.25 * late - 0.125 * fell, 0), atol=1e-6
        )
        np.testing.assert_array_equal(row.outcome.metrics["curriculum_level"], before)
        ended = fell | late
        np.testing.assert_array_equal(part(world, row.again.obs, "path")[ended], 0)
        np.testing.assert_array_equal(part(world, row.again.obs, "effort")[ended], 0.5)
        command = row.again.command
        assert (0 <= command[:, 0]).all() and (command[ended, 0] <= after[ended]).all()
        assert (0 <= command[:, 1]).all() and (command[:, 2] == 0.125).all()
        np.testing.assert_array_equal(command[~ended], row.after.command[~ended])
        levels |= {*after.tolist()}
    assert len(levels) > 2


def test_an_evaluation_has_its_own_level_and_other_runs_are_as_they_were(world):
    hyper = world.env.evaluated(world.hyper)
    assert float(hyper.task.own.level) == 2.0 and float(hyper.task.own.rise) == 0.25
    state = world.reset(hyper, world.body, world.keys)
    np.testing.assert_array_equal(state.own["level"], np.full((ROBOTS, 1), 2.0))
    assert state.command[:, 0].max() > 1
    config = config_lib.validate(config_lib.load("go1:laptop"))
    bare = of_robots.make(config, world.robot, impl="c")
    assert bare.evaluated is None and (bare.obs_size, bare.views) == (48, None)
    assert not any(name.startswith(("ended_", "curriculum_")) for name in bare.metrics)


def test_the_mirror_image_is_the_observation_of_the_mirrored_robot(world):
    index, sign = world.env.mirror[0]
    feet = world.places["feet_down"]
    assert (index[feet] - feet.start).tolist() == [1, 0, 3, 2] and (sign[feet] == 1).all()
    joints, doubled = world.places["joint_velocity"], world.places["doubled"]
    np.testing.assert_array_equal(index[doubled] - doubled.start, index[joints] - joints.start)
    np.testing.assert_array_equal(sign[doubled], sign[joints])
    assert sign[world.places["secret"]] == -1 and sign[world.places["path"]].tolist() == [1, -1]
    obs = world.rows[-1].after.obs
    twice = symmetry.vector(world.env.mirror[0], symmetry.vector(world.env.mirror[0], obs))
    np.testing.assert_array_equal(twice, obs)


def test_play_keeps_what_training_keeps(world):
    """Known quantities over an episode, feet on the ground, and ends: in NumPy, of the same file."""
    sizes = {"actor": (67, 12)}
    layer = {"kernel": np.zeros(sizes["actor"], np.float32), "bias": np.zeros(12, np.float32)}
    policy = policy_file.describe(world.config, world.robot)
    policy = policy._replace(params={"actor": {"params": {"Dense_0": layer}}})
    body = episode.load(world.robot.xml, policy, policy.timestep)
    assert episode.ends(body) == ["arrived"]  # the other asks for torque
    actions, seen = np.random.default_rng(1).normal(0, 0.7, (20, 12)), []

    def act(obs):
        seen.append(obs)
        return actions[len(seen) - 1]

    data = mujoco.MjData(body.model)
    rows, down = episode.rows(body, data, act, lambda t: np.array([0.5, 0.0, 0.0])), []
    for _ in range(20):
        next(rows)
        down.append(episode.foot_heights(body, data) < 0)
    seen, where = np.array(seen), observe.reading(policy.observation, world.own)
    moves = seen[1:, where["linear_velocity"]][:, :2]
    np.testing.assert_allclose(
        seen[:, where["path"]], np.cumsum([[0, 0], *(DT * moves)], axis=0), atol=1e-6
    )
    feet = seen[:, where["feet_down"]]
    np.testing.assert_array_equal(feet[1:], np.array(down)[:-1])
    assert 0 < feet.mean() < 1
    before = np.array([np.zeros(12), *actions[:-1]])
    steps = ((actions - before) ** 2).sum(-1)[:-1] + feet[1:, 0]
    effort = 0.5 + np.cumsum([0, *steps])
    np.testing.assert_allclose(seen[:, where["effort"]][:, 0], effort, rtol=1e-6)
    turned = joint_order.permute(policy, policy.joint_names[::-1])
    assert turned.params["actor"]["params"]["Dense_0"]["kernel"].shape == sizes["actor"]


WRONG = {  # what follows the import -> a part of the line
    "@terms.reward(weight=1.0)\ndef f(torqe): return 0.0": "f of .* asks for torqe, .* did you mean torque",
    "@terms.observation(size=1, signs=(1,))\ndef f(torque): return torque[:1]": "an observation cannot have",
    "@terms.known(start=(0.0,), signs=(1,))\ndef f(height): return height": "a known observation cannot",
    "@terms.curriculum(start=0.0)\ndef f(f, action): return f": "asks for action, which a curriculum",
    "@terms.reward(weight=1.0)\ndef f(torque): return torque": r"has the shape \(12,\), expected one number",
    "@terms.observation(size=2, signs=(1, 1))\ndef f(qpos): return qpos[:3]": r"\(3,\), expected \(2,\)",
    "@terms.termination()\ndef f(height): return 1 if height < 0.2 else 0": (
        r"line 5 cannot be run: no `if`, .* on a value: x \* \(x > 0\), or xp.where .*docs/task.md"
    ),
    "import numpy as np\n@terms.reward(weight=1.0)\ndef f(foot_height): return np.asarray(foot_height)[0]": (
        r"line 6 cannot be run: NumPy cannot have the value: use xp = x.__array_namespace__\(\) in"
    ),
    "import math\n@terms.reward(weight=1.0)\ndef f(height): return math.exp(height)": "no float.* math on a",
    "@terms.reward(weight=1.0)\ndef f(torque): return torque[torque > 0].sum()": r"no x\[condition\]: x \*",
    "@terms.reward(weight=1.0)\ndef f(qpos): return [1, 2][qpos[0].astype(int)]": "no value as an index",
    "@terms.reward(weight=1.0)\ndef f(qpos): raise ValueError('so it is ' * 99)": r" \.\.\.$",
    "@terms.command(draws=1)\ndef f(draw): return draw": r"shape \(1,\), expected \(3,\)",
    "@terms.command(draws=1)\ndef f(draw): return draw[0], 0.0, 0.0": (
        r"own.py, line 4 returns a tuple, expected an array of the shape \(3,\): xp.stack\(\[...\]\) makes"
    ),
    "@terms.observation(size=2, signs=(1, 1))\ndef f(qpos): return [qpos[0], qpos[1]]": "a list, .*xp.stack",
    "@terms.known(start=(0.0,), signs=(1,))\ndef f(f): return 'a'": r"a str, .* of the shape \(1,\)$",
    "@terms.known(start=(0.0,), signs=(1,))\ndef f(f): f + 1": r"None, .* shape \(1,\): no return statement",
    "@terms.curriculum(start=0.3)\ndef f(f): f + 1": "None, expected one number .*: no return statement",
    "@terms.reward(weight=1.0)\ndef f(qpos): qpos[0]": "own.py, line 4 returns None, .*: no return statement",
    "@terms.reward(weight=1.0)\ndef f(qpos): return [qpos[0]]": "returns a list, expected one number of one",
    "@terms.termination()\ndef f(height): height < 0.1": "None, expected True or False: no return statement",
    "@terms.termination()\ndef f(height): return height": (
        "returns numbers, expected True or False: compare it, such as height < 0.2$"
    ),
    "@terms.termination(timeout=True)\ndef f(qpos): return 1": "returns numbers, expected True or False",
    "@terms.termination()\ndef f(qpos): return qpos > 9": r"\(19,\), expected True or False; .any\(\) or",
    "@terms.command(draws=1)\ndef f(draw):\n    xp = draw.__array_namespace__()\n"
    "    return xp.stack([draw[0], draw[1], draw[0]])": r"line 7 .* index 1 is out of .*; JAX would take",
    "@terms.reward(weight=1.0)\ndef f(contact): return contact[4]": "index 4 is out of .*; JAX would take",
    "@terms.observation(size=1, signs=(1,))\ndef f(qpos): return qpos.at[0].set(0)[:1]": (
        "line 5 cannot be run: AttributeError: .* no attribute 'at'; play calls it with NumPy arrays"
    ),
    "@terms.termination()\ndef f(qpos): return qpos.at[0].get() > 1": "'at'; play calls it with NumPy arrays",
    "@terms.observation(size=1)\ndef f(qpos): return qpos[:1]": "has no signs, .* ppo.symmetry is True",
    "@terms.reward(weight=1.0)\ndef energy(torque): return 0.0": "energy .* a name that dynappo uses",
    "@terms.reward(weight=1.0)\ndef fall(torque): return 0.0": "fall .* a name that dynappo uses",
    "@terms.reward(weight=1.0)\ndef gravity(torque): return 0.0": "gravity .* a name that dynappo uses",
    "@terms.reward(weight=1.0, numbers={'kp': 1.0})\ndef f(kp): return kp": "number kp .* dynappo uses",
    "@terms.reward(weight=1.0, numbers={'f': 1.0})\ndef f(f): return f": "number f .* a term has already",
}


@pytest.mark.parametrize("text", WRONG)
def test_a_wrong_term_is_one_line_before_anything_is_compiled(text, tmp_path):
    config = of(f"from dynappo import terms\n\n\n{text}\n", tmp_path)
    config, robot = motors.fitted(config, robot_lib.load("go1"))
    said = refused(of_robots.check, config, robot)
    assert re.search(WRONG[text], said), said


RIGHT = """
import warnings
import jax
import jax.numpy as jnp
import numpy as np
from dynappo import terms

@terms.reward(weight=1.0)
def only_for_jax(torque): return torque.at[0].set(0.0).sum()

@terms.reward(weight=1.0)
def one_of_a_table(height, foot_height):
    return foot_height[(1e6 * height).astype(int)] + jnp.linalg.norm(foot_height)

@terms.observation(size=2, signs=(1, 1))
def divided(qpos, qvel):
    if isinstance(qpos, np.ndarray):
        warnings.warn("of made-up numbers")
    xp = qpos.__array_namespace__()
    return xp.stack([qpos[0] / (0 * qvel[0]), xp.log(qvel[1] - 9)])

@terms.observation(size=1, signs=(1,))
def of_jax(qpos): return jax.nn.relu(qpos[:1])

@terms.known(start=(0.0,), signs=(1,))
def inverse(inverse, joint_position):
    xp = inverse.__array_namespace__()
    return xp.linalg.inv(joint_position[:9].reshape(3, 3))[0, :1]

@terms.termination()
def by_jax(height, kp): return jnp.logical_and(height < 0.1, kp > 0.0).any()

@terms.termination(timeout=True)
def with_at(torque): return torque.at[0].get() > 1e3

@terms.termination(timeout=True)
def never(): return False

@terms.command(draws=1)
def drawn(draw, command_x): return jnp.stack([command_x[1] * draw[0], 0.0, 0.0])

@terms.curriculum(start=0.3)
def level(level, episode_steps): return level + 1 / episode_steps
"""


def test_what_training_and_play_can_call_is_accepted_whatever_made_up_numbers_give(tmp_path):
    """`.at` where play does not call it, jax.numpy, and with numbers at hand: divided by 0, an index."""
    config, robot = motors.fitted(of(RIGHT, tmp_path), robot_lib.load("go1"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with np.errstate(all="raise"):
            of_robots.check(config, robot)


@pytest.mark.parametrize(
    "value", [1, 2.5, True, np.float32(1), np.ones(()), jax.numpy.ones((), "bfloat16")]
)
def test_what_is_one_number(value):
    assert terms.fault(terms.Reward, value, ()) == ""


@pytest.mark.parametrize("value", [1j, np.complex64(1), np.array("a"), np.array(None), {}, len])
def test_what_is_no_number(value):
    assert f"returns a {type(value).__name__}, " in terms.fault(terms.Reward, value, ())


def test_a_sum_of_rewards_takes_numbers_only():
    said = refused(reward_sum.values, {"f": lambda height: None}, {"height": 0.3})
    assert re.search(
        r"the term f of .*test_own.py, line \d+ returns None, expected one number", said
    )
    assert reward_sum.values({"f": lambda height: height > 0}, {"height": 0.3}) == {"f": True}


def test_a_field_that_no_term_has_is_one_line(tmp_path):
    text = (
        "from dynappo import terms\n\n@terms.reward(weight=1.0)\ndef lively(torque): return 0.0\n"
    )
    config = of(text, tmp_path)
    for group, name, told in (
        ("weights", "livly", "task.weights.livly has no term; .* lively"),
        ("noise", "lively", "task.noise.lively: no observation"),
        ("own", "speed", "task.own.speed: no term has"),
    ):
        changed = config_lib.from_json(config_lib.to_json(config))
        changed.task[group][name] = 1.0
        robot = robot_lib.load("go1")
        fitted = motors.fitted(config_lib.validate(changed), robot)[0]
        said = refused(of_robots.check, fitted, robot)
        assert re.search(told, said), said


def test_a_quantity_that_is_not_finite_at_the_start_is_named(world):
    state = SimpleNamespace(obs=world.rows[0].before.obs.copy())
    of_robots.check_start(world.config, world.robot, state)
    state.obs[3, world.places["path"].start] = np.nan
    said = refused(of_robots.check_start, world.config, world.robot, state)
    assert "the term path of " in said and "not finite where an episode begins" in said


def test_numbers_are_floats_that_a_sweep_can_change(world):
    hyper = world.hyper
    assert hyper.task.own.goal == 0.003 and hyper.task.weights.slow_joints == 2.0
    assert {"goal", "calm", "rise", "level"} == set(hyper.task.own._fields)
    assert own.numbers(hyper)["goal"] == 0.003
