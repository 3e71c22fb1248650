"""Makes a small GIF of several episodes: robots walk side by side, seen by a fixed camera.

    problem = side_by_side.film(go1.xml, [first, second], Path("walks.gif"))

For the notebooks here. Only the robots' pixels change, so a second takes 20 to 45 kB (one to three
robots). With a camera that follows the robot (`render.film`) it takes half a megabyte.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np

from dynappo.config import shell
from dynappo.description import mjcf
from dynappo.policy import render

SIZE = 440, 184  # pixels
COLOURS = 28
LANE = 1.0  # m between two robots
FIELD = 24.0  # degrees, vertical field of view: a long lens, so that distant robots are not small
TILT = 17.0  # degrees, how far the camera looks down
AROUND = 0.6  # m, margin at both ends of the robots' paths
HEIGHT = 0.25  # m, height at which the camera looks
TINTS = (0.95, 0.50, 0.10), (0.20, 0.50, 0.95), (0.25, 0.70, 0.35)  # orange, blue, green
STRENGTH = 0.55  # share of the tint in a colour


def film(xml: Path, episodes: Sequence[dict], out: Path) -> str:
    """Write a GIF of `episodes` to `out`. Returns "", or one line that says why not, as
    `render.film`.

    Episodes are as `episode.play` returns them, all of the robot in `xml` and equally long. Episode
    0 is in front. The robots behind it are tinted: orange, blue, green. No arrows are drawn.
    """
    problem = render.film(*together(xml, episodes), out, size=SIZE)
    return problem or fewer_colours(out)


def steady(*command: float) -> Callable[[float], np.ndarray]:
    """`t -> command` for `episode.play`: a constant (vx, vy, yaw rate)."""
    return lambda t: np.array(command, float)


def together(xml: Path, episodes: Sequence[dict]) -> tuple[Any, dict[str, np.ndarray]]:
    """`(robots, episode)`, all `episodes` in one scene, as `render.film` takes them."""
    with mjcf.one_line(xml):
        scene = mujoco.MjSpec.from_file(str(xml))
        # MuJoCo does not copy attached specs: keep all alive until the scene is written
        others = [_tinted(xml, TINTS[i % len(TINTS)]) for i in range(len(episodes) - 1)]
        for i, other in enumerate(others, 1):
            scene.worldbody.add_frame().attach_body(_base(other), f"robot{i}_", "")
        name = _base(scene).name
        for camera in list(scene.cameras):
            scene.delete(camera)
        qpos = [episode["qpos"] + _lane(i, episode) for i, episode in enumerate(episodes)]
        _look(scene, np.concatenate([rows[:, :2] for rows in qpos]))
        base = scene.compile().body(name).id
        robots = SimpleNamespace(xml=xml, text=scene.to_xml(), base_body=base)
    still = np.zeros((len(qpos[0]), 3))
    rows = {"qpos": np.concatenate(qpos, 1), "command": still, "velocity": still}
    return robots, rows | {"dt": episodes[0]["dt"]}


def _base(spec):
    """The top-level body with a free joint."""
    free = mujoco.mjtJoint.mjJNT_FREE
    return next(b for b in spec.worldbody.bodies if any(j.type == free for j in b.joints))


def _tinted(xml: Path, tint):
    """The robot of a file in another colour, without lights, cameras and keyframes."""
    spec = mujoco.MjSpec.from_file(str(xml))
    for once in [*spec.lights, *spec.cameras, *spec.keys]:
        spec.delete(once)
    for painted in [*spec.materials, *spec.geoms]:
        painted.rgba[:3] = (1 - STRENGTH) * painted.rgba[:3] + STRENGTH * np.array(tint)
    return spec


def _lane(i: int, episode) -> np.ndarray:
    """The shift of `qpos` with which episode i starts at x = 0 in its lane."""
    shift = np.zeros(episode["qpos"].shape[1])
    shift[:2] = [0, i * LANE] - episode["qpos"][0, :2]
    return shift


def _look(scene, places: np.ndarray) -> None:
    """Add the camera `track`, which `render` uses: it sees all `places` `[n, 2]` from the side."""
    (left, front), (right, back) = places.min(0), places.max(0)
    down, up, near = np.radians(TILT), np.tan(np.radians(FIELD / 2)), (back - front) / 2
    wide = ((right - left) / 2 + AROUND) / (up * SIZE[0] / SIZE[1])
    high = (near * np.sin(down) + 1.5 * HEIGHT) / up
    away = max(wide, high) + near  # m from the middle
    scene.visual.map.shadowclip *= 3  # the light may follow one robot: a shadow for the others too
    scene.worldbody.add_camera(
        name="track",
        pos=[
            (left + right) / 2,
            (front + back) / 2 - away * np.cos(down),
            HEIGHT + away * np.sin(down),
        ],
        xyaxes=[1, 0, 0, 0, np.sin(down), np.cos(down)],
        fovy=FIELD,
    )


def fewer_colours(gif: Path) -> str:
    """Rewrite `gif` with `COLOURS` colours, half for moving pixels; "" or what is missing."""
    try:
        from PIL import Image, ImageSequence
    except ImportError:
        return render.LACKS.format("pillow") + shell.install("video")
    with Image.open(gif) as image:
        wait = image.info.get("duration", 80)  # ms
        frames = np.stack([np.array(f.convert("RGB")) for f in ImageSequence.Iterator(image)])
    still = frames[0].reshape(-1, 3)
    moving = frames[(frames != np.median(frames, 0)).any(-1)]
    if len(moving):
        moving = np.random.default_rng(0).choice(moving, len(still))
    seen = Image.fromarray(np.concatenate([still, moving])[None])
    palette = seen.quantize(COLOURS, Image.Quantize.MEDIANCUT)
    flat = Image.Dither.NONE
    first, *rest = [Image.fromarray(f).quantize(palette=palette, dither=flat) for f in frames]
    first.save(gif, save_all=True, append_images=rest, duration=wait, loop=0, optimize=True)
    return ""
