"""The policies that the page offers: the bundled ones, and those of a run, the newest first.

A run that trains writes its policy anew at every checkpoint; `watch` notices.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynappo import config as config_lib
from dynappo.config import ConfigError, files
from dynappo.description import robot as robot_lib
from dynappo.policy import checkpoint_file, policy_file, policy_source, task_player
from dynappo.policy.episode import Player
from dynappo.policy.policy_file import Policy
from dynappo.policy.task_player import TaskPlayer
from dynappo.terrain.height_map import HeightMap
from dynappo.web import ground_mesh

NEWEST = "newest of the run"
EVERY = 1.0  # s between two looks at the folder of a run
STARTED: dict[str, TaskPlayer] = {}  # by the environment
STARTING = threading.Lock()


class Chosen(NamedTuple):
    """A policy that the browser can show."""

    player: Player | TaskPlayer
    act: Callable[[np.ndarray], np.ndarray]
    text: str  # what it is, for a person
    note: str = ""


class Offer(NamedTuple):
    """What was named on the command line, and how its robot is loaded."""

    what: str
    seed: int | None
    xml: str | None
    keep_joints: bool
    ground: str | None = None  # as of --ground
    terms: Path | None = None  # as of --terms, for the policies of a run

    @property
    def run(self) -> Path | None:
        """The workdir, if a run was named."""
        path = Path(self.what)
        named = self.what not in files.bundled() and os.path.isdir(path)
        of_run = named and any(
            os.path.exists(path / name) for name in ("config.json", "checkpoints")
        )
        return path if of_run and not os.path.isdir(path / checkpoint_file.STATE) else None


def names(offer: Offer) -> list[str]:
    """What can be chosen, the policy of the command line first."""
    run = offer.run
    if run is None:
        return [offer.what, *(name for name in _bundled() if name != offer.what)]
    saved = checkpoint_file.iterations(run / "checkpoints")
    return [NEWEST, *(f"iteration {n}" for n in saved), *_bundled()]


def _bundled() -> list[str]:
    return [name for name in files.bundled() if _there(name)]


def _there(what: str, seed: int | None = None) -> bool:
    """Whether there is a policy of that name: a robot may have none, a run not yet."""
    try:
        return bool(policy_source.locate(what, seed))
    except ConfigError:
        return False


def load(offer: Offer, name: str) -> Chosen:
    """The policy `name` of `names`; ConfigError where it cannot be used, or is none of them.

    `name` may come from a browser: nothing else is opened, and the error does not say what there is.
    """
    if name not in names(offer):
        raise ConfigError("no such policy in the list")
    run, path = offer.run, offer.what
    if run is not None and name.startswith("iteration "):
        path = str(run / "checkpoints" / name.removeprefix("iteration "))
    elif name not in (NEWEST, offer.what):
        path = name
    own = name == offer.what or name == NEWEST or path.startswith(str(run))
    seed = offer.seed if own else None
    if name == NEWEST and not begun(offer):
        return standing(offer)
    found = policy_source.locate(path, seed)
    text = policy_source.named(path, found)
    if name == NEWEST:
        text += f" ({_iteration(offer)})"
    if (theirs := policy_file.load_other(found, seed)) is not None:
        player = task(theirs.config.env)
        return Chosen(player, task_player.actor(player, theirs), text, player.about)
    policy, _ = policy_source.load(path, seed)
    policy, with_terms = policy_source.with_terms(policy, offer.terms if own else None)
    field, on = ground(policy, offer.ground)
    player, note = policy_source.player(
        policy, offer.xml if own else None, offer.keep_joints and own, field
    )
    act = policy_file.actor(policy.params, policy.activation)
    return Chosen(player, act, text + with_terms + on, note)


def ground(policy: Policy, text: str | None) -> tuple[HeightMap | None, str]:
    """`policy_source.ground_or_own`, of a large map what is near."""
    field, on = policy_source.ground_or_own(policy, text)
    return None if field is None else ground_mesh.near(field), on


def task(env: str) -> TaskPlayer:
    """The robot of another package's environment. It is started once, and takes every policy of that."""
    with STARTING:
        if env not in STARTED:
            STARTED[env] = task_player.start(env)
        return STARTED[env]


def close() -> None:
    """End the processes of all that `task` started."""
    while STARTED:
        task_player.close(STARTED.popitem()[1])


def _iteration(offer: Offer) -> str:
    """How far the newest policy of the run has learned."""
    saved = checkpoint_file.iterations(Path(offer.what) / "checkpoints")
    return f"iteration {saved[0]}" if saved else "no checkpoint"


def begun(offer: Offer) -> bool:
    """Whether the run has a policy yet."""
    return _there(offer.what, offer.seed)


def standing(offer: Offer) -> Chosen:
    """The robot of a run that has no policy yet, with zero actions."""
    path = Path(offer.what) / "config.json"
    try:
        config = config_lib.from_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(
            f"{offer.what}: holds neither a policy.npz nor checkpoints/; expected a workdir of "
            "`dynappo train`, or a policy.npz"
        ) from None
    if config.env:
        if offer.ground:
            raise ConfigError(f"--ground: {config.env} has a ground of its own")
        player = task(config.env)
        act = task_player.still(player)
        return Chosen(player, act, "no policy yet: zero actions", player.about)
    if not config.robot:
        raise ConfigError(f"{offer.what}: trains an environment of its own, which has no page")
    policy = policy_file.describe(config, robot_lib.load(config.robot))
    policy, _ = policy_source.with_terms(policy, offer.terms)
    field, on = ground(policy, offer.ground)
    policy = policy._replace(mjcf="")
    player, note = policy_source.player(policy, offer.xml, offer.keep_joints, field)
    size = len(policy.joint_names)
    return Chosen(player, lambda obs: np.zeros(size), "no policy yet: zero actions" + on, note)


def stamp(offer: Offer) -> tuple:
    """A value that changes when the run has written a new policy."""
    try:
        path = policy_source.locate(offer.what, offer.seed)
        return path, path.stat().st_mtime_ns
    except (ConfigError, OSError):  # none yet, or just being replaced
        return ()


def watch(offer: Offer, seen: tuple, found: Callable[[], None], stop: threading.Event) -> None:
    """Call `found()` whenever the run has a newer policy than `seen`, until `stop` is set."""
    while not stop.wait(EVERY):
        now = stamp(offer)
        if now and now != seen:
            seen = now
            found()
