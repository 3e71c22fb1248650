"""`play --serve`: the robot on a page that a browser opens, to look at and to steer."""

from __future__ import annotations

import argparse
import sys
import threading
from collections.abc import Callable
from typing import Any

from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_source
from dynappo.web import address, live, policies
from dynappo.web.policies import Chosen, Offer

TOUR = episode_lib.PAGE_SECONDS


def run(flags: argparse.Namespace, choose: Callable, commands: Any) -> None:
    """Serve until ctrl-C, or for `--seconds`.

    `choose(flags)` is used where `--policy` names what acts; `commands` are the `Commands` of
    `--command`, until somebody steers, or None. Then the robot of a run walks a tour: nobody steers
    one that learns.
    """
    where = address.read(flags.serve)
    address.check()
    from dynappo.web import server

    offer, named = Offer(flags.what, flags.run_seed, flags.robot_xml, flags.keep_joints), None
    if flags.policy:
        policy, act, named = choose(flags)
        player, note = policy_source.player(
            policy,
            flags.robot_xml,
            flags.keep_joints,
            policy_source.ground(policy, flags.ground) if flags.ground else None,
        )
        first = Chosen(player, act, named, note)
    else:
        first = policies.load(offer, policies.names(offer)[0])
    at = commands.at if commands and len(commands.rows) > 1 else None
    if not commands and offer.run is not None:
        around = episode_lib.tour(TOUR)
        at = lambda t: around(t % TOUR)  # noqa: E731
    print(f"dynappo plays {first.player.policy.robot}: {first.text}")
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


def _at_eof(stop: threading.Event) -> None:
    """Set `stop` when the process that started this one closes our stdin, or ends."""
    while sys.stdin.buffer.raw.read(1):  # pyright: ignore[reportAttributeAccessIssue]
        pass
    stop.set()
