"""One robot of another package's environment, a control step at a time: for films, pages and the live page.

The environment's own code needs JAX, so a process of its own steps it, evaluate/task_steps.py, started here:

    player = task_player.start("playground:Go1JoystickFlatTerrain")
    for row in task_player.rows(player, mujoco.MjData(player.model), act): ...

Between the two go float64 numbers: an `Ask` for each control step, and a `Told` for an answer.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import reprlib
import subprocess
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import mujoco
import numpy as np

from dynappo.config import ConfigError, interpreter
from dynappo.policy import checks, policy_file, render
from dynappo.policy.policy_file import Other
from dynappo.tasks import names, single

# what the process tells of the robot before its first step
ABOUT = ("observed", "ranges", "dt", "episode_length", "about")
REFUSED = "refused"  # what the process tells, with the reason, where there is no such robot
CLOSING = 5.0  # s, for the process to end
Rows = TypeVar("Rows", "Ask", "Told")


class Ask(NamedTuple):
    """What the robot is to do in a control step; the fields that `sizes` names."""

    reset: Any  # [1] not 0: begin an episode instead, with the key `seed`
    seed: Any  # [1]
    command: Any  # [3] m/s, m/s, rad/s; NaN: the task's own
    push: Any  # [3] m/s, which the base's velocity gets
    force: Any  # [3] N on the base
    action: Any  # [A] the policy's, before it is squashed or clipped


class Told(NamedTuple):
    """The robot after it."""

    obs: Any  # [O] as the policy sees it
    qpos: Any
    qvel: Any
    ctrl: Any
    pose: Any  # [nbody, 7] of the bodies: m, quaternion
    command: Any  # [3] that it followed, 0 of a task without
    velocity: Any  # [3] vx, vy in the base's frame, yaw rate
    reward: Any  # [1]
    fell: Any  # [1] whether the task ended the episode
    ok: Any  # [1] 0 where a number was not finite


class TaskPlayer(NamedTuple):
    """An environment's robot, and the process that steps it; `A` joints are in the policy's order."""

    env: str  # playground:TASK, brax:NAME
    model: mujoco.MjModel  # as it is drawn
    base_body: int
    joint_names: tuple[str, ...]  # [A]
    joint_v: np.ndarray  # [A] indices in qvel
    ground: np.ndarray  # [ngeom] bool: fixed to the world
    observed: int  # O, numbers that the policy sees
    ranges: np.ndarray | None  # [3, 2] commands that the task asks for; None: it has none
    dt: float  # s, a control step
    episode_length: int  # control steps
    about: str  # a line on its physics or its meshes
    process: subprocess.Popen


def asks(actions: int) -> dict[str, int]:
    """How many numbers each field of an `Ask` has."""
    return dict(zip(Ask._fields, (1, 1, 3, 3, 3, actions), strict=True))


def tells(model: mujoco.MjModel, observed: int) -> dict[str, int]:
    """How many numbers each field of a `Told` has."""
    sizes = observed, model.nq, model.nv, model.nu, 7 * model.nbody, 3, 3, 1, 1, 1
    return dict(zip(Told._fields, sizes, strict=True))


def packed(row: Ask | Told) -> bytes:
    """The fields one after the other."""
    return np.concatenate([np.ravel(np.asarray(x, np.float64)) for x in row]).tobytes()


def unpacked(kind: type[Rows], sizes: dict[str, int], text: bytes) -> Rows:
    """What `packed` made."""
    ends = np.cumsum([*sizes.values()])
    return kind(*np.split(np.frombuffer(text, np.float64), ends[:-1]))


def check(env: str) -> None:
    """ConfigError for an environment that there is not, or whose package is not installed."""
    names.check(env)


def start(env: str) -> TaskPlayer:
    """The robot of the environment `env`, when its process is ready, after some ten seconds.

    ConfigError where it cannot be, with what the process says of it.
    """
    check(env)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.mjb"
        command = [*interpreter.command("dynappo.evaluate.task_steps"), env, str(file)]
        # not in our group: ctrl-C ends us, and with our pipe it ends too
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        try:
            assert process.stdout
            line = process.stdout.readline()
            if not line:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(CLOSING)  # a bug, which it prints
                raise ConfigError(f"{env}: the process that steps it could not start")
            about = json.loads(line)
            if REFUSED in about:
                raise ConfigError(about[REFUSED])
            model = mujoco.MjModel.from_binary_path(str(file))
        except BaseException:
            process.kill()
            process.wait()
            raise
    return _player(env, about, model, process)


def _player(env: str, about: dict[str, Any], model: mujoco.MjModel, process) -> TaskPlayer:
    joints = model.actuator_trnid[:, 0].tolist()
    ranges = about.pop("ranges")
    return TaskPlayer(
        env=env,
        model=model,
        base_body=single.base(model),
        joint_names=tuple(model.joint(i).name for i in joints),
        joint_v=model.jnt_dofadr[joints],
        ground=model.body_weldid[model.geom_bodyid] == 0,
        ranges=None if ranges is None else np.array(ranges),
        process=process,
        **about,
    )


def close(player: TaskPlayer) -> None:
    """End the player's process."""
    interpreter.end(player.process, CLOSING)


@contextlib.contextmanager
def playing(env: str) -> Iterator[TaskPlayer]:
    """`start`, until the `with` ends."""
    player = start(env)
    try:
        yield player
    finally:
        close(player)


def tell(player: TaskPlayer, ask: Ask) -> Told:
    """The robot after the control step `ask`; ConfigError where its process has ended."""
    process, sizes = player.process, tells(player.model, player.observed)
    assert process.stdin and process.stdout
    text, size = b"", 8 * sum(sizes.values())
    with contextlib.suppress(OSError, ValueError):
        process.stdin.write(packed(ask))
        process.stdin.flush()
        text = process.stdout.read(size)
    if len(text) != size:
        raise ConfigError(f"{player.env}: the process that steps it has ended")
    return unpacked(Told, sizes, text)


def rows(
    player: TaskPlayer,
    data: mujoco.MjData,
    act: Callable[[np.ndarray], np.ndarray],
    command: Callable[[float], np.ndarray] | None = None,
    seed: int = 0,
) -> Iterator[dict[str, Any]]:
    """Begin an episode in `data`, of `player.model`, and yield a row after every control step, for ever.

    A row is as `episode.rows` yields it, with `reward`, and `fell` where the task has ended its episode.
    `command(t)` is followed, or else the task's own. The robot gets what others change in the velocities in
    `data` where they move its base (`push`), and the force on that in `xfrc_applied`. FloatingPointError if
    physics blows up.
    """
    base = player.base_body
    none, own = np.zeros(3), np.full(3, np.nan)
    nothing = np.zeros(len(player.joint_names))
    told = tell(player, Ask([1], [seed], own, none, none, nothing))
    mujoco.set_mju_user_warning(lambda message: None)  # as in `episode.rows`
    _show(player, data, told)
    for k in itertools.count():
        wanted = own if command is None else np.asarray(command(k * player.dt), float)
        action = np.asarray(act(told.obs), float)
        push = single.jacobian(player.model, data) @ (data.qvel - told.qvel)
        force = data.xfrc_applied[base, :3].copy()
        told = tell(player, Ask([0], [0], wanted, push, force, action))
        if not (told.ok[0] and np.isfinite(action).all()):
            after = f"after {k * player.dt:.2f} s (numbers that are not finite)"
            raise FloatingPointError(f"{player.env}: its physics has blown up {after}")
        _show(player, data, told)
        row = dict(command=told.command, velocity=told.velocity, fell=bool(told.fell[0]))
        row |= dict(pose=told.pose.reshape(-1, 7))
        yield dict(qpos=told.qpos, action=action, reward=float(told.reward[0]), **row)


def _show(player: TaskPlayer, data: mujoco.MjData, told: Told) -> None:
    """Put the robot into `data`, with its contacts and the torques of its motors."""
    data.qpos[:], data.qvel[:], data.ctrl[:] = told.qpos, told.qvel, told.ctrl
    mujoco.mj_forward(player.model, data)
    render.place(player.model, data, told.pose.reshape(-1, 7))


def push(player: TaskPlayer, data: mujoco.MjData, velocity) -> None:
    """Add a velocity (m/s, [3]) to the base's in `data`, as far as its joints let it move."""
    data.qvel[:] += np.linalg.pinv(single.jacobian(player.model, data)) @ velocity


def torques(player: TaskPlayer, data: mujoco.MjData) -> np.ndarray:
    """[A] N m, of the motors."""
    return data.qfrc_actuator[player.joint_v].copy()


def actor(player: TaskPlayer, policy: Other) -> Callable[[np.ndarray], np.ndarray]:
    """The mean actions of a policy; ConfigError where its networks are not for this task."""
    activation, size = policy.config.ppo.activation, len(player.joint_names)
    try:
        checks.check_params(policy.params, player.observed, size)
        if activation not in policy_file.ACTIVATIONS:
            raise ValueError(f"its activation is {reprlib.repr(activation)}")
    except ValueError as error:
        raise ConfigError(f"a policy of {player.env}: {error}") from None
    return policy_file.actor(policy.params, activation)


def still(player: TaskPlayer) -> Callable[[np.ndarray], np.ndarray]:
    """Zero actions."""
    return lambda obs: np.zeros(len(player.joint_names))


def at_random(player: TaskPlayer, seed: int) -> Callable[[np.ndarray], np.ndarray]:
    """Random actions."""
    draw = np.random.default_rng((seed, 1))
    return lambda obs: draw.normal(size=len(player.joint_names))


def episode(
    player: TaskPlayer,
    act: Callable[[np.ndarray], np.ndarray],
    seconds: float,
    command: Callable[[float], np.ndarray] | None = None,
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """An episode of the task, with its noise: `seconds`, or until it falls or the task's episode ends."""
    most, some = min(max(1, round(seconds / player.dt)), player.episode_length), []
    every = rows(player, mujoco.MjData(player.model), act, command, seed)
    for row in itertools.islice(every, most):
        some.append(row)
        if row["fell"]:
            break
    columns = {name: np.stack([row[name] for row in some]) for name in some[0]}
    return columns | {"dt": np.array(player.dt)}


@contextlib.contextmanager
def shown(player: TaskPlayer) -> Iterator[render.Shown]:
    """The player as `render.film` takes it."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "model.mjb"
        mujoco.mj_saveModel(player.model, str(file), None)
        yield render.Shown(file, "", player.base_body)
