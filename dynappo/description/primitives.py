"""The smallest primitive around points: what a mesh, or an ellipsoid, collides as. NumPy only."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dynappo.description.contacts import BOX, CAPSULE, CYLINDER, SPHERE
from dynappo.description.rotation import quaternion

SLACK = 1.05  # of volumes: the first kind of KINDS that is no larger than this times the smallest
KINDS = {SPHERE: "sphere", CAPSULE: "capsule", BOX: "box", CYLINDER: "cylinder"}


class Primitive(NamedTuple):
    """A geom's type, size, place and frame, as MuJoCo has them."""

    kind: int
    size: np.ndarray  # [3] m
    pos: np.ndarray  # [3] m
    quat: np.ndarray  # [4]
    volume: float  # m^3

    def text(self) -> str:
        """In words: the kind, and its extent along each of its axes."""
        x, y, z = self.size
        whole = {BOX: (x, y, z), SPHERE: (x,), CAPSULE: (x, x + y), CYLINDER: (x, y)}
        return f"{KINDS[self.kind]} of {' x '.join(f'{2 * s:.3g}' for s in whole[self.kind])} m"


def around(points: np.ndarray, frames: list[np.ndarray]) -> Primitive:
    """About the smallest sphere, capsule, box or cylinder that holds `points` [P, 3].

    Its axes are those of one of `frames`, rotation matrices whose columns are the axes.
    """
    found = [one for frame in frames for one in _along(points, np.asarray(frame))]
    limit = SLACK * min(one.volume for one in found)
    simple = [one for one in found if one.volume <= limit]
    return min(simple, key=lambda one: (list(KINDS).index(one.kind), one.volume))


def _along(points: np.ndarray, frame: np.ndarray) -> list[Primitive]:
    inside = points @ frame
    low, high = inside.min(0), inside.max(0)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 1e-4)
    away = inside - middle
    radius = float(np.maximum(np.linalg.norm(away, axis=1).max(), 1e-4))
    found = [
        _primitive(BOX, half, frame, middle, 8 * half.prod()),
        _primitive(SPHERE, [radius, 0, 0], frame, middle, 4 / 3 * np.pi * radius**3),
    ]
    for axis in range(3):
        across, along = np.delete(away, axis, 1), away[:, axis]
        out = np.linalg.norm(across, axis=1)
        radius = float(np.maximum(out.max(), 1e-4))
        ends = np.sqrt(np.maximum(radius**2 - out**2, 0))
        shaft = float(np.maximum((abs(along) - ends).max(), 1e-4))
        turned = np.roll(frame, 2 - axis, 1)  # this axis becomes z
        disc = np.pi * radius**2
        found += [
            _primitive(
                CAPSULE,
                [radius, shaft, 0],
                turned,
                np.roll(middle, 2 - axis),
                disc * (2 * shaft + 4 / 3 * radius),
            ),
            _primitive(
                CYLINDER,
                [radius, half[axis], 0],
                turned,
                np.roll(middle, 2 - axis),
                disc * 2 * half[axis],
            ),
        ]
    return found


def _primitive(kind: int, size, frame: np.ndarray, middle: np.ndarray, volume: float) -> Primitive:
    return Primitive(
        kind, np.asarray(size, float), frame @ middle, quaternion(frame), float(volume)
    )


def around_ellipsoid(size: np.ndarray, frame: np.ndarray, middle: np.ndarray) -> Primitive:
    """The smaller of box and capsule around an ellipsoid of half axes `size` [3] along those of `frame`.

    The capsule lies along the longest axis c, with the second one b as radius and c - b as half
    length: it holds the ellipsoid, whose ends have the radius b^2 / c <= b.
    """
    long = int(np.argmax(size))
    b, c = np.sort(size)[1:]
    shaft = max(c - b, 1e-4)
    box = Primitive(BOX, np.array(size), middle, quaternion(frame), float(8 * np.prod(size)))
    turned = np.roll(frame, 2 - long, 1)
    volume = np.pi * b**2 * (2 * shaft + 4 / 3 * b)
    capsule = Primitive(CAPSULE, np.array([b, shaft, 0]), middle, quaternion(turned), float(volume))
    return min(box, capsule, key=lambda one: one.volume)
