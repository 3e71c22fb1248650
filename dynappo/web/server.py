"""The page: a server for browsers, the robot in it, and the thread that looks for newer policies.

    serve(Offer("runs/go1", None, None, False), Address("127.0.0.1", 8080))

Physics and drawing run in the thread that calls `serve`; viser has its own threads for the browsers. A
viewer that comes or goes changes nothing for the robot.
"""

from __future__ import annotations

import contextlib
import io
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import viser

from dynappo.config import ConfigError, shell, versions
from dynappo.policy.episode import Player
from dynappo.policy.task_player import TaskPlayer
from dynappo.web import guard, panels, policies, run_plots, scene
from dynappo.web import live as live_lib
from dynappo.web.address import Address, free, read, taken
from dynappo.web.live import Live
from dynappo.web.policies import Chosen, Offer

FRAME = 1 / 50  # s between two pictures
TELL, PLOT, CURVES = 0.25, 0.4, 2.0  # s between two updates


@dataclass
class Page:
    """Everything that the server shows."""

    server: viser.ViserServer
    live: Live
    offer: Offer
    text: str  # what plays
    shown: scene.Shown
    panels: panels.Panels
    name: str  # chosen in the list


def start(address: Address, title: str = "dynappo") -> tuple[viser.ViserServer, int]:
    """`(server, port)`: on a port as `address.free` says; only its own page is let in. `title` is that of
    the browser's tab."""
    found, port = free(address)
    watch = guard.for_address(address.host, found)
    watch.title = title
    with contextlib.redirect_stdout(io.StringIO()), guard.watching(watch):  # it prints its own name
        server = viser.ViserServer(address.host, port, label="dynappo", verbose=False)
    if not watch.on:
        server.stop()
        raise ConfigError(
            f"--serve: viser {versions.of('viser')} starts its server in a way that dynappo cannot "
            f"protect from other web sites: {shell.install('web')}"
        )
    if address.named and server.get_port() != address.port:  # taken since we looked
        server.stop()
        raise taken(address)
    watch.gui = server.gui
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    server.gui.main_panel.dock_right()
    return server, server.get_port()


def open_page(server, offer: Offer, first: Chosen, given, named: str | None = None) -> Page:
    """Everything that the browser shows; `given(t)` is the command until somebody steers.

    `named`: what the list calls `first`, where it is no policy of `policies.names`.
    """
    live = Live(first.player, first.act, given)
    names = [*filter(None, [named]), *policies.names(offer)]
    shown = scene.show(server, live)
    page: Page

    def choose(name: str) -> None:
        try:
            found = first if name == named else policies.load(offer, name)
        except ConfigError as error:
            text = str(error)
            live_lib.wish(live, lambda live: setattr(live, "note", text))
            return
        live_lib.wish(live, lambda _: play(page, found, name))

    def look(flags: dict[str, bool]) -> None:
        live_lib.wish(live, lambda _: view(page, flags))

    made = panels.add(server, live, names, choose, look, offer.run is not None)
    page = Page(server, live, offer, first.text, shown, made, names[0])
    server.on_client_connect(lambda client: scene.welcome(page.shown, live, client))
    panels.show_robot(server, made, live)
    return page


def play(page: Page, found: Chosen, name: str) -> None:
    """Play `found` from now on; if the robot is the same, it goes on walking."""
    page.text, page.name, page.live.note = found.text, name, found.note
    if same_robot(page.live.player, found.player):
        live_lib.take_policy(page.live, found.act)
        return
    live_lib.take_robot(page.live, found.player, found.act)
    flags = {name: check.value for name, check in page.panels.look.items()}
    page.shown = scene.show(page.server, page.live)
    panels.show_robot(page.server, page.panels, page.live)
    view(page, flags)


def same_robot(one: Player | TaskPlayer, other: Player | TaskPlayer) -> bool:
    """Whether the policy of `other` can take over in mid-stride: same file, observation and motors. A task's
    robot is started once, and takes each of its policies."""
    if isinstance(one, TaskPlayer) or isinstance(other, TaskPlayer):
        return one is other
    a, b = one.policy, other.policy
    driven = set(a._fields) - {"config", "params", "mjcf", "seed"}
    if a.mjcf and b.mjcf and a.mjcf != b.mjcf or one.xml != other.xml:
        return False
    if not _same_ground(one, other):
        return False
    if a.own != b.own or one.own != other.own:
        return False
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in driven)


def _same_ground(one: Player, other: Player) -> bool:
    if one.field is None or other.field is None:
        return one.field is other.field
    return all(map(np.array_equal, one.field, other.field))


def view(page: Page, flags: dict[str, bool]) -> None:
    """Set whether the camera follows and contacts are drawn."""
    scene.contacts(page.shown, flags["contacts"], flags["forces"])
    scene.follow(page.shown, page.live, flags["follow"])


def newer(page: Page) -> None:
    """List the run's newer policy, and play it if the newest one is chosen."""
    live = page.live

    def listed(_):
        page.panels.policy.options = policies.names(page.offer)

    live_lib.wish(live, listed)
    if page.name != policies.NEWEST:
        return
    try:
        found = policies.load(page.offer, policies.NEWEST)
    except (ConfigError, OSError):  # it is being replaced; the next look finds it whole
        return
    live_lib.wish(live, lambda _: play(page, found, policies.NEWEST))


def drawing(page: Page, run_curves: Callable[[], None]) -> Callable[[], None]:
    """What the loop calls after its steps: pictures, numbers and plots, each at its own pace."""
    due = {"frame": 0.0, "tell": 0.0, "plot": 0.0, "curves": 0.0}

    def at(name, every):
        now = time.perf_counter()
        if now < due[name]:
            return False
        due[name] = max(due[name] + every, now)
        return True

    def draw():
        if not page.server.get_clients():
            return
        if at("frame", FRAME):
            scene.update(page.shown, page.live)
        if at("tell", TELL):
            panels.show_status(page.panels, page.live, page.text)
        if at("plot", PLOT) and not page.live.paused:
            panels.draw(page.panels, page.live)
        if at("curves", CURVES):
            run_curves()

    return draw


def curves_of(page: Page) -> Callable[[], None]:
    """A function that shows the curves of the run as they are now; of no run, nothing."""
    folder, shown = page.offer.run, page.panels.run
    if folder is None or shown is None:
        return lambda: None
    path, seen, plots = folder / "metrics.csv", 0, []

    def show():
        nonlocal seen, plots
        size = path.stat().st_size if path.is_file() else 0
        columns = run_plots.read(path) if size != seen else {}
        seen = size
        if columns:
            shown.text.content = run_plots.line(columns)
            with shown.tab:
                plots = run_plots.draw(page.server, plots, columns)

    return show


def serve(
    offer: Offer,
    address: Address,
    first: Chosen,
    given: Callable | None = None,
    named: str | None = None,
    seconds: float | None = None,
    ready: Callable[[Page, str], None] = lambda page, url: None,
    stop: threading.Event | None = None,
) -> None:
    """Serve the page until ctrl-C or `stop`, or for `seconds`; the rest is as in `open_page`.

    `ready(page, url)` is called when browsers can open it.
    """
    stop = stop or threading.Event()
    server, port = start(address, f"dynappo: {live_lib.name(first.player)}")
    if port != address.port:
        print(f"{address.port} is taken: {port}")
    seen = policies.stamp(offer)
    try:
        page = open_page(server, offer, first, given, named)
        ready(page, f"http://{_seen_from_here(address.host)}:{port}")
        if offer.run is not None:
            args = offer, seen, lambda: newer(page), stop
            threading.Thread(target=policies.watch, args=args, daemon=True).start()
        draw = drawing(page, curves_of(page))
        live_lib.run(page.live, draw, stop.is_set, seconds)
    finally:
        stop.set()
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def _seen_from_here(host: str) -> str:
    """The host as a browser on this machine must write it."""
    everywhere = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}
    return everywhere.get(host, f"[{host}]" if ":" in host else host)


def in_notebook(what: str, seconds: float) -> None:
    """Show the page of a policy below a notebook's cell, for `seconds`; `what` is as for `play`."""
    from IPython.display import IFrame, display

    offer = Offer(what, None, None, False)
    first = policies.load(offer, policies.names(offer)[0])

    def ready(_, url):
        display(IFrame(url, 960, 600))

    try:
        serve(offer, read(""), first, seconds=seconds, ready=ready)
    finally:
        policies.close()
