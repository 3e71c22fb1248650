"""Contact as `engine_lib.simulate` reads it off a pose, against C MuJoCo's collision detection.

The shipped function runs with `mjx.step` replaced by MJX's kinematics: then it moves nothing, and
tells the lowest point of each part and which feet are down in the pose it was given, in the single
precision of training. MuJoCo gets the same numbers and the model in which every part collides.
"""

import pathlib
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from dynappo import config
from dynappo.physics import engine as engine_lib
from dynappo.physics import robot

ROBOTS = sorted(p.stem for p in pathlib.Path(__file__).parents[1].glob("robots/*/*.xml"))
POSES = 10_000
NEAR = 0.02  # m from the floor
ROUNDING = 2e-6  # m, of single precision at the end of a leg; measured 6e-7


def shipped(loaded, settings):
    """`read(qpos [N, 19]) -> (lowest [N, G], down [N, F])` by `engine_lib.simulate`."""
    engine = engine_lib.make(loaded, settings.physics, frozenset(), "jax")
    hyper = config.split(settings)[1].task
    body = SimpleNamespace(kp_scale=1.0, kd_scale=1.0)
    timers = ("air_steps", "contact_steps", "last_air_steps")

    def read_one(qpos):
        rest = dict.fromkeys(("qvel", "qacc_warmstart"), jnp.zeros(18))
        rest |= dict.fromkeys(timers, jnp.zeros(4, jnp.int32))
        state: Any = SimpleNamespace(qpos=qpos, **rest)
        after = engine_lib.simulate(engine, hyper, body, state, jnp.zeros(12))
        return after.lowest, after.contact_steps > 0

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine_lib.mjx, "step", engine_lib.mjx.kinematics)
        shape = jax.ShapeDtypeStruct((POSES, 19), jnp.float32)
        compiled = jax.jit(jax.vmap(read_one)).lower(shape).compile()

    def read(qpos):
        # all at once: a fusion of jaxlib 0.10.2 was wrong in large batches only (dynappo/__init__.py)
        return [np.asarray(found) for found in compiled(qpos)]

    return read


def collisions(model, loaded, poses):
    """By C MuJoCo: `(dist [N, G + F], height [N, F])`, the smallest `dist` of each geom's contacts
    with the floor (inf: none) and the lowest points of the feet."""
    data, geoms = mujoco.MjData(model), [*loaded.parts, *loaded.feet]
    column = np.full(model.ngeom, -1)
    column[geoms] = np.arange(len(geoms))
    dist, height = np.full((POSES, len(geoms)), np.inf), np.empty((POSES, 4))
    for i, pose in enumerate(poses):
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        pairs = data.contact.geom
        assert (pairs[:, 0] == model.geom("floor").id).all()
        np.minimum.at(dist[i], column[pairs[:, 1]], data.contact.dist)
        height[i] = data.geom_xpos[loaded.feet, 2] - loaded.foot_radius
    return dist, height


@pytest.fixture(scope="module", params=ROBOTS)
def seen(request):
    """How both see 10,000 poses with the lowest part at the floor, and 10,000 with `any` one there.

    Any attitude and any joint angles in their ranges; "at the floor" is within 2 cm of it, and
    `any` is a part or foot drawn anew for each pose.
    """
    loaded = robot.load(request.param)
    settings = config.load(f"{request.param}.py")
    settings.physics.contacts = "full"
    model = robot.physics_model(loaded, settings.physics)
    assert not model.geom_margin.any()  # contacts are those with dist <= 0
    read, rng = shipped(loaded, settings), np.random.default_rng(0)

    def look(poses):
        (lowest, down), (dist, height) = read(poses), collisions(model, loaded, poses)
        touch = np.concatenate([lowest < 0, down], axis=-1)
        return SimpleNamespace(touch=touch, lowest=np.hstack([lowest, height]), dist=dist)

    def draw(choose):
        quat = rng.normal(size=(POSES, 4))
        poses = np.zeros((POSES, 19), np.float32)
        poses[:, 3:7] = quat / np.linalg.norm(quat, axis=-1, keepdims=True)
        poses[:, 7:] = rng.uniform(*model.jnt_range[1:].T, size=(POSES, 12))
        poses[:, 2] = rng.uniform(-NEAR, NEAR, POSES) - choose(look(poses).lowest)
        return look(poses)

    parts = len(loaded.parts)
    return SimpleNamespace(
        parts=parts,
        geoms=np.array([model.geom(i).name for i in (*loaded.parts, *loaded.feet)]),
        lowest=draw(lambda x: x[:, :parts].min(axis=-1)),
        any=draw(lambda x: x[np.arange(POSES), rng.integers(x.shape[1], size=POSES)]),
    )


def test_every_part_and_foot_is_at_the_floor_in_many_poses(seen):
    """So that the tests below are about it."""
    falls = seen.lowest.touch[:, : seen.parts].any(axis=-1)
    assert 0.45 < falls.mean() < 0.55
    near = (np.abs(seen.any.lowest) < NEAR).sum(axis=0)
    below = ((-NEAR < seen.any.lowest) & seen.any.touch).sum(axis=0)
    assert (near > 500).all() and (below > 200).all() and (near - below > 200).all()


@pytest.mark.parametrize("kind", ["lowest", "any"])
def test_geometry_and_collision_detection_agree_on_what_touches_the_floor(seen, kind):
    """A pose agrees if each of its parts and feet does. Measured: all poses of all robots; what a
    machine of other rounding may leave is to the micrometre at the floor."""
    view = getattr(seen, kind)
    wrong = view.touch != (view.dist < 0)
    rows, columns = np.nonzero(wrong)
    worst = np.argsort(-np.abs(view.lowest[wrong]))[:5]
    places = zip(columns[worst], view.lowest[wrong][worst], view.dist[wrong][worst], strict=True)
    text = f"{len(set(rows))} of {POSES} poses disagree; geom, lowest point (m), contact (m): "
    text += ", ".join(f"{seen.geoms[i]} {low:.1e} {dist:.1e}" for i, low, dist in places)
    assert len(set(rows)) <= 0.001 * POSES, text
    assert (np.abs(view.lowest[wrong]) < ROUNDING).all(), text


@pytest.mark.parametrize("kind", ["lowest", "any"])
def test_the_lowest_point_is_as_deep_as_the_deepest_contact(seen, kind):
    view = getattr(seen, kind)
    both = view.touch & (view.dist < 0)
    assert both.sum() > POSES / 2
    error = np.where(both, np.abs(view.lowest - np.where(both, view.dist, 0)), 0)
    geom = seen.geoms[error.max(axis=0).argmax()]
    assert error.max() < ROUNDING, f"{geom}: {error.max():.1e} m"
