"""The velocity task on rough ground: starts, curriculum, what is observed, and tails that know the ground.

Go2 in C MuJoCo on 3 x 6 small tiles. What is observed is compared with loops over points in plain Python,
with MuJoCo's own kinematics; tails with the rows of physics.
"""

import math
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from ml_collections import ConfigDict

from dynappo import config as config_lib
from dynappo.description import contacts, motors
from dynappo.description import robot as robot_lib
from dynappo.learner import symmetry
from dynappo.physics import ground as ground_lib
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import mirror, surroundings, view
from dynappo.terrain import curriculum, scan, tiles
from dynappo.terrain.height_map import HeightMap

ROBOTS, STEPS, FEET, PROP = 12, 12, 4, 33
FIELDS = {
    "task.terrain": "rough",
    "task.scan": "grid",
    "task.heading": True,
    "task.standing": 0.2,
    "task.observation": "onboard",
    "task.history": 2,
    "task.carry_on": False,
    "task.random_clock": False,
    "task.episode_length": 500,
    "task.noise.scan_shift": 0.05,
    "task.noise.scan_lift": 0.02,
    "task.tiles.rows": 3,
    "task.tiles.columns": 6,
    "task.tiles.start_rows": 2,
    "task.tiles.shares": (1.0,) * 6,
    "task.reset.velocity": 0.5,
    "ppo.critic": "state",
    "physics.impl": "c",
    "physics.threads": 1,
}


def configured(**fields):
    config = config_lib.load("configs/go2.py:best")
    for name, value in (FIELDS | fields).items():
        config_lib.override(config, name, str(value))
    return config_lib.validate(config)


@pytest.fixture(scope="module")
def world():
    """Rows of robots that fall to the ground, under random actions and without noise, and no resets."""
    config, robot = motors.fitted(configured(), robot_lib.load("go2"))
    hyper = config_lib.split(config)[1]
    still = jax.tree.map(lambda x: 0.0, hyper.task.noise)
    still = still._replace(scan_shift=0.05, scan_lift=0.02)
    hyper = hyper._replace(task=hyper.task._replace(noise=still))
    env = env_lib.make(robot, config.task, config.physics, impl="c")
    keys = jax.random.split(jax.random.key(0), ROBOTS)
    body = jax.jit(jax.vmap(env.randomize, (None, 0)))(hyper, keys)
    state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(hyper, body, keys)
    step = jax.jit(jax.vmap(partial(env.step, hyper)))
    actions = np.random.default_rng(0).normal(0, 0.3, (STEPS, ROBOTS, 12)).astype(np.float32)
    states, outcomes = [jax.device_get(state)], []
    for t in range(STEPS):
        state, outcome = step(body, state, actions[t], jax.random.split(jax.random.key(t), ROBOTS))
        states.append(jax.device_get(state))
        outcomes.append(jax.device_get(outcome))
    ground = tiles.make(config.task.tiles)
    around = surroundings.make(robot, config.task, config.physics, ground)
    first = env.obs_size - surroundings.size(around)
    return SimpleNamespace(
        config=config, robot=robot, hyper=hyper, env=env, body=body, step=step, states=states,
        outcomes=outcomes, actions=actions, ground=ground, around=around, first=first,
        again=jax.jit(jax.vmap(partial(env.autoreset, hyper))),
        where=surroundings.places(around),
    )  # fmt: skip


def height(ground, x, y):
    """The height at a point, of the two triangles of its cell."""
    heights, cell, corner = ground
    u = min(max((x - corner[0]) / cell, 0), heights.shape[0] - 1)
    v = min(max((y - corner[1]) / cell, 0), heights.shape[1] - 1)
    i, j = min(int(u), heights.shape[0] - 2), min(int(v), heights.shape[1] - 2)
    u, v = u - i, v - j
    h00, h10 = float(heights[i, j]), float(heights[i + 1, j])
    h01, h11 = float(heights[i, j + 1]), float(heights[i + 1, j + 1])
    if u >= v:
        return h00 + u * (h10 - h00) + v * (h11 - h10)
    return h00 + v * (h01 - h00) + u * (h11 - h01)


def posed(robot, qpos):
    """MuJoCo's data of a robot, its kinematics computed."""
    data = mujoco.MjData(robot.mj_model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(robot.mj_model, data)
    return data


def yaw_of(qpos):
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, np.asarray(qpos[3:7], float))
    return math.atan2(turn[3], turn[0])


def by_loops(world, state, i):
    """The parts of robot `i`'s surroundings, by name."""
    qpos, qvel = np.asarray(state.qpos[i], float), np.asarray(state.qvel[i], float)
    yaw, later = yaw_of(qpos), qpos.copy()
    mujoco.mj_integratePos(world.robot.mj_model, later, qvel, 1e-6)
    shift, (c, s) = state.scan_shift[i], (math.cos(yaw), math.sin(yaw))

    def above(z, x, y):
        return min(max(z - height(world.ground, x, y), -1), 1)

    feet, data = [], posed(world.robot, qpos)
    for geom in world.robot.feet:
        x, y, z = data.geom_xpos[geom]
        for dx, dy in ((0, 0), (0.1, 0), (-0.1, 0), (0, 0.1), (0, -0.1)):
            feet.append(above(z, x + c * dx - s * dy, y + s * dx + c * dy))
    points = []
    for a in range(17):
        for b in range(11):
            dx, dy = (a - 8) * 0.1 + shift[0], (b - 5) * 0.1 + shift[1]
            x, y = qpos[0] + c * dx - s * dy, qpos[1] + s * dx + c * dy
            points.append(above(qpos[2] - 0.5 + shift[2], x, y))
    return dict(
        pose=[*qpos[:3], yaw],
        rate=[*qvel[:3], (yaw_of(later) - yaw) / 1e-6],
        goal=[state.goal.heading[i], state.goal.standing[i]],
        shift=shift,
        feet=feet,
        scan=points,
    )


@pytest.mark.parametrize("t", [0, 4, STEPS])
def test_an_observation_ends_with_where_the_robot_is_and_the_ground_there(world, t):
    state = world.states[t]
    for i in range(ROBOTS):
        seen = state.obs[i, world.first :]
        for name, expected in by_loops(world, state, i).items():
            np.testing.assert_allclose(
                seen[world.where[name]],
                expected,
                atol=2e-3 if name == "rate" else 1e-4,
                err_msg=name,
            )


def test_a_robot_starts_in_the_middle_of_its_tile_with_its_feet_above_the_ground(world):
    state, middles = world.states[0], tiles.centres(world.config.task.tiles)
    assert set(state.tile.row.tolist()) == {0, 1} and len(set(state.tile.column.tolist())) > 3
    for i in range(ROBOTS):
        middle = middles[state.tile.row[i], state.tile.column[i]]
        assert abs(state.qpos[i, :2] - middle).max() <= 0.5
        data = posed(world.robot, state.qpos[i])
        feet = data.geom_xpos[world.robot.feet]
        radius = world.robot.mj_model.geom_size[world.robot.feet[0], 0]
        lowest = min(z - radius - height(world.ground, x, y) for x, y, z in feet)
        assert 0.009 < lowest < 0.2


def test_a_tail_knows_where_the_robot_is_and_the_ground_there(world):
    """`Env.advance` again and again from the first row, with the props that physics had."""
    advance = jax.jit(jax.vmap(partial(world.env.advance, world.hyper)))
    context = world.states[0].obs[:, PROP:]
    for t in range(STEPS):
        before, outcome = world.states[t], world.outcomes[t]
        context = advance(context, before.obs[:, :PROP], world.actions[t], outcome.next_prop)
        found, true = context, outcome.next_obs[:, PROP:]
        off = abs(np.asarray(found - true))
        start = world.first - PROP
        pose = off[:, start:][:, world.where["pose"]]
        # in the air to rounding; with half of the change in a step instead of 5/8, ten times as much
        free = (world.states[t + 1].contact_steps == 0).all(-1)
        assert pose[free, :3].max(initial=0) < 1e-4 and (free.sum() > 3 or t > 3)
        assert pose[:, :3].max() < 3e-3 and pose[:, 3].max() < 5e-3
        assert off[:, start:][:, world.where["goal"]].max() == 0
        assert off[:, start:][:, world.where["shift"]].max() == 0
        for part in ("feet", "scan"):
            assert np.quantile(off[:, start:][:, world.where[part]], 0.95) < 3e-3, part
        assert off[:, :3].max() < 4e-3  # the command: its yaw rate turns to the heading
        # the readings before have the command, too
        np.testing.assert_allclose(found[:, 3:start], true[:, 3:start], atol=4e-3)
    turned = abs(world.states[-1].command[:, 2] - world.states[0].command[:, 2])
    assert turned.max() > 0.02  # so that a command which is kept would have shown


def test_leaving_a_tile_ends_the_episode_as_the_time_does_and_the_next_is_a_row_harder(world):
    state = jax.tree.map(jnp.asarray, world.states[0])
    middles = tiles.centres(world.config.task.tiles)[state.tile.row, state.tile.column]
    away = np.linspace(3.7, 4.3, ROBOTS)  # m; the tile's half is 4
    at = middles + np.stack([away, 0 * away], -1)
    ground = [height(world.ground, x, y) for x, y in at]
    place = np.concatenate([at, np.reshape(ground, (-1, 1)) + 0.6], 1)
    state = state.replace(
        qpos=state.qpos.at[:, :3].set(place), qvel=0 * state.qvel, command=0 * state.command
    )
    keys = jax.random.split(jax.random.key(5), ROBOTS)
    after, outcome = world.step(world.body, state, world.actions[0], keys)
    left = away > 4
    np.testing.assert_array_equal(outcome.truncation, left)
    np.testing.assert_array_equal(outcome.discount, 1)
    assert outcome.metrics["crossings"].tolist() == left.tolist()
    fresh = world.again(world.body, after, outcome, keys)
    np.testing.assert_array_equal(fresh.tile.row, np.asarray(state.tile.row) + left)
    np.testing.assert_array_equal(fresh.tile.column, state.tile.column)
    where = tiles.centres(world.config.task.tiles)[fresh.tile.row, fresh.tile.column]
    assert (abs(fresh.qpos[:, :2] - where).max(-1) <= 0.5).tolist() == left.tolist()
    for row in range(3):
        np.testing.assert_array_equal(outcome.metrics[f"terrain_row_{row}"], state.tile.row == row)


@pytest.mark.parametrize("climb", [1, 2])
def test_the_curriculum_is_isaac_labs_rule(climb):
    """But for `climb`, how many rows harder."""
    t, rng = configured(**{"task.tiles.climb": climb}).task.tiles, np.random.default_rng(0)
    move = jax.jit(partial(curriculum.move, t))
    for row, walked, asked in [
        (r, w, a) for r in range(3) for w in (0.5, 3, 5) for a in (0, 3, 12)
    ]:
        rows = set()
        for draw in rng.uniform(0, 1, 20):
            tile = curriculum.Tile(row=jnp.int32(row), column=jnp.int32(4))
            moved = move(tile, jnp.float32(walked), jnp.float32(asked), jnp.float32(draw))
            assert moved.column == 4
            rows.add(int(moved.row))
        if walked > 4:
            assert rows == ({row + climb} if row + climb <= 2 else {0, 1, 2})
        elif walked < asked / 2:
            assert rows == {max(0, row - 1)}
        else:
            assert rows == {row}


def test_each_network_sees_its_part_of_the_surroundings(world):
    where = {name: world.first + np.arange(p.start, p.stop) for name, p in world.where.items()}
    actor, critic, model = (set(columns.tolist()) for columns in world.env.views)
    for name, seen in dict(
        pose=(0, 0, 0),
        rate=(0, 0, 0),
        goal=(0, 0, 0),
        shift=(0, 0, 0),
        feet=(0, 1, 1),
        scan=(1, 1, 0),
    ).items():
        columns = set(where[name].tolist())
        assert [columns <= each for each in (actor, critic, model)] == [bool(x) for x in seen], name
        assert not any(
            columns & each for each, x in zip((actor, critic, model), seen, strict=True) if not x
        )
    assert len(world.env.views.actor) == 45 * 2 + 187
    blind = world.around._replace(tail="blind")
    assert len(surroundings.columns(blind, "model")) == 0
    np.testing.assert_array_equal(
        surroundings.columns(blind, "critic"), surroundings.columns(world.around, "critic")
    )


def test_a_frozen_ground_stays_as_it_was_in_the_first_row_of_a_tail(world):
    frozen = world.around._replace(tail="frozen")
    before, after = world.states[0], world.outcomes[0]
    old = jnp.asarray(before.obs[0, world.first :])
    new = surroundings.advance(frozen, old, jnp.asarray(after.next_prop[0]))
    for name, where in world.where.items():
        same = np.array_equal(new[where], old[where])
        assert same == (name not in ("pose", "rate")), name


def test_each_control_of_the_ground_in_a_tail_is_without_one_thing(world):
    """Of three: that a tail ends where a part is in the ground, that feet and scan move on, that the model
    sees the feet's part."""
    old, after = jnp.asarray(world.states[0].obs[0, world.first :]), world.outcomes[0].next_prop[0]
    without = {"known": None, "no_end": "end", "frozen": "moves", "blind": "sees"}
    for control, what in without.items():
        config = configured(**{"task.ground_in_tail": control})
        env = env_lib.make(world.robot, config.task, config.physics, impl="c")
        fatal, _ = env_lib.ground_rules(world.robot, config.task)
        around = surroundings.make(world.robot, config.task, config.physics, world.ground, fatal)
        new = surroundings.advance(around, old, jnp.asarray(after))
        found = {
            "end": env.known_end is not None,
            "moves": not np.array_equal(new[world.where["scan"]], old[world.where["scan"]]),
            "sees": len(surroundings.columns(around, "model")) > 0,
        }
        assert found == {name: name != what for name in found}, control


def test_noise_is_on_the_scan_alone_and_some_points_are_missing(world):
    noise = world.hyper.task.noise._replace(scan=0.1, scan_dropout=0.3)
    hyper = world.hyper._replace(task=world.hyper.task._replace(noise=noise))
    context = jnp.asarray(world.states[0].obs[:, PROP:])
    keys = jax.random.split(jax.random.key(1), ROBOTS)
    sensed = np.asarray(jax.vmap(partial(world.env.sense_context, hyper))(context, keys))
    exact, start = np.asarray(context), world.first - PROP + world.where["scan"].start
    np.testing.assert_array_equal(sensed[:, :start], exact[:, :start])
    missing = sensed[:, start:] == 0
    assert abs(missing.mean() - 0.3) < 0.03
    off = (sensed - exact)[:, start:][~missing]
    assert -0.1 <= off.min() < -0.095 and 0.095 < off.max() <= 0.1 and abs(off.mean()) < 0.005


def test_the_mirror_image_is_what_a_mirrored_robot_sees_on_a_mirrored_ground(world):
    rng = np.random.default_rng(3)
    half = rng.uniform(0, 0.3, (60, 30)).astype(np.float32)
    heights = np.concatenate([half, half[:, -2::-1]], 1)  # about y = 0
    middle = np.float32(0.1 * (heights.shape[1] - 1) / 2)
    layout = view.make("full", 1, 12, around=world.around._replace(
        ground=HeightMap(heights, 0.1, (-3.0, -float(middle))), scan=True, heading=False))  # fmt: skip
    _, action = mirror.images(world.robot, layout)
    image, _ = mirror.images(world.robot, layout)
    qpos = np.concatenate([[0.2, 0.35, 0.5], [0.95, 0.1, -0.05, 0.28], world.robot.default_pose])
    qpos[3:7] /= np.linalg.norm(qpos[3:7])
    qpos[7:] += rng.normal(0, 0.2, 12)
    qvel = rng.normal(0, 1, 18)
    other, speed = qpos.copy(), qvel.copy()
    other[[1, 4, 6]] *= -1  # y, and rotations about x and z
    other[7:] = symmetry.vector(action, qpos[7:])
    # the triangles of a cell are not symmetric; on the grid's lines the heights are
    exact = jax.jit(lambda *pair: surroundings.exact(layout.around, *pair, None, jnp.zeros(3)))
    seen = [np.asarray(exact(*pair)) for pair in ((qpos, qvel), (other, speed))]
    size = view.own_size(layout)
    mirrored = symmetry.vector(image, np.concatenate([np.zeros(size), seen[0]]))[size:]
    where = surroundings.places(layout.around)
    for name in ("feet", "scan"):
        off = abs(mirrored - seen[1])[where[name]]
        assert np.median(off) < 0.03 and off.max() < 0.35, name  # the other triangle
        plain = abs(seen[0] - seen[1])[where[name]]
        assert np.median(plain) > 2 * np.median(off), name


def test_points_of_the_scan_are_isaac_labs():
    points = scan.points()
    assert points.shape == (187, 2) and abs(points).max(0).tolist() == [0.8, 0.5]
    np.testing.assert_allclose(points[scan.mirror()] * [1, -1], points, atol=1e-12)


def test_a_tail_knows_where_a_part_is_in_the_ground(world):
    """Robots lowered into the ground by up to 0.4 m, against MuJoCo's kinematics: the probes of
    every part that ends an episode."""
    robot, config = world.robot, ConfigDict(world.config)
    fatal, _ = env_lib.ground_rules(robot, config.task)
    around = surroundings.make(robot, config.task, config.physics, world.ground, fatal)
    model, rng = robot.mj_model, np.random.default_rng(3)
    parts = robot.parts[fatal]
    probes = contacts.probes(model, parts)
    poses, touched, state = [], [], world.states[0]
    for k in range(4 * ROBOTS):
        qpos = np.array(state.qpos[k % ROBOTS], float)
        qpos[2] -= rng.uniform(0, 0.4)
        qpos[3:7] += rng.normal(0, 0.1, 4)
        qpos[3:7] /= np.linalg.norm(qpos[3:7])
        qpos[7:] += rng.normal(0, 0.2, 12)
        data = posed(robot, qpos)
        turn = data.geom_xmat[parts].reshape(-1, 3, 3)
        above = ground_lib.parts_above(probes, world.ground, data.geom_xpos[parts], turn)
        touched.append((above < 0).any())
        gravity = data.xmat[robot.base_body].reshape(3, 3).T @ [0, 0, -1.0]
        joints = qpos[7:] - robot.default_pose
        poses.append((qpos, np.concatenate([joints, np.zeros(12), gravity, np.zeros(6)])))
    goal, shift = jax.tree.map(lambda x: x[0], (state.goal, state.scan_shift))

    def touches(qpos, prop):
        numbers = surroundings.exact(around, qpos, jnp.zeros(18), goal, shift)
        return surroundings.touches(around, numbers, prop)

    found = jax.jit(jax.vmap(touches))(
        *(jnp.float32(np.stack(x)) for x in zip(*poses, strict=True))
    )
    assert 5 < sum(touched) < len(touched) - 5
    np.testing.assert_array_equal(found, touched)
