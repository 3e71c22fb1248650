"""The tasks of this experiment as `types.Env`, and their settings."""

import struct
import tempfile
from pathlib import Path

import jax.numpy as jnp
from brax import envs

from dynappo.tasks import brax_env
from dynappo.types import Env

SMALL = """
rollout.num_envs=256 rollout.horizon=24 run.checkpoint_every=0 run.log_every=10
schedule.start_iteration=0 schedule.end_iteration=40
model.hidden=(128,128) model.epochs=4 model.minibatches=8 ppo.entropy_coef=0.0 ppo.init_std=0.5
""".split()
FIELDS = {
    "hopper": ["run.num_iterations=150"],
    "go1_joystick": ["run.num_iterations=120", "ppo.init_std=0.1"],
}


def hopper() -> Env:
    """brax's hopper on its spring pipeline; all 11 numbers of the observation are predicted."""
    return brax_env.from_brax(envs.get_environment("hopper", backend="spring"), prop_size=11)


def go1_joystick() -> Env:
    """Playground's Go1: 33 numbers predicted, previous action and command copied.

    Its own `last_act` is the action before the last one; here it is the last one, so that it
    follows from the row. Menagerie's meshes are for the eye only (its feet are spheres, its inertias
    are given), so where Menagerie was not cloned, a tetrahedron stands in for each.
    """
    from mujoco_playground import registry
    from mujoco_playground._src import mjx_env

    if not mjx_env.MENAGERIE_PATH.exists():
        mjx_env.MENAGERIE_PATH = tetrahedra("trunk hip thigh thigh_mirror calf".split())

    def observe(state, action):
        return jnp.concatenate([state.obs["state"][:33], action, state.info["command"]])

    return brax_env.from_brax(
        registry.load("Go1JoystickFlatTerrain", config_overrides={"impl": "jax"}),
        prop_size=33,
        observe=observe,
        advance=lambda hyper, context, prop, action, next_prop: jnp.concatenate(
            [action, context[-3:]]
        ),
        action_limit=jnp.inf,  # offsets of joint targets, not limited in Playground
        starts=1,
    )


def tetrahedra(names: list[str]) -> Path:
    """A folder like Menagerie's with an STL file of four triangles under each name."""
    folder = Path(tempfile.mkdtemp())
    assets = folder / "unitree_go1" / "assets"
    assets.mkdir(parents=True)
    corners = [(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)]
    stl = bytes(80) + struct.pack("<I", 4)
    for triangle in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)):
        points = [x for i in triangle for x in corners[i]]
        stl += struct.pack("<12f", 0, 0, 0, *points) + bytes(2)
    for name in names:
        (assets / f"{name}.stl").write_bytes(stl)
    return folder


MAKE = {"hopper": hopper, "go1_joystick": go1_joystick}
