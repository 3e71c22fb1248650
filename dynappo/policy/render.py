"""A film or a picture of an episode, rendered headless by MuJoCo's OpenGL renderer.

Nothing here needs JAX. The film is made in a process of its own (`python -m dynappo.policy.render
EPISODE.npz OUT`), because the OpenGL backend is chosen once a process, and a backend that fails may
take the process with it: on Linux EGL is tried first, then OSMesa. `play/page.py` needs neither.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dynappo.config import shell
from dynappo.physics import mjcf
from dynappo.physics import robot as robot_lib
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.policy.episode import tour

__all__ = ["film", "simulate", "tour"]

FPS, WIDTH, HEIGHT = 25, 640, 360  # software OpenGL on two cores renders about ten a second
PICTURE = 1280, 720
# what MUJOCO_GL may be, in the order in which it is tried; a Mac and Windows have their own OpenGL
BACKENDS = {"darwin": ("cgl", "glfw"), "win32": ("wgl", "glfw")}.get(
    sys.platform, ("egl", "osmesa")
)
NO_OPENGL = (
    "no video: neither EGL nor OSMesa can render here; Debian and Ubuntu: apt install libegl1"
)
if sys.platform in ("darwin", "win32"):
    NO_OPENGL = (
        "no video: OpenGL cannot render here; log in to the desktop, or write a page instead"
    )
PATIENCE = 20.0  # s for a second of film, at most: a driver may hang
LACKS_PACKAGE, CANNOT_WRITE = 3, 4  # exit statuses of the rendering process
LACKS = "no video: {} is not installed; "
GREEN, BLUE = (0.1, 0.7, 0.2, 0.9), (0.2, 0.4, 0.9, 0.9)  # arrows of command and velocity
# half a megabyte a second; a palette of the film's own colours, else the sky shows bands
GIF = (
    "fps=12.5,scale=480:-1:flags=lanczos,split[a][b];[a]palettegen=stats_mode=diff[p];"
    "[b][p]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)
ENCODE = {
    ".mp4": dict(codec="libx264", quality=7, macro_block_size=4),
    ".gif": dict(
        codec="gif",
        pix_fmt_out="pal8",
        macro_block_size=1,
        quality=None,
        output_params=["-filter_complex", GIF, "-loop", "0"],
    ),
}


def simulate(robot: robot_lib.Robot, config, act, command, seconds: float) -> dict[str, np.ndarray]:
    """An episode of a run's robot under its whole config; `episode.rows` says what is in it."""
    described = policy_file.describe(config, robot)
    body = episode_lib.load(robot.xml, described, described.timestep, text=robot.text)
    return episode_lib.play(body, act, command, seconds)


def film(
    robot: robot_lib.Robot | episode_lib.Body, episode: dict[str, np.ndarray], out: Path
) -> str:
    """Render `episode` to an mp4 at `out`; by its suffix, a GIF, or a PNG of the last row.

    Returns "" if it was written, else one line that says why not and what to install.
    """
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            npz = Path(folder) / "episode.npz"
            shown: dict[str, Any] = {"xml": str(robot.xml), "text": robot.text}
            shown |= {"base": robot.base_body}
            shown |= {name: episode[name] for name in ("qpos", "command", "velocity", "dt")}
            np.savez(npz, **shown)
            out.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:  # no temporary folder, or a full disk
            return f"no video: cannot write a temporary file ({error.strerror or error})"
        limit = PATIENCE * (10 + float(episode["dt"]) * len(episode["qpos"]))  # s
        for backend in BACKENDS:
            environment = os.environ | {"MUJOCO_GL": backend}
            environment |= {"PYOPENGL_PLATFORM": backend} if backend in ("egl", "osmesa") else {}
            command = [sys.executable, "-m", "dynappo.policy.render", str(npz), str(out)]
            try:
                done = subprocess.run(
                    command, env=environment, capture_output=True, text=True, timeout=limit
                )
            except subprocess.TimeoutExpired:
                return f"no video: rendering by {backend} took more than {limit:.0f} s"
            if done.returncode == 0:
                return ""
            if done.returncode == LACKS_PACKAGE:
                lacking = "pillow" if out.suffix == ".png" else "imageio-ffmpeg"
                return LACKS.format(lacking) + shell.install("video")
            if done.returncode == CANNOT_WRITE:
                return f"no video: {done.stderr.strip().splitlines()[-1]}"
    return NO_OPENGL


def arrow(scene, start, vector, rgba) -> None:
    """Add an arrow to the scene: the planar velocity `vector` (m/s) at `start`, 0.35 m for 1 m/s."""
    if np.linalg.norm(vector) < 0.05 or scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.float32(rgba))
    mujoco.mjv_connector(geom, kind, 0.012, start, start + 0.35 * vector)
    scene.ngeom += 1


def arrows(scene, data, base: int, command, velocity) -> None:
    """Add the arrows of command (green) and velocity (blue) above body `base`."""
    x, y = data.xmat[base].reshape(3, 3)[:2, 0]
    heading = np.array([[x, -y], [y, x]]) / max(np.hypot(x, y), 1e-6)
    start = data.xpos[base] + [0, 0, 0.14]
    for vector, lift, rgba in ((command, 0.0, GREEN), (velocity, 0.04, BLUE)):
        arrow(scene, start + [0, 0, lift], np.append(heading @ vector[:2], 0.0), rgba)


def camera(model, base: int) -> mujoco.MjvCamera:
    """The file's camera `track`, or one that follows body `base` at the distance of its size."""
    view = mujoco.MjvCamera()
    if any(model.camera(i).name == "track" for i in range(model.ncam)):
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera("track").id
    else:
        view.type, view.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, base
        view.distance, view.azimuth, view.elevation = 1.8, 142, -14
    return view


def options(model, base: int) -> mujoco.MjvOption:
    """What is drawn: as MuJoCo does, but contact shapes too where a robot has nothing else."""
    option = mujoco.MjvOption()
    robot = model.body_rootid[model.geom_bodyid] == base
    option.geomgroup[3] = not (model.geom_group[robot] < 3).any()
    return option


def frames(
    xml: str, text: str, base: int, episode: dict[str, np.ndarray], width=WIDTH, height=HEIGHT
):
    """Yield RGB frames `[H, W, 3]`, one a row of an episode of the file `xml`, or of the `text` there."""
    model = mjcf.model(Path(xml), text)
    data = mujoco.MjData(model)
    window = model.vis.global_
    window.offwidth, window.offheight = max(window.offwidth, width), max(window.offheight, height)
    view, option = camera(model, base), options(model, base)
    with mujoco.Renderer(model, height, width) as renderer:
        for k, qpos in enumerate(episode["qpos"]):
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, view, option)
            arrows(renderer.scene, data, base, episode["command"][k], episode["velocity"][k])
            yield renderer.render()


def main(argv: list[str]) -> None:
    """`EPISODE.npz OUT`, with OUT an .mp4, a .gif or a .png."""
    episode = dict(np.load(argv[0]))
    xml, text = str(episode.pop("xml")), str(episode.pop("text"))
    base, dt = int(episode.pop("base")), float(episode.pop("dt"))
    out = Path(argv[1])
    try:
        if out.suffix == ".png":
            from PIL import Image

            last = {name: rows[-1:] for name, rows in episode.items()}
            Image.fromarray(next(frames(xml, text, base, last, *PICTURE))).save(out, optimize=True)
            return
        import imageio_ffmpeg

        count = max(1, round(len(episode["qpos"]) * dt * FPS))
        shown = np.minimum(np.round(np.arange(count) / (FPS * dt)), len(episode["qpos"]) - 1)
        some = {name: rows[shown.astype(int)] for name, rows in episode.items()}
        pictures = frames(xml, text, base, some)
        first = next(pictures)  # without OpenGL it fails here, before anything is written
        out.open("wb").close()
        writer = imageio_ffmpeg.write_frames(
            str(out), (WIDTH, HEIGHT), fps=FPS, **ENCODE[out.suffix]
        )
        writer.send(None)
        for picture in itertools.chain([first], pictures):
            writer.send(np.ascontiguousarray(picture))
        writer.close()
    except ImportError:
        sys.exit(LACKS_PACKAGE)
    except OSError as error:
        print(f"cannot write {out}: {error.strerror or error}", file=sys.stderr)
        with contextlib.suppress(OSError):
            out.unlink(missing_ok=True)
        sys.exit(CANNOT_WRITE)


if __name__ == "__main__":
    main(sys.argv[1:])
