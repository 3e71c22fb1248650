"""Crossings of tiles: what counts as one, by hand; their table; the config of other tiles; the command."""

import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from answers import mistake, status
from flax import struct

from dynappo import config as config_lib
from dynappo.evaluate import command, crossing, tables
from dynappo.terrain import curriculum, tiles
from dynappo.types import Env, Outcome

SPEED, DT = 1.0, 0.1  # of the robots here
# told to go, goes (degrees), falls at step, is slower by: what it counts as
TRIES = [
    (0, 0, None, 1, "crossed"),
    (0, 40, None, 1, "crossed"),
    (0, 50, None, 1, "beside"),
    (170, -160, None, 1, "crossed"),  # 30 degrees apart, over the half turn
    (0, 180, None, 1, "beside"),
    (0, 0, 10, 1, "fell"),
    (0, 0, None, 3, "late"),
    (0, 0, 60, 1, "crossed"),  # falls when it has crossed
]


@struct.dataclass
class State:
    qpos: jax.Array
    obs: jax.Array
    prop: jax.Array
    goal: jax.Array
    tile: curriculum.Tile
    number: jax.Array
    steps: jax.Array


def walkers():
    """Robots that go straight, each as one of `TRIES`: its number is the first of its key."""
    told, goes, falls, slow, _ = zip(*TRIES, strict=True)
    falls = jnp.array([999 if f is None else f for f in falls])

    def reset(hyper, body, key):
        number = jax.random.key_data(key)[-1] % len(TRIES)
        looks = jnp.radians(jnp.array(told))[number]
        goal = SimpleGoal(
            heading=looks + 1.6
        )  # which a try changes: it is told to go where it looks
        none = jnp.zeros(1)
        tile = curriculum.Tile(row=jnp.int32(number % 2), column=jnp.int32(number % 3))
        turn = [jnp.cos(looks / 2), 0.0, 0.0, jnp.sin(looks / 2)]
        start = jnp.array([5.0, -3.0, 0.3, *turn])
        return State(start, none, none, goal, tile, number, jnp.int32(0))

    def step(hyper, body, state, action, key):
        way, pace = (
            jnp.radians(jnp.array(goes))[state.number],
            DT * SPEED / jnp.array(slow)[state.number],
        )
        way += state.goal.heading - jnp.radians(jnp.array(told))[state.number]
        xy = state.qpos[:2] + pace * jnp.stack([jnp.cos(way), jnp.sin(way)])
        steps = state.steps + 1
        fell = (steps == falls[state.number]) * 1.0
        left = (((xy - jnp.array([5.0, -3.0])) ** 2).sum() > 16) * (1 - fell)
        zero = jnp.zeros(())
        outcome = Outcome(
            reward=zero, discount=1 - fell, truncation=left, next_obs=state.obs, next_prop=state.prop,
            episode_return=zero, episode_length=zero, metrics={"crossings": left},
        )  # fmt: skip
        return state.replace(qpos=state.qpos.at[:2].set(xy), steps=steps), outcome

    return Env(reset=reset, step=step, autoreset=step, obs_size=1, prop_size=1, action_size=1, dt=DT,
               episode_length=50)  # fmt: skip


@struct.dataclass
class SimpleGoal:
    heading: jax.Array


def test_a_crossing_is_a_tile_left_the_way_that_was_told_in_time_and_without_a_fall(settings):
    static, hyper = settings({"task.heading": True, "ppo.hidden": (2,)}, "configs/go1.py:dyna4")
    layer = dict(bias=jnp.zeros(2), kernel=jnp.zeros((1, 2)))
    last = dict(bias=jnp.zeros(1), kernel=jnp.zeros((2, 1)))
    params = {"actor": {"params": {"Dense_0": layer, "Dense_1": last}}, "std": jnp.ones(1)}
    found = crossing.tries(
        walkers(), hyper, params, jax.random.key(0), static=static, num_envs=64, num_steps=60
    )
    start = jax.vmap(walkers().reset, (None, None, 0))(
        hyper, None, jax.random.split(jax.random.split(jax.random.key(0), 3)[1], 64)
    )
    numbers = np.asarray(start.number)
    assert set(numbers.tolist()) == set(range(len(TRIES)))
    for number, crossed, fell in zip(numbers, found["crossed"], found["fell"], strict=True):
        outcome = TRIES[number][-1]
        assert (crossed, fell) == (outcome == "crossed", outcome == "fell"), TRIES[number]


def test_crossings_are_counted_by_kind_and_row_and_printed():
    group = SimpleNamespace(map="", rows=2, columns=3, shares=(1.0, 0.0, 1.0, 0.0, 0.0, 1.0))
    found = dict(
        row=[0, 0, 1, 1, 0], column=[0, 0, 0, 1, 2], crossed=[1, 0, 1, 0, 1], fell=[0, 1, 0, 0, 0]
    )
    counted = crossing.counted(group, {name: np.array(x) for name, x in found.items()})
    assert counted["all"] == dict(tries=5, crossed=3, fell=1)
    assert counted["kinds"] == {
        "pyramid_stairs": dict(tries=3, crossed=2, fell=1),
        "boxes": dict(tries=1, crossed=0, fell=0),
        "pit_slope": dict(tries=1, crossed=1, fell=0),
    }
    rows = tables.crossing_rows(counted)
    assert rows[0] == ["pyramid stairs", "67% of 3, falls 33%; rows 50%, 100%"]
    assert (
        rows[1] == ["boxes", "0% of 1, falls 0%; rows -, 0%"]
        and rows[-1][1] == "60% of 5, falls 20%"
    )


def test_tries_are_on_other_tiles_in_every_row_told_to_walk_ahead():
    trained = config_lib.validate(config_lib.load("configs/go2.py:rough"))
    config = crossing.on_other_ground(trained)
    before, now = trained.task.tiles, config.task.tiles
    assert (now.seed, now.start_rows) == (before.seed + 1000, 10) and now.boxes == (0.025, 0.1)
    assert (tiles.make(now).heights != tiles.make(before).heights).mean() > 0.2  # boxes and random
    assert config.task.command_x == (0.8, 0.8) and config.task.command_y == (0.0, 0.0)
    assert config.task.episode_length == 1000 and config.task.standing == 0
    flat = crossing.on_other_ground(config_lib.validate(config_lib.load("configs/go1.py:best")))
    assert flat.task.terrain == "rough" and flat.task.scan == "none"
    assert flat.task.command_yaw == (0.0, 0.0)
    slow = config_lib.load("configs/go1.py:deploy")
    slow.task.slow_commands = 0.4
    assert crossing.on_other_ground(config_lib.validate(slow)).task.slow_commands is None


def test_the_command_prints_and_writes_them(monkeypatch, tmp_path, capsys):
    counted = dict(all=dict(tries=2, crossed=1, fell=1), kinds={}, rows={})
    about = dict(tries=2, seconds=20.0, speed=0.8, impl="c", device="cpu", stairs=(0.0, 0.15))
    asked = []
    monkeypatch.setattr(crossing, "run", lambda *args: asked.append(args) or about | counted)
    assert status(command.main, "go1", "--crossing", "--episodes=2", f"--out={tmp_path}") == 0
    said = capsys.readouterr().out
    assert "50% of 2, falls 50%" in said and asked[0][1:3] == (2, 0)
    assert "rows from the easiest to the hardest, stairs of 0 to 0.15 m a step; -: no try" in said
    assert json.loads((tmp_path / "crossing.json").read_text())["all"]["crossed"] == 1
    assert "--crossing: expected no --stress" in mistake(
        command.main, ["go1", "--crossing", "--stress"], capsys
    )


@pytest.mark.slow
def test_the_bundled_go1_crosses_easy_slopes_and_no_hard_stairs():
    from dynappo.policy import policy_source

    numbers = crossing.run(policy_source.load("go1")[0], 60)
    kinds = numbers["kinds"]
    assert kinds["pyramid_slope"]["crossed"] > 0.8 * kinds["pyramid_slope"]["tries"]
    assert not any(row["crossed"] for row in numbers["rows"]["pit_stairs"][5:])
