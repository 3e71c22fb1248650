"""The velocity task as an `Env`: `make(robot, task, physics)`; all functions are of one robot.

It follows Isaac Lab's flat velocity tasks and the paper. Where they differ, `task.formulation` chooses
(configs/README.md). Order inside a control step
(isaaclab/envs/manager_based_rl_env.py): action, four physics steps with the actuator model in each,
terminations, rewards, command, push, observation. `autoreset` does the reset.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dynappo.description import kinematics
from dynappo.description import robot as robot_lib
from dynappo.physics import engine as engine_lib
from dynappo.physics import ground, randomize
from dynappo.physics.ground import check_tiles, of_tiles
from dynappo.tasks.velocity import (
    clearance,
    commands,
    gait,
    mirror,
    observe,
    own,
    pushes,
    reward_sum,
    rewards,
    surroundings,
    view,
)
from dynappo.tasks.velocity.state import Gait, Goal, State
from dynappo.terrain import curriculum, scan, tiles
from dynappo.terrain.height_map import HeightMap
from dynappo.types import Env, Hyper, Outcome

AGES = ("clock", "episode_steps", "episode_return")  # zero at the start of an episode
# what the next state takes from physics as it is, beside coordinates and torques
FROM_PHYSICS = "qacc_warmstart air_steps contact_steps last_air_steps peak last_peak".split()
MIDDLE = 0.005  # m: a foot that is closer to the middle plane is neither left nor right
MAX_TURN, MAX_BASE_SPEED = 100.0, 20.0  # rad/s, m/s: above these it is a numerical blow-up


class FeetGeometry(NamedTuple):
    """What `rewards.Feet` is computed from."""

    middles: kinematics.Legs  # [F] points
    side: np.ndarray  # [F] as in rewards.Feet
    base_com: np.ndarray  # [3] m, the base's centre of mass, base frame


class Constants(NamedTuple):
    """What the task's functions need of robot, task and engine; constants of the program."""

    engine: engine_lib.Engine
    robot: robot_lib.Robot
    task: Any  # the config's group `task`, for its non-float fields
    legs: kinematics.Legs
    feet: FeetGeometry | None  # None: no term asks for them
    fatal: np.ndarray  # [G] bool: the parts that end an episode at the ground
    undesired: np.ndarray  # [K, G] bool: the parts that count as one undesired contact
    view: view.View  # the layout of an observation
    ground: HeightMap | None  # None: flat
    centres: np.ndarray | None  # [rows, columns, 2] m, of the ground's tiles
    terms: reward_sum.Terms  # of the reward
    known: reward_sum.Terms  # those that need no physics
    dt: float  # s


def make(
    robot: robot_lib.Robot,
    task,
    physics_config,
    *,
    impl: str = "jax",
    ground: HeightMap | None = None,
) -> Env:
    """The task of `task` and `physics_config` (config groups) on `robot`, stepped by `impl`.

    With `task.terrain` "rough" it is on the ground of `task.tiles`, or on a `ground` of one's own, whose
    tiles are where that group says.

    ConfigError where a tile is not on that ground, where terms of the reward and their weights do not fit
    (reward_sum.py), or a gait clock the robot's feet.
    """
    gait.check(task.gait_frequency, robot.name, len(robot.foot_names))
    dt = physics_config.substeps * physics_config.timestep
    of_own = own.make(task, len(robot.joint_names), dt)
    terms = reward_sum.terms_of(task)
    varied = randomize.varied(task.randomize)
    fatal, undesired = ground_rules(robot, task)
    joints = len(robot.joint_names)
    around = None
    if task.terrain == "flat":
        ground = None
    else:
        if ground is None:
            ground = of_tiles(task.tiles)
        else:
            check_tiles(task.tiles, ground)
        around = surroundings.make(robot, task, physics_config, ground, fatal)
    clock = task.gait_frequency is not None
    layout = view.make(task.observation, task.history, joints, varied, clock, around, of_own)
    const = Constants(
        engine=engine_lib.make(
            robot,
            physics_config,
            varied=varied,
            impl=impl,
            every_substep=task.remember_ground,
            lags=task.actuator == "lag",
            has_friction=bool(np.any(task.joint_friction)),
            ground=ground,
        ),
        robot=robot,
        task=task,
        legs=kinematics.legs(robot.mj_model, robot.feet),
        feet=feet_of(robot, terms | {n: t.function for n, t in of_own.terms.terminations.items()}),
        fatal=fatal,
        undesired=undesired,
        view=layout,
        ground=ground,
        centres=None if ground is None else tiles.centres(task.tiles),
        terms=terms,
        known=reward_sum.known(terms, task),
        dt=dt,
    )
    names = [f"reward_{name}" for name in terms]
    if task.fall_reward is not None:
        names.append("reward_fall")
    names += ["velocity_error_sq", "yaw_error_sq", "falls", "timeouts", "blowups"]
    if ground is not None:
        names += ["crossings", "terrain_row"]
        names += [f"terrain_row_{row}" for row in range(task.tiles.rows)]
    names += [f"ended_{name}" for name in of_own.terms.terminations]
    names += [f"curriculum_{name}" for name in of_own.terms.curricula]
    ramp = task.clearance_ramp is not None
    if ramp:
        names.append("curriculum_clearance_share")
    return Env(
        randomize=partial(_randomize, const),
        reset=partial(reset, const),
        step=partial(step, const),
        autoreset=partial(autoreset, const),
        advance=partial(view.advance, layout),
        sense=partial(view.sense, layout),
        sense_context=(
            partial(view.sense_context, layout)
            if around is not None and around.scan and around.tail != "frozen"
            else None
        ),
        views=view.views(layout),
        known_reward=partial(known_reward, const),
        known_end=None if around is None or around.parts is None else partial(known_end, const),
        # a heading, and the phase of a gait clock, follow from more than the command
        retell=None if around is not None or task.heading or clock else partial(retell, const),
        fall_reward=None if task.fall_reward is None else lambda hyper: hyper.task.fall_reward,
        metrics=tuple(names),
        obs_size=view.size(layout),
        prop_size=view.prop_size(layout),
        action_size=joints,
        dt=const.dt,
        episode_length=task.episode_length,
        mirror=mirror.images(robot, layout),
        input_scale=view.scale(layout),
        evaluated=partial(_evaluated, of_own) if of_own.terms.curricula or ramp else None,
    )


def ground_rules(robot: robot_lib.Robot, task) -> tuple[np.ndarray, np.ndarray]:
    """`(fatal [G], undesired [K, G])`: what `task.termination` and `task.undesired` mean here.

    The paper: any part at the ground is a fall, and each part counts. Isaac Lab: only the base at the ground
    is a fall, and each thigh counts. A thigh is the links that a leg's joints move after the first, but the
    foot's own; without such a link, the first.
    """
    model = robot.mj_model
    bodies = model.geom_bodyid[robot.parts]
    every = task.termination == "parts"
    fatal = (bodies == robot.base_body) | every
    if task.undesired == "parts":
        return fatal, np.eye(len(bodies), dtype=bool)
    thighs: list[int] = []
    for foot in range(len(robot.foot_names)):
        own = model.geom_bodyid[robot.feet[robot.foot_of == foot][0]]
        links = [int(model.jnt_bodyid[1 + j]) for j in kinematics.joints_to(model, own)]
        between = [body for body in links[1:] if body != links[-1]] or links[:1]
        thighs += between
    return fatal, bodies == np.array(list(dict.fromkeys(thighs)))[:, None]


def feet_of(robot: robot_lib.Robot, terms: reward_sum.Terms) -> FeetGeometry | None:
    """What `rewards.Feet` of this robot is computed from, if one of `terms` asks for it."""
    asked = {name for term in terms.values() for name in reward_sum.parameters(term)}
    if not asked & set(rewards.Feet._fields):
        return None
    middles = kinematics.middles(robot.mj_model, robot.feet, robot.foot_of)
    left = kinematics.feet_in_base(middles, robot.default_pose)[:, 1]
    side = np.sign(np.where(abs(left) < MIDDLE, 0.0, left))
    return FeetGeometry(middles, side, robot.mj_model.body_ipos[robot.base_body])


def _randomize(const: Constants, hyper: Hyper, key):
    base = const.robot.base_body
    model = const.robot.mj_model
    ranges, varied = hyper.task.randomize, const.engine.varied
    nominal = model.body_mass[base], model.body_ipos[base]
    return randomize.draw(ranges, *nominal, key, varied, len(const.robot.joint_names))


def reset(const: Constants, hyper: Hyper, body, key) -> State:
    """A robot at the start of an episode; with `task.random_clock`, at a random age of it."""
    key, clock_key = jax.random.split(key)
    tile = None
    if const.ground is not None:
        key, tile_key = jax.random.split(key)
        tile = curriculum.start(const.task.tiles, jax.random.uniform(tile_key, (2,)))
    pose_key, command_key, obs_key = jax.random.split(key, 3)
    state = _at_start(const, hyper, pose_key, tile)
    state = _commanded(const, hyper, body, state, command_key, obs_key)
    if not const.task.random_clock:
        return state
    clock = jax.random.randint(clock_key, (), 0, const.task.episode_length)
    return state.replace(clock=clock.astype(jnp.int32))


def autoreset(const: Constants, hyper: Hyper, body, state: State, outcome: Outcome, key) -> State:
    """`state`, or the start of a new episode if `outcome` ended one.

    With `task.carry_on` an episode that a timeout ends is followed by one that starts anew with
    probability `task.start_anew`, else where the robot is: under the same command with probability
    `task.keep_command`, else under a new one. Without new commands a policy never sees one change: the
    bundled Go1 fell at every fourth change (C MuJoCo). Without the same command it follows none for
    longer than an episode of training.
    """
    ended = (outcome.discount == 0) | (outcome.truncation == 1)
    if const.task.carry_on:
        key, coin_key = jax.random.split(key)
    tile = None
    if const.ground is not None:
        key, tile_key = jax.random.split(key)
        tile = _next_tile(const, state, jax.random.uniform(tile_key))
    pose_key, command_key, obs_key = jax.random.split(key, 3)
    start, stays, same = _at_start(const, hyper, pose_key, tile), None, None
    mine = const.view.own
    if const.task.carry_on:
        coin = jnp.where(outcome.truncation == 1, jax.random.uniform(coin_key), 1.0)
        stays, same = coin < 1 - hyper.task.start_anew, coin < hyper.task.keep_command
        here = state.replace(**dict.fromkeys(AGES, 0))
        start = jax.tree.map(lambda here, there: jnp.where(stays, here, there), here, start)
    if mine.terms.curricula:
        episode = own.Ended(
            episode_return=state.episode_return,
            episode_steps=state.episode_steps,
            fell=outcome.discount == 0,
            timed_out=outcome.truncation == 1,
        )
        facts = own.numbers(hyper) | {"command": state.command} | episode._asdict()
        start = start.replace(own=start.own | own.levels(mine, state.own, facts))
    share = clearance.after(hyper, state.clearance, outcome.discount == 0)
    start = start.replace(clearance=share)
    fresh = _commanded(const, hyper, body, start, command_key, obs_key, same)
    # Keep the history of robots that stay. (Without the `if`, XLA 0.10 drops C MuJoCo's call.)
    if stays is not None and const.view.history > 1:
        size, end = view.current_size(const.view), view.own_size(const.view)
        before = jnp.where(stays, state.obs[size:end], fresh.obs[size:end])
        after = [] if const.ground is None else [fresh.obs[end:]]
        fresh = fresh.replace(obs=jnp.concatenate([fresh.obs[:size], before, *after]))
    return jax.tree.map(lambda new, old: jnp.where(ended, new, old), fresh, state)


def _commanded(
    const: Constants, hyper: Hyper, body, state: State, command_key, obs_key, same=None
) -> State:
    """`state` with a new command, unless it keeps the `same`, and the observation of both."""
    sample = own.sampler(const.view.own, own.numbers(hyper), state.own or {})
    told = commands.draw(const.task, hyper, state.qpos, command_key, sample)
    if same is not None:
        has = state.command, state.goal
        told = jax.tree.map(lambda old, new: jnp.where(same, old, new), has, told)
    state = state.replace(command=told[0], goal=told[1])
    prop, obs = view.observation(const.view, const.robot, hyper, body, state, None, obs_key)
    return state.replace(prop=prop, obs=obs)


def retell(const: Constants, hyper: Hyper, context, key):
    """The context of an observation, which begins with the command, under a new one."""
    mine, sample = const.view.own, None
    if mine.terms.command is not None:
        known = context[: view.current_size(const.view) - view.prop_size(const.view)]
        before = observe.split_context(known, const.view.joints, const.view.clock, mine.seen)
        sample = own.sampler(mine, own.numbers(hyper), before)
    command, _ = commands.draw(const.task, hyper, None, key, sample)
    return context.at[: command.size].set(command)


def _next_tile(const: Constants, state: State, draw) -> curriculum.Tile:
    """The tile of a robot that starts anew after `state`."""
    walked = _from_centre(const, state.tile, state.qpos[:2])
    speed = jnp.sqrt((state.command[:2] ** 2).sum())
    asked = speed * const.task.episode_length * const.dt
    return curriculum.move(const.task.tiles, state.tile, walked, asked, draw)


def _centre(const: Constants, tile: curriculum.Tile):
    """World x and y (m) of the middle of a tile."""
    return jnp.asarray(const.centres, jnp.float32)[tile.row, tile.column]


def _from_centre(const: Constants, tile: curriculum.Tile, xy):
    """m from the middle of a tile."""
    return jnp.sqrt(((xy - _centre(const, tile)) ** 2).sum())


def _at_start(const: Constants, hyper: Hyper, key, tile: curriculum.Tile | None) -> State:
    """Pose and velocity (configs/README.md), lifted until no foot is below ground; then `_commanded`."""
    r, default = hyper.task.reset, jnp.asarray(const.robot.default_pose, jnp.float32)
    # one draw for all: each draw is a kernel of its own, and a quarter of a second of compilation
    around = const.view.around
    has_scan = around is not None and around.scan
    count = default.size + 10 + 2 * const.view.clock
    draw = jax.random.uniform(key, (count + 3 * has_scan,))
    draw, shift = (draw[:count], draw[count:]) if has_scan else (draw, None)
    scale, xy, velocity, yaw, rest = jnp.split(draw, default.size + np.array([0, 2, 8, 9]))
    low, high = r.joint_scale
    joints = default * (low + (high - low) * scale)
    joints = jnp.clip(joints, *soft_limits(const.robot, hyper))
    lowest = kinematics.lowest(const.legs, joints)
    above = jnp.maximum(r.spawn_height, r.foot_clearance - lowest)
    xy = (2 * xy - 1) * r.position
    yaw = (2 * yaw[0] - 1) * r.yaw
    if tile is None:
        height = ground.world_height(above, lambda: xy)
    else:
        xy = xy + _centre(const, tile)
        # over the highest ground that is below the base or a foot
        feet = scan.turned(kinematics.feet_in_base(const.legs, joints)[:, :2], yaw)
        below = jnp.concatenate([xy[None], xy + feet])
        height = ground.world_height(above, lambda: below, const.ground).max()
    velocity = (2 * velocity - 1) * r.velocity
    quat = jnp.stack([jnp.cos(yaw / 2), yaw * 0, yaw * 0, jnp.sin(yaw / 2)])
    qpos = jnp.concatenate([xy, height[None], quat, joints])
    qvel = jnp.concatenate([velocity, default * 0])
    feet, none = jnp.zeros(len(const.robot.foot_names), jnp.int32), jnp.zeros((), jnp.int32)
    return State(
        qpos=qpos,
        qvel=qvel,
        qacc_warmstart=jnp.zeros_like(qvel),
        obs=jnp.zeros(()),
        prop=jnp.zeros(()),
        command=jnp.zeros(3),
        goal=Goal(heading=jnp.zeros(()), standing=jnp.zeros(()), steps_left=none),
        gait=_gait(const, hyper, rest),
        last_action=default * 0,
        older_action=default * 0,
        torque=default * 0 if const.engine.lags else None,
        air_steps=feet,
        contact_steps=feet,
        last_air_steps=feet,
        peak=jnp.zeros(len(const.robot.foot_names)),
        last_peak=jnp.zeros(len(const.robot.foot_names)),
        clock=none,
        episode_steps=none,
        push_in=pushes.wait(hyper.task.push, const.dt, rest[0]),
        episode_return=jnp.zeros(()),
        tile=tile,
        scan_shift=surroundings.draw_shift(hyper, shift) if has_scan else None,
        clearance=clearance.start(hyper),
        own=own.starts(const.view.own, own.numbers(hyper), jnp),
    )


def _evaluated(of_own: own.Own, hyper: Hyper) -> Hyper:
    """The floats of an evaluation: curricula where they end."""
    return clearance.whole(own.evaluated(of_own, hyper) if of_own.terms.curricula else hyper)


def _gait(const: Constants, hyper: Hyper, draws) -> Gait | None:
    """A gait clock that starts anew, of the last two draws; None where there is none."""
    if not const.view.clock:
        return None
    angle, turn = gait.start(hyper.task.gait_frequency, const.dt, draws[-2:])
    return Gait(angle=angle, turn=turn)


def soft_limits(robot: robot_lib.Robot, hyper: Hyper):
    """`(low, high)` [A] rad: the middle `task.reset.soft_limit` of each joint's range, if it has one."""
    low, high = jnp.asarray(robot.mj_model.jnt_range[1:].T, jnp.float32)
    spare = (1 - hyper.task.reset.soft_limit) / 2 * (high - low)
    low, high = low + spare, high - spare
    free = ~np.isfinite(robot_lib.joint_ranges(robot)[:, 0])
    if free.any():
        low, high = jnp.where(free, -jnp.inf, low), jnp.where(free, jnp.inf, high)
    return low, high


def over_limit(robot: robot_lib.Robot, hyper: Hyper, joints):
    """rad by which `joints` [A] are beyond their `soft_limits`."""
    low, high = soft_limits(robot, hyper)
    return jnp.maximum(jnp.maximum(low - joints, joints - high), 0)


def step(const: Constants, hyper: Hyper, body, state: State, action, key):
    """One control step -> `(State, Outcome)`; the episode's end is in the outcome only.

    If a robot's state is not finite, or a joint or the base is faster than 100 rad/s or 20 m/s, the
    solver has failed: the episode ends with reward 0, but for `task.fall_reward`, and counts in `blowups`,
    and the row has only zeros and the old observation.
    """
    after = engine_lib.simulate(const.engine, hyper, body, state, action)
    speed = jnp.abs(jnp.concatenate([after.qvel, after.qd_before]))
    ok = jnp.isfinite(after.qpos).all() & jnp.isfinite(after.qacc_warmstart).all()
    ok &= (speed[3:] < MAX_TURN).all() & (speed[:3] < MAX_BASE_SPEED).all()

    moved = state.replace(qpos=after.qpos, qvel=after.qvel, contact_steps=after.contact_steps)
    around, heights = const.view.around, None
    if around is not None and const.feet is not None:
        there = surroundings.exact(around, after.qpos, after.qvel, state.goal, state.scan_shift)
        heights = surroundings.foot_heights(around, there)
    seen = view.exact(const.view, const.robot, hyper, body, moved)
    known = _known(const, hyper, seen, action, heights)
    facts = known | _measured(const, hyper, state, after)._asdict()
    terms = reward_sum.values(const.terms, facts)
    reward, weighted = reward_sum.total(terms, hyper.task.weights, const.dt)
    reward = jnp.where(ok, reward, 0.0)

    fell = (const.fatal & (after.lowest < 0)).any() | ~ok
    if hyper.task.max_tilt is not None:
        fell |= known["gravity"][2] > -jnp.cos(hyper.task.max_tilt)
    mine = const.view.own
    falls, timeouts = (own.ends(mine, facts, timeout) for timeout in (False, True))
    for ends in falls.values():
        fell |= ends
    if hyper.task.fall_reward is not None:  # once, so not times dt; a blow-up is a fall too
        reward += hyper.task.fall_reward * fell
    clock = state.clock + 1
    timeout = (clock >= const.task.episode_length) & ~fell
    for ends in timeouts.values():
        timeout |= ends & ~fell
    crossed: Any = None
    if const.ground is not None:  # it has left its tile: the end of this way, as the time is
        away = _from_centre(const, state.tile, after.qpos[:2])
        crossed = (away > const.task.tiles.size / 2) & ~fell
        timeout |= crossed
    obs_key, push_key, command_key = jax.random.split(key, 3)
    told = state.command, state.goal, after.qpos, command_key
    sample = own.sampler(mine, own.numbers(hyper), state.own or {})
    command, goal = commands.advance(const.task, hyper, *told, sample)
    qvel, push_in = pushes.push(hyper.task.push, const.dt, after.qvel, state.push_in, push_key)
    stride = state.gait
    if stride is not None:
        stride = stride.replace(angle=gait.advance(stride.angle, stride.turn))
    next_state = state.replace(
        qpos=after.qpos,
        qvel=qvel,
        command=command,
        goal=goal,
        gait=stride,
        last_action=action,
        older_action=state.last_action,
        torque=after.torque if const.engine.lags else None,
        **{name: getattr(after, name) for name in FROM_PHYSICS},
        clock=clock,
        push_in=push_in,
        episode_steps=state.episode_steps + 1,
        episode_return=state.episode_return + reward,
    )
    if state.own is not None:
        size = view.prop_size(const.view)
        next_seen = view.exact(const.view, const.robot, hyper, body, next_state)
        following = view.following(const.view, hyper, seen[size:], action, next_seen[:size])
        following = {name: jnp.where(ok, x, state.own[name]) for name, x in following.items()}
        next_state = next_state.replace(own=following)
    now = next_state, view.rest_after(const.view, state.obs), obs_key
    prop, obs = view.observation(const.view, const.robot, hyper, body, *now)
    next_state = next_state.replace(
        prop=jnp.where(ok, prop, state.prop), obs=jnp.where(ok, obs, state.obs)
    )
    error = known["linear_velocity"] - state.command
    yaw_error = known["angular_velocity"][2] - state.command[2]
    metrics = {f"reward_{name}": jnp.where(ok, value, 0.0) for name, value in weighted.items()} | {
        "velocity_error_sq": jnp.where(ok, (error[:2] ** 2).sum(), 0.0),
        "yaw_error_sq": jnp.where(ok, yaw_error**2, 0.0),
        "falls": fell * 1.0,
        "timeouts": timeout * 1.0,
        "blowups": ~ok * 1.0,
    }
    if hyper.task.fall_reward is not None:
        metrics["reward_fall"] = hyper.task.fall_reward * fell / const.dt
    if const.ground is not None:
        row = state.tile.row
        metrics |= {"crossings": crossed * 1.0, "terrain_row": row * 1.0}
        metrics |= {f"terrain_row_{k}": (row == k) * 1.0 for k in range(const.task.tiles.rows)}
    metrics |= {f"ended_{name}": ends * 1.0 for name, ends in (falls | timeouts).items()}
    metrics |= {f"curriculum_{name}": known[name] for name in mine.terms.curricula}
    if state.clearance is not None:
        metrics["curriculum_clearance_share"] = state.clearance
    outcome = Outcome(
        reward=reward,
        discount=1.0 - fell,
        truncation=timeout * 1.0,
        next_obs=next_state.obs,
        next_prop=next_state.prop,
        valid=ok * 1.0,
        episode_return=next_state.episode_return,
        episode_length=next_state.episode_steps * 1.0,
        metrics=metrics,
    )
    return next_state, outcome


def _known(const: Constants, hyper: Hyper, seen, action, heights) -> dict[str, Any]:
    """What a term can ask for without physics (rewards.py): `seen` has the predicted parts of the next
    observation and the known parts of this one; `heights` [F] are the feet's above the ground, None where it
    is flat."""
    parts = view.split(const.view, seen)
    if const.feet is not None:
        parts |= _feet(const, const.feet, parts, heights)._asdict()
    given = own.numbers(hyper._replace(task=engine_lib.per_joint_arrays(hyper)))
    return given | parts | {"action": action, "dt": const.dt}


def _feet(const: Constants, feet: FeetGeometry, parts, heights) -> rewards.Feet:
    """Of the predicted parts of an observation: v = v_com + w x (p - com) + dp/dt in the base."""
    place = partial(kinematics.feet_in_base, feet.middles)
    joints = parts["joint_position"] + jnp.asarray(const.robot.default_pose, jnp.float32)
    position, moves = jax.jvp(place, (joints,), (parts["joint_velocity"],))
    arm = position - jnp.asarray(feet.base_com, jnp.float32)
    carried = observe.cross(jnp.broadcast_to(parts["angular_velocity"], arm.shape), arm)
    velocity = parts["linear_velocity"] + carried + moves
    if heights is None:
        up = -(position * parts["gravity"]).sum(-1)
        heights = up - up.min()  # where the flat ground is, only physics knows
    return rewards.Feet(position, velocity, jnp.asarray(feet.side, jnp.float32), heights)


def _measured(
    const: Constants, hyper: Hyper, state: State, after: engine_lib.Substeps
) -> rewards.Measured:
    contact = after.contact_steps > 0
    joints = after.qpos[7:]
    return rewards.Measured(
        older_action=state.older_action,
        over_limit=over_limit(const.robot, hyper, joints),
        swing_height=after.last_peak,
        clearance_share=jnp.float32(1) if state.clearance is None else state.clearance,
        torque=after.torque,
        joint_velocity_before=after.qd_before,
        timestep=const.engine.timestep,
        height=ground.height_above(after.qpos[2], lambda: after.qpos[:2], const.ground),
        contact=contact,
        touchdown=contact & (after.contact_steps <= const.engine.substeps),
        last_air_time=after.last_air_steps * const.engine.timestep,
        lowest=jnp.where(const.undesired, after.lowest, jnp.inf).min(-1),
        qpos=after.qpos,
        qvel=after.qvel,
        episode_steps=state.episode_steps,
    )


def known_end(const: Constants, hyper: Hyper, prop, context):
    """1 where a part is in the ground that ends an episode there, as far as a tail knows where it is."""
    del hyper
    around = const.view.around
    assert around is not None
    numbers = context[view.own_size(const.view) - prop.size :]
    return 1.0 * surroundings.touches(around, numbers, prop)


def known_reward(const: Constants, hyper: Hyper, obs, action, next_prop, measured=None):
    """The share of a row's reward that is a function of `obs`, `action` and `next_prop`; and of `measured`,
    fields of `rewards.Measured` by name, where some are known (logged.py).

    Exact unless a push changed the velocity after the reward (pushes.py). `task.fall_reward` is not in it:
    only the model knows the probability of a fall. On rough ground feet are where a tail finds them, a few
    millimetres off (scan.moved).
    """
    seen = jnp.concatenate([next_prop, obs[next_prop.size : view.current_size(const.view)]])
    around, heights = const.view.around, None
    if around is not None and const.feet is not None:
        there = surroundings.advance(around, obs[view.own_size(const.view) :], next_prop)
        heights = surroundings.foot_heights(around, there)
    facts, terms = _known(const, hyper, seen, action, heights), const.known
    if measured:
        facts |= measured
        terms = reward_sum.known(const.terms, const.task, measured.keys())
    values = reward_sum.values(terms, facts)
    return reward_sum.total(values, hyper.task.weights, const.dt)[0]
