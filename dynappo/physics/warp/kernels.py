"""Warp kernels of `general`: what `engine.simulate` does between physics steps on other engines.

Each is one launch where XLA would run a loop of small kernels around every physics step, and a
CUDA graph holds them together with MuJoCo Warp's own.
"""

# Warp compiles these functions; for Python its arrays cannot be indexed
# pyright: reportIndexIssue=false, reportGeneralTypeIssues=false, reportAssignmentType=false
# pyright: reportAttributeAccessIssue=false
# pyright: reportArgumentType=false, reportCallIssue=false, reportOperatorIssue=false

import warp as wp  # pyright: ignore[reportMissingImports]

from dynappo.physics.actuators import FRICTION_SPEED

BASE = 6  # degrees of freedom of the base, before the joints'


@wp.kernel
def motors(
    substep: int,
    target: wp.array3d[float],  # [W, n, A] rad
    motor: wp.array3d[float],  # [W, 1 or A, 8], arrays.MOTOR
    qpos: wp.array2d[float],
    qvel: wp.array2d[float],
    torque: wp.array2d[float],  # [W, A] N m; before: of the last physics step
    applied: wp.array2d[float],  # [W, nv] N m, what acts on the joints beside the motors
    qd_before: wp.array2d[float],
):
    """The motors' torques (actuators.py: `pd`, `clip_dc_motor`, `lag`), and the joints' `friction`."""
    robot, joint = wp.tid()
    dof, p = joint + wp.static(BASE), motor[robot, wp.min(joint, motor.shape[1] - 1)]
    qd, effort, saturation, speed = qvel[robot, dof], p[2], p[3], p[4]
    t = p[0] * (target[robot, substep, joint] - qpos[robot, dof + 1]) - p[1] * qd
    most = speed * (1.0 + effort / saturation)
    slope = wp.clamp(qd, -most, most) / speed
    upper, lower = (
        wp.min(saturation * (1.0 - slope), effort),
        wp.max(saturation * (-1.0 - slope), -effort),
    )
    if t > upper:  # compared so that a torque that is no number stays none
        t = upper
    elif t < lower:
        t = lower
    t = t * p[5]
    if p[7] < 1.0:
        before = torque[robot, joint]
        t = before + p[7] * (t - before)
    torque[robot, joint] = t
    applied[robot, dof] = -p[6] * wp.tanh(qd / wp.static(FRICTION_SPEED))
    qd_before[robot, joint] = qd


@wp.func
def _lowest(distance: wp.array[float], at: wp.vec3, turn: wp.mat33):
    """`contacts.lowest` of a geom; `distance` [5]: fixed, linear, ring."""
    x, y, z = turn[2, 0], turn[2, 1], turn[2, 2]
    drop = distance[0] + (
        distance[1] * wp.abs(x) + distance[2] * wp.abs(y) + distance[3] * wp.abs(z)
    )
    return at[2] - (drop + distance[4] * wp.sqrt(wp.max(1.0 - z * z, 0.0)))


@wp.func
def foot(
    robot: int,
    i: int,
    height: float,  # m, of its lowest point above the ground
    air_steps: wp.array2d[int],
    contact_steps: wp.array2d[int],
    last_air_steps: wp.array2d[int],
    peak: wp.array2d[float],
    last_peak: wp.array2d[float],
):
    """A foot's timers and heights after one more physics step (engine.py: `_feet`)."""
    contact = height < 0.0
    if contact and air_steps[robot, i] > 0:
        last_air_steps[robot, i] = air_steps[robot, i] + 1
        last_peak[robot, i] = peak[robot, i]
    if contact:
        air_steps[robot, i] = 0
        contact_steps[robot, i] = contact_steps[robot, i] + 1
        peak[robot, i] = 0.0
    else:
        air_steps[robot, i] = air_steps[robot, i] + 1
        contact_steps[robot, i] = 0
        if not (height <= peak[robot, i]):
            peak[robot, i] = height


@wp.kernel
def keep(
    every: int,  # 1: parts in every physics step, 0: only in the last
    substep: int,
    last: int,
    first: wp.array[int],  # [F + 1] where each foot's shapes begin
    feet: wp.array[int],  # [S]
    soles: wp.array2d[float],  # [S, 5]
    parts: wp.array[int],
    floor: wp.array2d[float],  # [G, 5]
    geom_xpos: wp.array2d[wp.vec3],
    geom_xmat: wp.array2d[wp.mat33],
    air_steps: wp.array2d[int],
    contact_steps: wp.array2d[int],
    last_air_steps: wp.array2d[int],
    peak: wp.array2d[float],
    last_peak: wp.array2d[float],
    lowest: wp.array2d[float],
):
    """The feet's timers and heights (engine.py: `_feet`), and the parts' lowest points."""
    robot, i = wp.tid()
    count = first.shape[0] - 1
    if i < count:
        height = wp.float32(wp.inf)
        for k in range(first[i], first[i + 1]):
            sole = _lowest(soles[k], geom_xpos[robot, feet[k]], geom_xmat[robot, feet[k]])
            if not (sole >= height):  # not `min`, which would lose what is no number
                height = sole
        foot(robot, i, height, air_steps, contact_steps, last_air_steps, peak, last_peak)
        return
    if every == 0 and substep < last:
        return
    part = i - count
    point = _lowest(floor[part], geom_xpos[robot, parts[part]], geom_xmat[robot, parts[part]])
    if every == 0 or substep == 0 or not (point >= lowest[robot, part]):
        lowest[robot, part] = point
