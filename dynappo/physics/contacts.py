"""How many contacts with the floor a robot can have: what MuJoCo Warp must keep room for.

By kind of primitive, as it counts them (mujoco_warp/_src/collision_primitive_core.py).
"""

from dynappo.physics import robot as robot_lib

MOST = {robot_lib.SPHERE: 1, robot_lib.CAPSULE: 2, robot_lib.CYLINDER: 4, robot_lib.BOX: 8}
ROWS_PER_CONTACT = 4  # constraint rows of a pyramidal cone with sliding friction


def most(model) -> tuple[int, int]:
    """`(contacts, constraint rows)` that one robot of a compiled model can have at most."""
    kinds = model.geom_type[model.geom_conaffinity > 0]
    contacts = sum(MOST[int(kind)] for kind in kinds)
    limits = int(model.jnt_limited.sum() + (model.dof_frictionloss > 0).sum())
    return contacts, contacts * ROWS_PER_CONTACT + limits
