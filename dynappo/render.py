"""A film of a policy: C MuJoCo simulates it, and renders it headless.

Nothing here needs JAX: the observation, the actuators and the network are evaluated with NumPy. The
film is made in a process of its own (`python -m dynappo.render EPISODE.npz OUT.mp4`), because the
OpenGL backend is chosen once a process, and a backend that fails may take the process with it:
EGL is tried first, then OSMesa.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from dynappo import actuators, observe
from dynappo import robot as robot_lib

FPS, WIDTH, HEIGHT = 25, 640, 360  # software OpenGL on two cores renders about ten a second
NO_OPENGL = "no video: neither EGL nor OSMesa can render here; install libegl1 or libosmesa6"
LACKS_FFMPEG, CANNOT_WRITE = 3, 4  # exit statuses of the rendering process
NO_FFMPEG = "no video: imageio-ffmpeg is not installed; pip install 'dynappo[video]'"
# (seconds share, command vx, vy, yaw rate): what the film after training shows
TOUR = (
    (0.3, (0.8, 0.0, 0.0)),
    (0.2, (0.6, 0.0, 0.8)),
    (0.2, (0.0, 0.5, 0.0)),
    (0.3, (1.0, 0.0, 0.0)),
)


def save_params(path: Path, params: dict) -> None:
    """Write nested parameters as an npz with names like `actor/params/Dense_0/kernel`."""

    def flat(tree, prefix):
        for name, value in tree.items():
            if isinstance(value, dict):
                yield from flat(value, f"{prefix}{name}/")
            else:
                yield prefix + name, np.asarray(value)

    arrays: dict[str, Any] = dict(flat(params, ""))
    np.savez(path, **arrays)


def load_params(path: Path) -> dict:
    """What `save_params` wrote."""
    params: dict = {}
    with np.load(path) as file:
        for name in file:
            *groups, leaf = name.split("/")
            node = params
            for group in groups:
                node = node.setdefault(group, {})
            node[leaf] = file[name]
    return params


def policy(params: dict, activation: str) -> Callable[[np.ndarray], np.ndarray]:
    """The mean action of an actor's parameters, in NumPy."""
    layers = params["actor"]["params"]
    weights = [
        (np.asarray(layers[f"Dense_{i}"]["kernel"]), np.asarray(layers[f"Dense_{i}"]["bias"]))
        for i in range(len(layers))
    ]
    act = {
        "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
        "relu": lambda x: np.maximum(x, 0),
        "tanh": np.tanh,
        "swish": lambda x: x / (1 + np.exp(-x)),
    }[activation]

    def mean(obs):
        for i, (kernel, bias) in enumerate(weights):
            obs = obs @ kernel + bias
            obs = act(obs) if i < len(weights) - 1 else obs
        return obs

    return mean


def tour(seconds: float) -> Callable[[float], np.ndarray]:
    """`t -> command`: ahead, a turn, sideways, fast ahead."""
    ends = np.cumsum([share for share, _ in TOUR]) * seconds
    return lambda t: np.array(TOUR[min(int(np.searchsorted(ends, t, "right")), len(TOUR) - 1)][1])


def simulate(robot: robot_lib.Robot, config, act, command, seconds: float) -> dict[str, np.ndarray]:
    """An episode on C MuJoCo with all contacts: `qpos [T, 7 + A]`, `command` and `velocity [T, 3]`,
    and `dt` (s) between rows.

    `act(obs)` is the policy, `command(t)` what it is asked for; `velocity` is vx, vy, yaw rate in
    the base frame. `config` is a whole config, of which `task` and `physics` are read.
    """
    task, physics = config.task, config.physics
    model = robot_lib.physics_model(robot, physics)
    model.geom_conaffinity[robot.parts] = 1
    model.opt.iterations, model.opt.ls_iterations = 100, 50  # C MuJoCo, run to convergence
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home_qpos
    com = model.body_ipos[robot.base_body]
    last_action, out = np.zeros(len(robot.joint_names)), {"qpos": [], "command": [], "velocity": []}
    dt = physics.timestep * physics.substeps
    for k in range(round(seconds / dt)):
        asked = command(k * dt)
        obs = observe.observe(data.qpos, data.qvel, com, robot.default_pose, asked, last_action)
        action = act(obs)
        q_target = actuators.target(action, robot.default_pose, task.action_scale)
        for _ in range(physics.substeps):
            q, qd = data.qpos[7:], data.qvel[6:]
            data.ctrl[:] = actuators.clip_dc_motor(
                actuators.pd(q_target, q, qd, task.kp, task.kd),
                qd,
                effort_limit=task.effort_limit,
                saturation_effort=task.saturation_effort,
                velocity_limit=task.velocity_limit,
            )
            mujoco.mj_step(model, data)
        last_action = action
        _, linear, angular = observe.base_motion(data.qpos, data.qvel, com)
        out["qpos"].append(data.qpos.copy())
        out["command"].append(asked)
        out["velocity"].append(np.array([linear[0], linear[1], angular[2]]))
    return {name: np.stack(rows) for name, rows in out.items()} | {"dt": np.array(dt)}


def film(robot: robot_lib.Robot, episode: dict[str, np.ndarray], out: Path) -> str:
    """Render `episode` to an mp4 (or, by its suffix, a PNG of the last frame) at `out`.

    Returns "" if it was written, else one line that says why not and what to install.
    """
    with tempfile.TemporaryDirectory() as folder:
        npz = Path(folder) / "episode.npz"
        arrays: dict[str, Any] = {"xml": str(robot.xml), **episode}
        np.savez(npz, **arrays)
        for backend in ("egl", "osmesa"):
            environment = os.environ | {"MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
            command = [sys.executable, "-m", "dynappo.render", str(npz), str(out)]
            done = subprocess.run(command, env=environment, capture_output=True, text=True)
            if done.returncode == 0:
                return ""
            if done.returncode == LACKS_FFMPEG:
                return NO_FFMPEG
            if done.returncode == CANNOT_WRITE:
                return f"no video: {done.stderr.strip().splitlines()[-1]}"
    return NO_OPENGL


def _arrow(scene, start, vector, rgba):
    """Add an arrow to the scene: the planar velocity `vector` (m/s) at `start`, 0.35 m for 1 m/s."""
    if np.linalg.norm(vector) < 0.05 or scene.ngeom >= scene.maxgeom:
        return
    geom = scene.geoms[scene.ngeom]
    kind = mujoco.mjtGeom.mjGEOM_ARROW
    mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.zeros(9), np.float32(rgba))
    mujoco.mjv_connector(geom, kind, 0.012, start, start + 0.35 * vector)
    scene.ngeom += 1


def frames(xml: str, episode: dict[str, np.ndarray], width: int = WIDTH, height: int = HEIGHT):
    """Yield RGB frames `[H, W, 3]` of an episode; green arrow: command, blue: velocity."""
    model = mujoco.MjModel.from_xml_path(xml)
    data = mujoco.MjData(model)
    with mujoco.Renderer(model, height, width) as renderer:
        for qpos, command, velocity in zip(
            episode["qpos"], episode["command"], episode["velocity"], strict=True
        ):
            data.qpos[:] = qpos
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera="track")
            x, y = data.xmat[1].reshape(3, 3)[:2, 0]
            heading = np.array([[x, -y], [y, x]]) / np.hypot(x, y)
            start = data.xpos[1] + [0, 0, 0.14]
            for vector, lift, rgba in (
                (command, 0.0, (0.1, 0.7, 0.2, 0.9)),
                (velocity, 0.04, (0.2, 0.4, 0.9, 0.9)),
            ):
                planar = np.append(heading @ vector[:2], 0.0)
                _arrow(renderer.scene, start + [0, 0, lift], planar, rgba)
            yield renderer.render()


def main(argv: list[str]) -> None:
    """`EPISODE.npz OUT.mp4`; OUT.png writes the last frame only."""
    episode = dict(np.load(argv[0]))
    xml, dt, out = str(episode.pop("xml")), float(episode.pop("dt")), Path(argv[1])
    if out.suffix == ".png":
        from matplotlib import image

        last = {name: rows[-1:] for name, rows in episode.items()}
        image.imsave(out, next(frames(xml, last, 1280, 720)))
        return
    try:
        import imageio_ffmpeg
    except ImportError:
        sys.exit(LACKS_FFMPEG)
    skip = max(1, round(1 / (FPS * dt)))
    pictures = frames(xml, {name: rows[::skip] for name, rows in episode.items()})
    first = next(pictures)  # without OpenGL it fails here, before anything is written
    try:
        out.open("wb").close()
        writer = imageio_ffmpeg.write_frames(
            str(out), (WIDTH, HEIGHT), fps=FPS, codec="libx264", quality=7, macro_block_size=4
        )
        writer.send(None)
        for picture in itertools.chain([first], pictures):
            writer.send(np.ascontiguousarray(picture))
        writer.close()
    except OSError as error:
        print(f"cannot write {out}: {error.strerror or error}", file=sys.stderr)
        out.unlink(missing_ok=True)
        sys.exit(CANNOT_WRITE)


if __name__ == "__main__":
    main(sys.argv[1:])
