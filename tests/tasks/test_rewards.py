"""Reward terms against NumPy loops on random states, by hand, and their weighted sum."""

import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dynappo import config
from dynappo.program import build
from dynappo.tasks.velocity import observe, reward_sum, rewards

STATES = 64
LIFT = 0.09  # m, task.clearance_height
# Isaac-Velocity-Flat-*-v0 of Isaac Lab 2.2.1: the terms and their weights, per second. Terms of your own
# need not be here.
SMOOTH = dict.fromkeys(  # of other tasks, off in these
    "action_acceleration energy joint_limits stand_still foot_clearance".split(), 0.0
)
UNITREE = SMOOTH | dict(
    track_linear_velocity=1.5,
    track_yaw_rate=0.75,
    vertical_velocity=-2.0,
    roll_pitch_rate=-0.05,
    flat_orientation=-2.5,
    joint_torques=-2e-4,
    joint_accelerations=-2.5e-7,
    action_rate=-0.01,
    feet_air_time=0.25,
    undesired_contacts=0.0,
)
ANYMAL = SMOOTH | dict(
    track_linear_velocity=1.0,
    track_yaw_rate=0.5,
    vertical_velocity=-2.0,
    roll_pitch_rate=-0.05,
    flat_orientation=-5.0,
    joint_torques=-2.5e-5,
    joint_accelerations=-2.5e-7,
    action_rate=-0.01,
    feet_air_time=0.5,
    undesired_contacts=-1.0,
)
WEIGHTS = dict(go1=UNITREE, go2=UNITREE, anymal_c=ANYMAL, anymal_d=ANYMAL)


def random_state(seed):
    """One robot's arrays (float32), as the terms take them; commands are slow half of the time."""
    rng = np.random.default_rng(seed)
    gravity = rng.normal(size=3)
    state = dict(
        linear=rng.normal(size=3),
        angular=rng.normal(size=3),
        gravity=gravity / np.linalg.norm(gravity),
        command=rng.uniform(-1, 1, 3) * (1.0 if seed % 2 else 0.08),
        torque=rng.normal(size=12) * 10,
        qd=rng.normal(size=12) * 5,
        qd_before=rng.normal(size=12) * 5,
        action=rng.normal(size=12),
        last_action=rng.normal(size=12),
        last_air_time=rng.uniform(0, 1, 4),
        lowest=rng.normal(size=14),
        older_action=rng.normal(size=12),
        over_limit=np.maximum(rng.normal(size=12), 0),
        swing_height=rng.uniform(0, 0.12, 4),
        clearance_share=np.asarray(rng.uniform(0.2, 1)),
        joint_position=rng.normal(size=12),
    )
    state = {name: value.astype(np.float32) for name, value in state.items()}
    return state | {"touchdown": rng.random(4) < 0.5, "contact": rng.random(4) < 0.5}


def by_loops(s, std):
    """The formulas of the task's definition, one number at a time in double precision."""
    share = float(s["clearance_share"])
    s = {name: [float(x) for x in value] for name, value in s.items() if value.ndim}
    error = sum((s["linear"][i] - s["command"][i]) ** 2 for i in range(2))
    yaw_error = (s["angular"][2] - s["command"][2]) ** 2
    air, speed = 0.0, math.hypot(s["command"][0], s["command"][1])
    for last, down in zip(s["last_air_time"], s["touchdown"], strict=True):
        if down and speed > 0.1:
            air += last - 0.5
    actions = list(zip(s["action"], s["last_action"], s["older_action"], strict=True))
    moves = sum(x**2 for x in s["command"]) > 0.01
    short = [
        (1 - h / LIFT) ** 2
        for h, down in zip(s["swing_height"], s["touchdown"], strict=True)
        if down and h < LIFT and moves
    ]
    return dict(
        action_acceleration=sum((a - 2 * b + c) ** 2 for a, b, c in actions),
        energy=sum(abs(t * v) for t, v in zip(s["torque"], s["qd"], strict=True)),
        joint_limits=sum(s["over_limit"]),
        stand_still=0.0 if moves else sum(abs(q) for q in s["joint_position"]),
        foot_clearance=share * sum(short),
        track_linear_velocity=math.exp(-error / std**2),
        track_yaw_rate=math.exp(-yaw_error / std**2),
        vertical_velocity=s["linear"][2] ** 2,
        roll_pitch_rate=s["angular"][0] ** 2 + s["angular"][1] ** 2,
        flat_orientation=s["gravity"][0] ** 2 + s["gravity"][1] ** 2,
        joint_torques=sum(t**2 for t in s["torque"]),
        joint_accelerations=sum(
            ((a - b) / 0.005) ** 2 for a, b in zip(s["qd"], s["qd_before"], strict=True)
        ),
        action_rate=sum((a - b) ** 2 for a, b in zip(s["action"], s["last_action"], strict=True)),
        feet_air_time=air,
        feet_in_air=float(sum(not c for c in s["contact"])),
        undesired_contacts=float(sum(low < 0 for low in s["lowest"])),
    )


def shipped(s, std):
    """Every term of `dynappo.tasks.velocity.rewards`, of NumPy or JAX arrays."""
    swing = s["swing_height"], s["touchdown"], s["command"], LIFT, s["clearance_share"]
    before = s["last_action"], s["older_action"]
    return dict(
        action_acceleration=rewards.action_acceleration(s["action"], *before),
        energy=rewards.energy(s["torque"], s["qd"]),
        joint_limits=rewards.joint_limits(s["over_limit"]),
        stand_still=rewards.stand_still(s["joint_position"], s["command"]),
        foot_clearance=rewards.foot_clearance(*swing),
        track_linear_velocity=rewards.track_linear_velocity(s["linear"], s["command"], std),
        track_yaw_rate=rewards.track_yaw_rate(s["angular"], s["command"], std),
        vertical_velocity=rewards.vertical_velocity(s["linear"]),
        roll_pitch_rate=rewards.roll_pitch_rate(s["angular"]),
        flat_orientation=rewards.flat_orientation(s["gravity"]),
        joint_torques=rewards.joint_torques(s["torque"]),
        joint_accelerations=rewards.joint_accelerations(s["qd"], s["qd_before"], 0.005),
        action_rate=rewards.action_rate(s["action"], s["last_action"]),
        feet_air_time=rewards.feet_air_time(s["last_air_time"], s["touchdown"], s["command"]),
        feet_in_air=rewards.feet_in_air(s["contact"]),
        undesired_contacts=rewards.undesired_contacts(s["lowest"]),
    )


@pytest.fixture(scope="module")
def states():
    return [random_state(seed) for seed in range(STATES)]


@pytest.mark.parametrize("std", [0.5, 1.0])
def test_every_term_in_numpy_is_that_of_plain_loops(states, std):
    for state in states:
        expected, found = by_loops(state, std), shipped(state, std)
        assert expected.keys() == found.keys()
        for name, value in expected.items():
            np.testing.assert_allclose(found[name], value, rtol=1e-5, atol=1e-6, err_msg=name)


@pytest.mark.parametrize("std", [0.5, 1.0])
def test_every_term_in_jax_under_jit_and_vmap_is_that_of_plain_loops(states, std):
    batch = {name: jnp.stack([s[name] for s in states]) for name in states[0]}
    found = jax.jit(jax.vmap(lambda s: shipped(s, std)))(batch)
    for i, state in enumerate(states):
        for name, value in by_loops(state, std).items():
            np.testing.assert_allclose(found[name][i], value, rtol=1e-5, atol=1e-6, err_msg=name)


def test_the_random_states_exercise_every_branch(states):
    found = [by_loops(s, 0.5) for s in states]
    air = [f["feet_air_time"] for f in found]
    assert min(air) < 0 < max(air) and sum(a == 0 for a in air) >= STATES // 2
    assert sum(f["foot_clearance"] > 0.01 for f in found) > STATES / 4
    assert {f["feet_in_air"] for f in found} == {0.0, 1.0, 2.0, 3.0, 4.0}


def test_no_term_but_feet_air_time_is_ever_negative(states):
    for state in states:
        terms = shipped(state, 0.5)
        assert all(value >= 0 for name, value in terms.items() if name != "feet_air_time")


def make_state(**changes):
    """Standing upright and still on four feet, with no command and no action."""
    zeros = {name: np.zeros_like(value) for name, value in random_state(0).items()}
    still = dict(
        gravity=np.array([0.0, 0.0, -1.0]),
        contact=np.ones(4, bool),
        lowest=np.full(14, 0.1),
    )
    return zeros | still | {name: np.asarray(value) for name, value in changes.items()}


def total(terms, weights, dt):
    """`reward_sum.total` with weights from a dict."""
    return reward_sum.total(terms, SimpleNamespace(**weights), dt)


def weighted_per_second(weights, **changes):
    """Reward per second of a hand-made state, and each weighted term."""
    terms = shipped(make_state(**changes), 0.5)
    terms.pop("feet_in_air")
    reward, parts = total(terms, weights, dt=0.02)
    return float(reward) / 0.02, {name: float(value) for name, value in parts.items()}


@pytest.mark.parametrize(("weights", "best"), [(UNITREE, 2.25), (ANYMAL, 1.5)])
def test_standing_still_under_a_zero_command_earns_the_most_there_is(weights, best):
    reward, parts = weighted_per_second(weights)
    assert reward == pytest.approx(best, abs=1e-12)
    earning = {name for name, value in parts.items() if value}
    assert earning == {"track_linear_velocity", "track_yaw_rate"}


def test_standing_still_under_a_fast_command_earns_almost_nothing():
    reward, parts = weighted_per_second(UNITREE, command=[1.0, 0.0, 0.0])
    assert parts["track_linear_velocity"] == pytest.approx(1.5 * math.exp(-4))
    assert reward == pytest.approx(0.75 + 1.5 * math.exp(-4))


def test_hopping_costs_twice_the_squared_vertical_velocity():
    up, _ = weighted_per_second(UNITREE, linear=[0.0, 0.0, 0.5])
    down, _ = weighted_per_second(UNITREE, linear=[0.0, 0.0, -0.5])
    assert up == down == pytest.approx(2.25 - 2.0 * 0.25)


def test_flying_earns_no_air_time_before_the_feet_come_down():
    flying = dict(contact=np.zeros(4, bool), last_air_time=np.full(4, 0.9), command=[1.0, 0, 0])
    _, parts = weighted_per_second(UNITREE, **flying)
    assert parts["feet_air_time"] == 0
    assert shipped(make_state(**flying), 0.5)["feet_in_air"] == 4


def test_falling_over_costs_orientation_roll_rate_and_parts_at_the_ground():
    fallen = dict(
        gravity=[0.0, 1.0, 0.0], angular=[3.0, 4.0, 0.0], lowest=[-0.01, 0.0, -0.2] + [0.1] * 11
    )
    _, parts = weighted_per_second(ANYMAL, **fallen)
    assert parts["flat_orientation"] == -5.0
    assert parts["roll_pitch_rate"] == pytest.approx(-0.05 * 25)
    assert parts["undesired_contacts"] == -2.0  # a part that only touches height 0 is not counted


def test_a_touchdown_after_half_a_second_in_the_air_is_worth_nothing():
    for air, expected in ((0.5, 0.0), (0.4, -0.1), (0.75, 0.25)):
        last = np.array([air, 9.0, 9.0, 9.0])
        down = np.array([True, False, False, False])
        found = rewards.feet_air_time(last, down, np.array([0.5, 0.0, 0.0]))
        assert found == pytest.approx(expected, abs=1e-12)


def test_air_time_sums_over_the_feet_that_came_down():
    last, down = np.array([0.6, 0.7, 0.2, 9.0]), np.array([True, True, True, False])
    found = rewards.feet_air_time(last, down, np.array([0.0, -1.0, 0.0]))
    assert found == pytest.approx(0.1 + 0.2 - 0.3)


@pytest.mark.parametrize(
    ("command", "counts"),
    [
        ((0.0, 0.0, 1.0), False),  # turning on the spot is slow, however fast the turn
        ((0.09, 0.0, 0.0), False),
        ((0.06, -0.07, 0.5), False),
        ((-0.11, 0.0, 0.0), True),
        ((0.08, 0.08, 0.0), True),
    ],
)
def test_air_time_counts_for_planar_commands_above_a_tenth_of_a_metre_per_second(command, counts):
    found = rewards.feet_air_time(np.full(4, 0.8), np.ones(4, bool), np.array(command))
    assert found == pytest.approx(4 * 0.3 if counts else 0.0)


def test_tracking_falls_with_the_error_and_only_with_the_planar_error():
    command = np.array([0.3, -0.2, 0.1])
    values = [
        rewards.track_linear_velocity(command + [e, 0.0, 7.0], command, 0.5)
        for e in (0.0, 0.25, 0.5, 1.0)
    ]
    assert values == pytest.approx([1.0, math.exp(-0.25), math.exp(-1), math.exp(-4)])


def test_joint_acceleration_is_taken_over_one_physics_step():
    before, after = np.zeros(12), np.eye(12)[3] * 0.01
    assert rewards.joint_accelerations(after, before, 0.005) == pytest.approx(4.0)  # (2 rad/s^2)^2


def test_the_total_is_the_sum_of_the_weighted_terms_times_the_control_step():
    terms = {"a": np.float32(2.0), "b": np.float32(-3.0)}
    reward, weighted = total(terms, {"b": 0.5, "a": 4.0}, dt=0.02)
    assert weighted == {"a": 8.0, "b": -1.5}
    assert reward == pytest.approx(0.02 * 6.5)
    assert total(terms, {"b": 0.5, "a": 4.0}, dt=0.04)[0] == pytest.approx(2 * reward)


def test_the_total_is_linear_in_each_weight(states):
    terms = shipped(states[1], 0.5)
    base = total(terms, dict.fromkeys(terms, 1.0), dt=1.0)[0]
    for name, value in terms.items():
        weights = dict.fromkeys(terms, 1.0) | {name: 3.0}
        assert total(terms, weights, dt=1.0)[0] == pytest.approx(base + 2 * value, rel=1e-5)


@pytest.fixture
def task():
    """Go1's group `task`, unlocked: weights can be added."""
    settings = config.load("configs/go1.py:laptop")
    settings.task.update(tracking_std=0.5, air_time="touchdown")
    return settings.task.unlock()


def test_a_term_is_given_what_the_names_of_its_parameters_ask_for(task, states):
    """Every weight has a term, and they are the terms of `shipped`."""
    names = dict(linear="linear_velocity", angular="angular_velocity", qd="joint_velocity")
    names |= dict(qd_before="joint_velocity_before", last_action="previous_action")
    numbers = dict(tracking_std=0.5, timestep=0.005, clearance_height=LIFT)
    for air_time, other in (("touchdown", "feet_air_time"), ("indicator", "feet_in_air")):
        task.air_time = air_time
        terms = reward_sum.terms_of(task)
        named = {name for name, weight in task.weights.items() if weight is not None}
        assert set(terms) == named and "feet_in_air" not in terms
        for state in states[:8]:
            facts = {names.get(name, name): value for name, value in state.items()}
            found = reward_sum.values(terms, facts | numbers)
            expected = by_loops(state, 0.5)
            expected["feet_air_time"] = expected[other]
            for name in set(found) & set(UNITREE):
                np.testing.assert_allclose(found[name], expected[name], rtol=1e-5, err_msg=name)


def test_a_term_is_known_without_physics_if_it_asks_for_nothing_that_is_measured(task):
    known = set(reward_sum.known(reward_sum.terms_of(task), task))
    assert known & set(UNITREE) == {
        "track_linear_velocity",
        "track_yaw_rate",
        "vertical_velocity",
        "roll_pitch_rate",
        "flat_orientation",
        "action_rate",
        "stand_still",
    }
    own = {
        "straight": lambda joint_position: 0.0,
        "high": lambda height: 0.0,
        "both": lambda gravity, torque: 0.0,
        "scaled": lambda action, kp, threshold=0.5: 0.0,
    }
    assert set(reward_sum.known(own, task)) == {"straight", "scaled"}


def test_no_two_things_that_a_term_may_ask_for_have_one_name(task):
    parts, measured = {*observe.QUANTITIES, "action"}, set(rewards.Measured._fields)
    numbers = reward_sum.known_names(task) - parts
    assert not parts & measured and not numbers & measured
    assert {"tracking_std", "kp"} <= numbers and not parts & set(task)


def wrong_weights(task, monkeypatch):
    task.weights.action_rat = -1.0


def wrong_term(task, monkeypatch):
    add(monkeypatch, "spent_power", lambda torque: 0.0)


def wrong_parameter(task, monkeypatch):
    add(monkeypatch, "spent_power", lambda torqe: 0.0)
    task.weights.spent_power = -1.0


def add(monkeypatch, name, term):
    """As if it stood in rewards.py."""
    term.__module__ = rewards.__name__
    monkeypatch.setattr(rewards, name, term, raising=False)


@pytest.mark.parametrize(
    ("break_it", "words"),
    [
        (wrong_weights, "task.weights.action_rat has no term.*has action_rate"),
        (wrong_term, "no weight of the term spent_power.*`spent_power: float = 0.0` to Weights"),
        (wrong_parameter, "spent_power .* asks for torqe, which .*did you mean torque"),
    ],
)
def test_a_term_and_a_weight_that_do_not_fit_are_one_line_before_anything_is_compiled(
    task, monkeypatch, break_it, words
):
    break_it(task, monkeypatch)
    with pytest.raises(config.ConfigError, match=words) as error:
        reward_sum.terms_of(task)
    assert "\n" not in str(error.value)
    settings = config.load("configs/go1.py:laptop").unlock()
    settings.task = task
    with pytest.raises(config.ConfigError, match=words):
        build.check(settings)


def test_a_term_that_is_no_single_number_is_named():
    with pytest.raises(
        config.ConfigError, match=r"the term power .* has the shape \(12,\).*sum it"
    ):
        reward_sum.values({"power": lambda torque: torque**2}, {"torque": np.ones(12)})


@pytest.mark.parametrize("name", WEIGHTS)
def test_weights_of_a_config_are_those_of_the_named_task(name):
    """Of the paper's variants all; of the default all but that of feet that are lifted."""
    lifted = {"foot_clearance": -0.2 if name in ("go1", "go2") else -0.15}
    for variant, own in (("ppo16", {}), ("best", lifted)):
        weights = config.load(f"{name}.py:{variant}").task.weights
        assert {term: weights[term] for term in WEIGHTS[name]} == WEIGHTS[name] | own


@pytest.mark.parametrize(
    ("name", "best"), [("go1", 45.0), ("go2", 45.0), ("anymal_c", 30.0), ("anymal_d", 30.0)]
)
def test_an_episode_of_twenty_seconds_that_tracks_perfectly_earns(name, best):
    settings = config.load(f"{name}.py:dyna4")
    dt = settings.physics.timestep * settings.physics.substeps
    command = np.array([0.4, -0.3, 0.2])
    terms = shipped(
        make_state(command=command, linear=command * [1, 1, 0], angular=command * [0, 0, 1]), 0.5
    )
    terms.pop("feet_in_air")
    reward, _ = total(terms, settings.task.weights.to_dict(), dt)
    assert settings.task.episode_length * dt == pytest.approx(20.0)
    assert settings.task.episode_length * reward == pytest.approx(best)
