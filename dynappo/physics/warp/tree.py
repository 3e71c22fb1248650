"""A control step of a robot that is a tree of hinges in one kernel of our own: tree.h, and its numbers.

For humanoids, hexapods, and quadrupeds whose files have more than quadruped.py takes: turned frames, joints
beside their link's origin, several in a body, feet of several shapes. A robot has a warp of 32 threads on a
GPU, so it has at most 32 joints. Phases are parallel over joints, edges of contacts or entries of the matrix,
and all numbers of a robot stay in a processor's shared memory within a control step.

As quadruped.py it solves MuJoCo's own problem by Newton's method. What makes it fast: the contacts of a foot
act only on the joints above the foot, so the Hessian has the zeros of the inertia matrix, and its factors,
too. Limbs are eliminated side by side.

The code is compiled for the sizes of a robot; which joint is where is in tables. scope.py must know all that
`numbers` and `tables` read of a model.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import mujoco
import numpy as np
import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.description import contacts
from dynappo.description.rotation import matrix
from dynappo.physics.warp import arrays, native

THREADS = 32  # of a robot on a GPU
RHS, OWN = 6, 7  # tree.h
# where the numbers are: of the whole, of a link, of a point of contact, of a part
WHOLE = dict(TIMESTEP=0, GRAVITY=1, TOLERANCE=2)
LINK_AT = dict(PLACE=0, AXIS=3, TURN=6, REF=10, LOW=11, HIGH=12, DAMPING=13, LIMIT=14)
POINT_AT = dict(MORE=3, RADIUS=6, CONTACT=7)  # and PLACE
PART_AT = dict(PART=17)
KINDS = dict(SPHERE=contacts.SPHERE, CAPSULE=contacts.CAPSULE, BOX=contacts.BOX)
FAR = 1e9  # rad, the range of a joint that has none


class Frame(NamedTuple):
    """Where a body is in its link: what moves together, from the anchor of its last joint, in its axes."""

    link: int  # that of joint 1 + link; the base is the last
    place: np.ndarray  # [3]
    turn: np.ndarray  # [3, 3]


class Tree(NamedTuple):
    """The links of a robot, without their numbers."""

    frames: list[Frame]  # of the bodies but the world
    parent: np.ndarray  # [A] link above a joint
    place: np.ndarray  # [A, 3] of its anchor in the link above
    turn: np.ndarray  # [A, 3, 3] of its link, at its `ref`
    chains: list[list[int]]  # the joints from the base to a joint, itself too


def tree(model: mujoco.MjModel) -> Tree:
    """Joints share a body, or a body has none: a link for every joint, with all that is fixed to it."""
    base = model.njnt - 1
    frames = [Frame(base, np.zeros(3), np.eye(3))]
    parent, places, turns, chains = [], [], [], []
    for body in range(2, model.nbody):
        above = frames[model.body_parentid[body] - 1]
        link, place = above.link, above.place + above.turn @ model.body_pos[body]
        turn = above.turn @ matrix(model.body_quat[body])
        first = model.body_jntadr[body]
        for joint in range(first, first + model.body_jntnum[body]):
            anchor = model.jnt_pos[joint]
            parent.append(link)
            places.append(place + turn @ anchor)
            turns.append(turn)
            chains.append([*(chains[link] if link < base else []), joint - 1])
            link, place, turn = joint - 1, -anchor, np.eye(3)
        frames.append(Frame(link, place, turn))
    return Tree(frames, np.array(parent), np.array(places), np.array(turns), chains)


class Point(NamedTuple):
    """A point of a foot that may touch the floor."""

    foot: int  # in the kernel's order
    geom: int
    kind: int
    place: np.ndarray  # of a sphere, of a capsule's end, of a box's middle, in the link
    more: np.ndarray  # a capsule's axis; from a box's middle to a corner


def points(
    model: mujoco.MjModel, shape: arrays.Shape, limbs: Tree
) -> tuple[np.ndarray, list[Point]]:
    """`(feet, points)`: the feet in the order of their links, so that those below a joint are neighbours,
    and their points foot by foot."""
    links = [limbs.frames[model.geom_bodyid[shape.feet[i]] - 1].link for i in shape.first[:-1]]
    order, found = np.argsort(links, kind="stable"), []
    for foot, number in enumerate(order):
        for geom in shape.feet[shape.first[number] : shape.first[number + 1]]:
            place, turn = _in_link(model, limbs, geom)
            kind, size = int(model.geom_type[geom]), model.geom_size[geom]
            if kind == contacts.SPHERE:
                ends = [(place, np.zeros(3))]
            elif kind == contacts.CAPSULE:
                ends = [(place + way * size[1] * turn[:, 2], turn[:, 2]) for way in (1, -1)]
            else:  # one of each two opposite corners
                corners = [(x, y, 1) * size for x in (1, -1) for y in (1, -1)]
                ends = [(place, turn @ corner) for corner in corners]
            found += [Point(foot, int(geom), kind, *end) for end in ends]
    return order, found


def _in_link(model, limbs: Tree, geom) -> tuple[np.ndarray, np.ndarray]:
    """Place and rotation of a geom in its link."""
    frame = limbs.frames[model.geom_bodyid[geom] - 1]
    turn = frame.turn @ matrix(model.geom_quat[geom])
    return frame.place + frame.turn @ model.geom_pos[geom], turn


def numbers(model: mujoco.MjModel, limbs: Tree, ends: list[Point]) -> dict[str, np.ndarray]:
    """What all robots share, by the names that tree.h has for their places."""
    opt, joints = model.opt, slice(1, model.njnt)
    limited = model.jnt_limited[joints, None].astype(bool)
    limits = [
        native.constraint(
            model, model.jnt_solref[j], model.jnt_solimp[j], model.dof_invweight0[j + 5]
        )
        for j in range(1, model.njnt)
    ]
    links = [
        limbs.place,
        model.jnt_axis[joints],
        [_quaternion(turn) for turn in limbs.turn],
        model.qpos0[7:, None],
        np.where(limited, model.jnt_range[joints], [-FAR, FAR]),
        model.dof_damping[6:, None],
        limits,
    ]
    touching = [
        [
            *end.place,
            *end.more,
            model.geom_size[end.geom, 0] * (end.kind != contacts.BOX),
            *native.constraint(
                model,
                model.geom_solref[end.geom],
                model.geom_solimp[end.geom],
                model.body_invweight0[model.geom_bodyid[end.geom], 0] / opt.impratio,
            ),
        ]
        for end in ends
    ]
    bodies = [
        [*frame.place, *frame.turn.ravel(), *(frame.turn @ matrix(model.body_iquat[b])).ravel()]
        for b in _bodies(limbs)
        for frame in [limbs.frames[b - 1]]
    ]
    return {
        "WHOLE": np.array([opt.timestep, opt.gravity[2], opt.tolerance]),
        "LINK": np.column_stack(links).T,  # side by side for threads that are
        "POINT": np.array(touching).T,
        "BODY": np.array(bodies),
    }


def _bodies(limbs: Tree) -> np.ndarray:
    """Bodies in the order of their links."""
    return 1 + np.argsort([frame.link for frame in limbs.frames], kind="stable")


def _quaternion(turn: np.ndarray) -> np.ndarray:
    """x, y, z, w."""
    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ascontiguousarray(turn).ravel())
    return np.roll(found, -1)


def tables(
    model: mujoco.MjModel, shape: arrays.Shape, limbs: Tree, order: np.ndarray, ends: list[Point]
) -> dict[str, np.ndarray]:
    """Which joint, foot or entry is where, by the names that tree.h has for their places."""
    joints, chains = len(limbs.chains), limbs.chains
    depth = np.array([len(chain) for chain in chains])
    rounds = _rounds(depth.max())
    above = np.zeros((depth.max(), joints), int)
    up = np.full((rounds, joints), -1)
    for j, chain in enumerate(chains):
        above[: len(chain), j] = chain
        for r in range(rounds):
            if len(chain) > 2**r:
                up[r, j] = chain[-1 - 2**r]
    down = [np.flatnonzero(row == j) for row in up for j in range(joints)]
    end = [1 + max(k for k in range(joints) if j in chains[k]) for j in range(joints)]
    entries = [  # of a depth's joints, against the base, the right-hand side, the joints above
        [j + 2**8 * c + 2**16 * end[j] for j in np.flatnonzero(depth == d) for c in range(OWN + d)]
        for d in range(1, depth.max() + 1)
    ]
    across = -max(map(len, entries)) // THREADS * -THREADS
    foot_link = [
        limbs.frames[model.geom_bodyid[shape.feet[shape.first[f]]] - 1].link for f in order
    ]
    feet = np.arange(len(order))
    link_of = [frame.link for frame in limbs.frames]
    pairs = [(a, b) for a in range(6) for b in range(a + 1)] + [(a, RHS) for a in range(6)]
    found = {
        "LEVEL": depth,
        "ABOVE": above,
        "END": end,
        "UP": up,
        "DOWN_FIRST": _starts(down),
        "DOWN": np.concatenate(down),
        "ROOT": np.flatnonzero(depth == 1),
        "ENTRY": [row + [0] * (across - len(row)) for row in entries],
        "PAIR": [a + 256 * b for a, b in pairs],
        "BODY_FIRST": np.searchsorted(np.sort(link_of), np.arange(joints + 2)),
        "BODY_ID": _bodies(limbs),
        "FOOT_LINK": foot_link,
        "FOOT_ID": order,
        "FOOT_FIRST": np.searchsorted(foot_link, np.arange(joints)),
        "FOOT_END": np.searchsorted(foot_link, end),
        "POINT_FIRST": np.searchsorted([one.foot for one in ends], np.append(feet, len(feet))),
        "POINT_FOOT": [one.foot for one in ends],
        "POINT_KIND": [one.kind for one in ends],
        "POINT_GEOM": [one.geom for one in ends],
        "PART_LINK": [limbs.frames[b - 1].link for b in model.geom_bodyid[shape.parts]],
    }
    if shape.ground is not None:
        of = contacts.probes(model, shape.parts).geom
        found["PROBE_FIRST"] = np.searchsorted(of, np.arange(len(shape.parts) + 1))
    return {name: np.asarray(value, int) for name, value in found.items()}


def _rounds(depth: int) -> int:
    """How often a chain of joints is halved until one is left."""
    return int(depth - 1).bit_length()


def _starts(lists) -> np.ndarray:
    """Where each of `lists` begins when they are put together, and the last's end."""
    return np.concatenate([[0], np.cumsum([len(one) for one in lists])])


def parts(model: mujoco.MjModel, shape: arrays.Shape, limbs: Tree) -> np.ndarray:
    """[G, PART]: place and rotation of each in its link, and `contacts.floor_distance`."""
    rows = [
        [*place, *turn.ravel(), *floor]
        for geom, floor in zip(shape.parts, shape.floor, strict=True)
        for place, turn in [_in_link(model, limbs, geom)]
    ]
    return np.array(rows, np.float32).reshape(-1, PART_AT["PART"])


def probes(model: mujoco.MjModel, shape: arrays.Shape, limbs: Tree) -> np.ndarray:
    """[P, PROBE], of the parts' probes (contacts.py) for ground that is not flat: place and axis of the ring
    in the link, radius, ring."""
    found, rows = contacts.probes(model, shape.parts), []
    for number, place, radius, ring in zip(*found, strict=True):
        middle, turn = _in_link(model, limbs, shape.parts[number])
        rows.append([*(middle + turn @ place), *turn[:, 2], radius, ring, number, 0])
    return np.array(rows, np.float32).reshape(-1, native.PROBE)


def _places(of: dict[str, np.ndarray]) -> dict[str, int]:
    """Where each array begins when they are put together."""
    return dict(zip(of, _starts([x.ravel() for x in of.values()])[:-1].tolist(), strict=True))


class Buffers(NamedTuple):
    """What Warp keeps on one device."""

    step: Any  # the kernel
    numbers: list[Any]  # its first arguments
    gpu: bool


def allocate(mj_model: mujoco.MjModel, shape: arrays.Shape, _: int = 0) -> Buffers:
    """On the current device."""
    limbs = tree(mj_model)
    order, ends = points(mj_model, shape, limbs)
    floats, ints = numbers(mj_model, limbs, ends), tables(mj_model, shape, limbs, order, ends)
    depth = ints["LEVEL"].max()
    sizes = dict(JOINTS=len(limbs.chains), DEPTH=depth, ROUNDS=_rounds(depth), FEET=len(order))
    sizes |= dict(POINTS=len(ends), PARTS=len(shape.parts), ROOTS=len(ints["ROOT"]))
    sizes |= dict(ACROSS=ints["ENTRY"].shape[1], DAMPED=int(mj_model.dof_damping.any()))
    places = LINK_AT | POINT_AT | PART_AT | native.CONSTRAINT_AT | KINDS
    places |= WHOLE | _places(floats) | _places(ints)
    rough = shape.ground is not None
    if shape.ground is not None:
        floats = floats | {"MAP": arrays.map_numbers(shape.ground)}
        places |= dict(MAP=_places(floats)["MAP"], PART=native.PROBE)
    step = native.kernel(native.code(sizes | places, "tree", rough=rough))
    opt = mj_model.opt
    flat = [np.concatenate([x.ravel() for x in of.values()]) for of in (floats, ints)]
    given = [
        shape.substeps,
        int(opt.iterations),
        int(opt.ls_iterations),
        int(shape.every_substep),
        wp.array(flat[0], dtype=float),
        wp.array(flat[1], dtype=int),
        wp.array2d((probes if rough else parts)(mj_model, shape, limbs), dtype=float),
    ]
    return Buffers(step, given, wp.get_device().is_cuda)


def control_step(buffers: Buffers, _: arrays.Shape, a: dict[str, Any]) -> None:
    """All physics steps of a control step, on the arrays `a` of `warp.arrays.sizes`."""
    native.launch(buffers.step, THREADS if buffers.gpu else 1, buffers.numbers, a)
