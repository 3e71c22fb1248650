"""`play --serve`: the robot on a page that a browser opens, to look at and to steer."""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Callable
from typing import Any

from dynappo.config import ConfigError, shell
from dynappo.play import task_episode
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_source
from dynappo.policy.policy_file import Other
from dynappo.web import address, live, policies
from dynappo.web.policies import Chosen, Offer

TOUR = episode_lib.PAGE_SECONDS


def run(
    flags: argparse.Namespace, theirs: tuple[Other, str] | None, choose: Callable, commands: Any
) -> None:
    """Serve until ctrl-C, or for `--seconds`.

    `theirs` is `(policy, text)` of another package's environment. Else `choose(flags)` is used where
    `--policy` names what acts. `commands` are the `Commands` of `--command`, until somebody steers, or None.
    Then the robot of a run walks a tour: nobody steers one that learns.
    """
    where = address.read(flags.serve)
    address.check(where)
    from dynappo.web import server

    how = flags.robot_xml, flags.keep_joints, flags.ground, flags.terms
    offer = Offer(flags.what, flags.run_seed, *how)
    try:
        first, named = _first(flags, theirs, choose, offer)
        at = commands.at if commands and len(commands.rows) > 1 else None
        if not commands and offer.run is not None:
            around = episode_lib.tour(TOUR)
            at = lambda t: around(t % TOUR)  # noqa: E731
        if commands and not len(live.ranges(first.player)):
            raise ConfigError(f"--command: {live.name(first.player)} has no command to follow")
        print(shell.pasted(f"dynappo plays {live.name(first.player)}: {first.text}"))
        if first.note:
            print(first.note)

        def ready(page, url):
            if commands and at is None:
                live.wish(page.live, live.steer, commands.rows[0])
            print(f"open {url} in a browser; ctrl-C ends it", flush=True)

        stop = threading.Event()
        if flags.until_eof:
            threading.Thread(target=_at_eof, args=(stop,), daemon=True).start()
        server.serve(offer, where, first, at, named, flags.seconds, ready, stop)
    finally:
        policies.close()


def _first(
    flags, theirs: tuple[Other, str] | None, choose: Callable, offer: Offer
) -> tuple[Chosen, str | None]:
    """What plays first, and what the list calls it if it is no policy."""
    if theirs is not None:
        print(f"dynappo starts {theirs[0].config.env}, in half a minute", flush=True)
    if not flags.policy:
        return policies.load(offer, policies.names(offer)[0]), None
    if theirs is not None:
        player = policies.task(theirs[0].config.env)
        act, named = task_episode.acts(theirs[0], player, flags, theirs[1])
        return Chosen(player, act, named, player.about), named
    policy, act, named = choose(flags)
    field, on = policies.ground(policy, flags.ground)
    player, note = policy_source.player(policy, flags.robot_xml, flags.keep_joints, field)
    return Chosen(player, act, named + on, note), named


def _at_eof(stop: threading.Event) -> None:
    """Set `stop` when the process that started this one closes our stdin, or ends."""
    while sys.stdin.buffer.raw.read(1):  # pyright: ignore[reportAttributeAccessIssue]
        pass
    stop.set()
