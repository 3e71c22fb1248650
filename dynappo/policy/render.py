"""Makes a film or a picture of an episode with MuJoCo's OpenGL renderer, without a display.

Nothing here needs JAX. A separate process renders
(`dynappo.policy.render EPISODE.npz OUT`), because a process can choose its OpenGL backend only once,
and a backend that fails may crash the process. On Linux EGL is tried first, then OSMesa.
`page/episode_page.py` needs neither.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

from dynappo.config import interpreter, shell
from dynappo.description import robot as robot_lib
from dynappo.physics import ground
from dynappo.policy import episode as episode_lib
from dynappo.policy import policy_file
from dynappo.policy.episode import tour
from dynappo.terrain import tiles
from dynappo.terrain.height_map import HeightMap

__all__ = ["film", "simulate", "tour"]

FILMED = ("pit_stairs", 0.3)  # the tile of a run's film, and its difficulty
# frames a second; two cores render ten to fifteen with software OpenGL
FPS = {".mp4": 25.0, ".gif": 12.5}
WIDTH, HEIGHT = 640, 360
PICTURE = 1280, 720
# values of MUJOCO_GL, in the order in which they are tried; macOS and Windows have their own OpenGL
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
PATIENCE = 20.0  # s that a second of film may take: a driver may hang
LACKS_PACKAGE, CANNOT_WRITE = 3, 4  # exit statuses of the rendering process
LACKS = "no video: {} is not installed; "
SHORTEST = 0.05  # m/s, the slowest that is drawn as an arrow
LIFT, CLEAR = (
    0.14,
    0.06,
)  # m, of arrows: the least above the base, and above the robot's highest point
GREEN, BLUE = (0.1, 0.7, 0.2, 0.9), (0.2, 0.4, 0.9, 0.9)  # arrows of command and velocity
# half a megabyte per second; without a palette of the film's own colours the sky shows bands
GIF = (
    "scale={}:-1:flags=lanczos,split[a][b];[a]palettegen=stats_mode=diff[p];"
    "[b][p]paletteuse=dither=bayer:bayer_scale=5:diff_mode=rectangle"
)
GIF_SHARE = 0.75  # of the film's width
ENCODE = {
    # half the time of the usual preset, for a file 4 % larger
    ".mp4": dict(
        codec="libx264", quality=7, macro_block_size=2, output_params=["-preset", "veryfast"]
    ),
    ".gif": dict(
        codec="gif",
        pix_fmt_out="pal8",
        macro_block_size=1,
        quality=None,
        output_params=["-loop", "0"],
    ),
}


def simulate(robot: robot_lib.Robot, config, act, command, seconds: float) -> dict[str, np.ndarray]:
    """An episode of a run's robot, with the run's config; `episode.rows` says what is in it.

    Of a run on rough ground it is on a tile of `FILMED`, or on the run's own map, which is in the episode as
    `heights`, `cell` and `corner`.
    """
    described, field = policy_file.describe(config, robot), None
    if config.task.terrain == "rough":
        field = filmed(config.task.tiles)
    player = episode_lib.load(
        robot.xml, described, described.timestep, text=robot.played, field=field
    )
    return episode_lib.play(player, act, command, seconds)


def filmed(own: Any) -> HeightMap:
    """The ground of a run's film, of the config's group `task.tiles`."""
    return ground.of_tiles(own) if own.map else tiles.single(own, *FILMED)


class Shown(NamedTuple):
    """What `film` needs of a robot, or of a scene."""

    xml: Path
    text: str
    base_body: int


def film(
    robot: robot_lib.Robot | episode_lib.Player | Shown,
    episode: dict[str, np.ndarray],
    out: Path,
    size: tuple[int, int] | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> str:
    """Render `episode` to `out`: by its suffix an mp4, a GIF, or a PNG of the last row.

    `size` is width and height (even numbers); each kind of file has a default. `tell(share)` is
    called after each frame. Returns "" if the file was written, else one line that says why not and
    what to install; OSError, one line, where no file can be written, as on a full disk. The file is written
    whole or not at all.
    """
    part = out.with_name(f".{out.stem}.part{out.suffix}")  # by its suffix ffmpeg knows the format
    try:
        problem = _rendered(robot, episode, part, size, tell)
        if not problem:
            os.replace(part, out)
        return problem
    except OSError as error:
        raise OSError(f"cannot write {out} ({error.strerror or error})") from None
    finally:
        with contextlib.suppress(OSError):
            part.unlink(missing_ok=True)


def _rendered(robot, episode: dict[str, np.ndarray], out: Path, wanted, tell) -> str:
    """`film`, which may leave half of `out` behind; its OSError says only the reason."""
    size = wanted or (PICTURE if out.suffix == ".png" else (WIDTH, HEIGHT))
    gif = wanted[0] if wanted else round(GIF_SHARE * WIDTH)
    out.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as stack:
        try:
            folder = stack.enter_context(tempfile.TemporaryDirectory())
            npz = Path(folder) / "episode.npz"
            text = robot.played if isinstance(robot, robot_lib.Robot) else robot.text
            shown: dict[str, Any] = {"xml": str(robot.xml), "text": text}
            shown |= {"base": robot.base_body}
            shown |= {name: episode[name] for name in ("qpos", "command", "velocity", "dt")}
            shown |= {n: episode[n] for n in ("pose", *HeightMap._fields) if n in episode}
            np.savez(npz, **shown)
        except OSError as error:  # no temporary folder, or a full disk
            raise OSError(f"a temporary file: {error.strerror or error}") from None
        limit = PATIENCE * (10 + float(episode["dt"]) * len(episode["qpos"]))  # s
        limit *= max(1.0, size[0] * size[1] / (PICTURE[0] * PICTURE[1]))
        for backend in BACKENDS:
            environment = os.environ | {"MUJOCO_GL": backend}
            environment |= {"PYOPENGL_PLATFORM": backend} if backend in ("egl", "osmesa") else {}
            command = [*interpreter.command("dynappo.policy.render"), str(npz), str(out)]
            command += map(str, (*size, gif))
            status, said = _process(command, environment, limit, tell)
            if status is None:
                return f"no video: rendering by {backend} took more than {limit:.0f} s"
            if status == 0:
                return ""
            if status == LACKS_PACKAGE:
                lacking = "pillow" if out.suffix == ".png" else "imageio-ffmpeg"
                return LACKS.format(lacking) + shell.install("video")
            if status == CANNOT_WRITE:
                raise OSError(said.strip().splitlines()[-1])
    return NO_OPENGL


def _process(command: list[str], environment, limit: float, tell) -> tuple[int | None, str]:
    """`(exit status, stderr)` of `command`; the status is None if it took more than `limit`
    seconds.

    The process prints the share that is done, one number a line.
    """
    late = threading.Event()
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True
        ) as process,
    ):
        timer = threading.Timer(limit, lambda: (late.set(), process.kill()))
        timer.start()
        try:
            for line in process.stdout or ():
                with contextlib.suppress(ValueError):  # a line from a driver
                    tell(float(line))
            process.wait()
        except BaseException:
            process.kill()
            raise
        finally:
            timer.cancel()
        errors.seek(0)
        return (None if late.is_set() else process.returncode), errors.read().decode(
            errors="replace"
        )


def arrow(scene, start, vector, rgba) -> None:
    """Add an arrow to the scene: planar velocity `vector` (m/s) at `start`, 0.35 m for 1 m/s."""
    if np.linalg.norm(vector) < SHORTEST or scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.float32(rgba))
    mujoco.mjv_connector(geom, kind, 0.012, start, start + 0.35 * vector)
    scene.ngeom += 1


def lift(model, data, base: int) -> float:
    """Height (m) above body `base` at which an arrow clears the robot: a humanoid's trunk is above that."""
    robot = np.flatnonzero(model.body_rootid[model.geom_bodyid] == base)
    row, box = data.geom_xmat[robot, 6:], model.geom_aabb[robot]
    top = data.geom_xpos[robot, 2] + (box[:, :3] * row).sum(-1) + (box[:, 3:] * np.abs(row)).sum(-1)
    return max(LIFT, float(top.max() - data.xpos[base, 2]) + CLEAR)


def arrows(scene, data, base: int, command, velocity) -> None:
    """Add the arrows of command (green) and velocity (blue) above body `base`."""
    x, y = data.xmat[base].reshape(3, 3)[:2, 0]
    heading = np.array([[x, -y], [y, x]]) / max(np.hypot(x, y), 1e-6)
    start = data.xpos[base] + [0, 0, lift(data.model, data, base)]
    for vector, more, rgba in ((command, 0.0, GREEN), (velocity, 0.04, BLUE)):
        arrow(scene, start + [0, 0, more], np.append(heading @ vector[:2], 0.0), rgba)


def camera(model, base: int) -> mujoco.MjvCamera:
    """The file's camera `track`, or one that follows body `base` at the distance of its size."""
    view = mujoco.MjvCamera()
    if any(model.camera(i).name == "track" for i in range(model.ncam)):
        view.type, view.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, model.camera("track").id
    else:
        view.type, view.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, base
        view.distance, view.azimuth, view.elevation = 1.8, 142, -14
    return view


def whole(model, data, base: int) -> mujoco.MjvCamera:
    """A camera that follows body `base` of the robot in `data`, and sees it and the arrows above it."""
    robot = np.flatnonzero(model.body_rootid == base)
    shapes = np.isin(model.geom_bodyid, robot)
    places = np.concatenate([data.xpos[robot], data.geom_xpos[shapes]])
    wide = np.linalg.norm(places[:, :2] - data.xpos[base, :2], axis=1).max()
    below = data.xpos[base, 2] - data.xpos[robot, 2].min()
    tall = max(below, lift(model, data, base)) + 2 * CLEAR
    view = mujoco.MjvCamera()
    view.type, view.trackbodyid = mujoco.mjtCamera.mjCAMERA_TRACKING, base
    far = 1.3 * tall / np.tan(np.deg2rad(model.vis.global_.fovy) / 2)
    view.distance, view.azimuth, view.elevation = max(far, 3.5 * wide), 142, -14
    return view


def options(model, base: int) -> mujoco.MjvOption:
    """MuJoCo's default options; contact shapes are drawn too if the robot has no other geoms."""
    option = mujoco.MjvOption()
    robot = model.body_rootid[model.geom_bodyid] == base
    option.geomgroup[3] = not (model.geom_group[robot] < 3).any()
    return option


def coarser(model, share: float) -> None:
    """Detail of round shapes and shadows for a picture of a `share` of the height that the file is for.

    It looks the same and takes half the time. A circle of n corners is off by its radius x pi^2 / 2 n^2, so
    corners go with the root of the height in pixels; a shadow's pixels with the height.
    """
    if share < 1:
        quality = model.vis.quality
        quality.numslices = max(8, round(quality.numslices * share**0.5))
        quality.numstacks = max(6, round(quality.numstacks * share**0.5))
        quality.shadowsize = max(512, round(quality.shadowsize * share))


def frames(
    xml: str,
    text: str,
    base: int,
    episode: dict[str, np.ndarray],
    width=WIDTH,
    height=HEIGHT,
    field: HeightMap | None = None,
):
    """Yield RGB frames `[H, W, 3]`, one per row of an episode; `text` is the MJCF, or file `xml`, and `field`
    the ground. An .mjb is of another package's environment.
    """
    binary = xml.endswith(".mjb")
    model = (
        mujoco.MjModel.from_binary_path(xml)
        if binary
        else episode_lib.compiled(Path(xml), text, field, drawn=True)
    )
    data = mujoco.MjData(model)
    window = model.vis.global_
    coarser(model, height / window.offheight)
    window.offwidth, window.offheight = max(window.offwidth, width), max(window.offheight, height)
    option, view = options(model, base), camera(model, base)
    if binary:  # a file's own camera may leave out the arrows
        data.qpos[:] = episode["qpos"][0]
        mujoco.mj_forward(model, data)
        view = whole(model, data, base)
    with mujoco.Renderer(model, height, width) as renderer:
        for k, qpos in enumerate(episode["qpos"]):
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            if "pose" in episode:
                place(model, data, episode["pose"][k])
            renderer.update_scene(data, view, option)
            arrows(renderer.scene, data, base, episode["command"][k], episode["velocity"][k])
            yield renderer.render()


def place(model: mujoco.MjModel, data: mujoco.MjData, pose) -> None:
    """Draw the bodies of `data` at `pose` [nbody, 7] (m, quaternion), wherever its joints would put them."""
    data.xpos[:], data.xquat[:] = pose[:, :3], pose[:, 3:]
    for body in range(model.nbody):
        mujoco.mju_quat2Mat(data.xmat[body], data.xquat[body])
    for geom, body in enumerate(model.geom_bodyid):
        where = model.geom_pos[geom], model.geom_quat[geom], body, 0
        mujoco.mj_local2Global(data, data.geom_xpos[geom], data.geom_xmat[geom], *where)


def legend(episode: dict, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    """`(colours [h, w, 3], opacity [h, w, 1])` of the arrows' legend, for the upper left corner.

    Of the arrows that a row of the episode has; empty if there is none, or without Pillow, which a film does
    not need.
    """
    none = np.zeros((0, 0, 3)), np.zeros((0, 0, 1))
    rows = [
        (rgba, name)
        for rgba, name in ((GREEN, "command"), (BLUE, "velocity"))
        if np.linalg.norm(episode[name][:, :2], axis=-1).max() >= SHORTEST
    ]
    if not rows:
        return none
    try:
        from PIL import Image, ImageDraw, ImageFont
    except ImportError:
        return none
    unit = max(4, round(min(height / 60, width / 100)))  # pixels; all sizes are multiples of it
    font = ImageFont.load_default(2.5 * unit)
    wide = round(max(font.getlength(text) for _, text in rows))
    card = Image.new("RGBA", (wide + 10 * unit, round((2 + 3.5 * len(rows)) * unit)))
    draw = ImageDraw.Draw(card)
    edges = (unit, unit, card.width - 1, card.height - 1)
    draw.rounded_rectangle(edges, unit, fill=(250, 252, 254, 200))
    for i, (rgba, text) in enumerate(rows):
        color, y = tuple(round(255 * c) for c in rgba[:3]), (3 + 3.5 * i) * unit
        draw.line([(2.2 * unit, y), (5.5 * unit, y)], color, width=max(2, unit // 2))
        head = [(5.2 * unit, y - unit), (7 * unit, y), (5.2 * unit, y + unit)]
        draw.polygon(head, color)
        draw.text((8 * unit, y), text, (22, 32, 46), font, anchor="lm")
    pixels = np.asarray(card, float)
    return pixels[..., :3], pixels[..., 3:] / 255


def with_legend(picture: np.ndarray, card: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """A copy of `picture` with `card` in its corner, cropped to fit."""
    out = np.array(picture)
    colours, opacity = (part[: out.shape[0], : out.shape[1]] for part in card)
    corner = out[: len(colours), : colours.shape[1]]
    corner[:] = np.round(corner * (1 - opacity) + colours * opacity)
    return out


def whole_film(out: Path, count: int) -> bool:
    """Whether a film has its `count` pictures: imageio-ffmpeg does not say how ffmpeg has ended."""
    import imageio_ffmpeg

    try:
        return imageio_ffmpeg.count_frames_and_secs(str(out))[0] == count
    except RuntimeError:
        return False


def main(argv: list[str]) -> None:
    """Render with arguments `EPISODE.npz OUT WIDTH HEIGHT GIF`: OUT is .mp4, .gif (GIF wide) or
    .png.

    Prints the share that is done after each frame.
    """
    episode = dict(np.load(argv[0], allow_pickle=False))
    xml, text = str(episode.pop("xml")), str(episode.pop("text"))
    base, dt, field = int(episode.pop("base")), float(episode.pop("dt")), None
    if "heights" in episode:
        heights, cell, corner = (episode.pop(name) for name in HeightMap._fields)
        field = HeightMap(heights, float(cell), (float(corner[0]), float(corner[1])))
    out, (width, height, gif) = Path(argv[1]), map(int, argv[2:5])
    try:
        if out.suffix == ".png":
            from PIL import Image

            last = {name: rows[-1:] for name, rows in episode.items()}
            picture = next(frames(xml, text, base, last, width, height, field))
            picture = with_legend(picture, legend(last, width, height))
            Image.fromarray(picture).save(out, optimize=True)
            return
        import imageio_ffmpeg

        rate = FPS[out.suffix]
        count = max(1, round(len(episode["qpos"]) * dt * rate))
        shown = np.minimum(np.round(np.arange(count) / (rate * dt)), len(episode["qpos"]) - 1)
        some = {name: rows[shown.astype(int)] for name, rows in episode.items()}
        pictures = frames(xml, text, base, some, width, height, field)
        card = legend(some, width, height)
        first = next(pictures)  # without OpenGL this fails, before anything is written
        out.open("wb").close()
        how: dict[str, Any] = dict(ENCODE[out.suffix])
        if out.suffix == ".gif":
            how["output_params"] = ["-filter_complex", GIF.format(gif), *how["output_params"]]
        writer = imageio_ffmpeg.write_frames(str(out), (width, height), fps=rate, **how)
        writer.send(None)
        for done, picture in enumerate(itertools.chain([first], pictures), 1):
            writer.send(with_legend(picture, card))
            print(done / count, flush=True)
        writer.close()
        if not whole_film(out, count):
            raise OSError
    except ImportError:
        sys.exit(LACKS_PACKAGE)
    except OSError as error:  # imageio-ffmpeg's own has many lines
        print(error.strerror or "ffmpeg has ended early; is the disk full?", file=sys.stderr)
        sys.exit(CANNOT_WRITE)


if __name__ == "__main__":
    main(sys.argv[1:])
