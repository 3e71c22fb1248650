"""The 48 numbers a policy of the velocity task sees, from the robot's generalised coordinates.

Written once for NumPy and jax.numpy, so that a policy can be played without JAX, and computed from
qpos and qvel alone: after `mjx.step` every derived quantity is one substep old.

| part       | rows  | content                                             | unit  |
|------------|-------|-----------------------------------------------------|-------|
| prop (33)  | 0-11  | joint positions minus the default pose              | rad   |
|            | 12-23 | joint velocities                                    | rad/s |
|            | 24-26 | direction of gravity in the base frame              |       |
|            | 27-29 | velocity of the base's centre of mass, base frame   | m/s   |
|            | 30-32 | angular velocity, base frame                        | rad/s |
| ctx (15)   | 33-35 | command vx, vy, yaw rate                            | m/s, rad/s |
|            | 36-47 | previous action                                     |       |

The paper's order, o = [q, qd, g, v, w] and [c, a]: the transition model predicts prop and copies ctx.
"""

PROP_SIZE, CONTEXT_SIZE = 33, 15
JOINT_POS, JOINT_VEL = slice(0, 12), slice(12, 24)
GRAVITY, LINEAR_VELOCITY, ANGULAR_VELOCITY = slice(24, 27), slice(27, 30), slice(30, 33)
COMMAND, LAST_ACTION = slice(33, 36), slice(36, 48)


def rotate_inverse(quat, vector):
    """World `vector` [3] in the frame of the unit quaternion `quat` (w, x, y, z)."""
    xp = vector.__array_namespace__()
    w, u = quat[0], quat[1:]
    # v' = v + 2 u x (u x v) - 2 w (u x v)
    uv = xp.stack(_cross(u, vector))
    return vector + 2 * xp.stack(_cross(u, uv)) - 2 * w * uv


def _cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def heading(quat):
    """Direction of the base's x axis in the world's plane, rad from the world's x axis."""
    xp = quat.__array_namespace__()
    w, x, y, z = (quat[i] for i in range(4))
    return xp.atan2(2 * (x * y + w * z), 1 - 2 * (y**2 + z**2))


def base_motion(qpos, qvel, base_com):
    """`(gravity, linear, angular)`, each [3], in the base frame.

    `gravity` is the unit direction; `linear` (m/s) is the velocity of the base's centre of mass,
    `base_com` (m) in the base frame. A MuJoCo free joint has world linear velocity of the frame's
    origin in qvel[0:3] and local angular velocity in qvel[3:6].
    """
    xp = qpos.__array_namespace__()
    quat, angular = qpos[3:7], qvel[3:6]
    # the third row of the rotation matrix, negated: where "down" points in the base frame
    w, x, y, z = (quat[i] for i in range(4))
    gravity = -xp.stack((2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x**2 + y**2)))
    linear = rotate_inverse(quat, qvel[0:3]) + xp.stack(_cross(angular, base_com))
    return gravity, linear, angular


def observe(qpos, qvel, base_com, default_pose, command, last_action):
    """The observation [48] of one robot, without noise; see the module's table."""
    xp = qpos.__array_namespace__()
    gravity, linear, angular = base_motion(qpos, qvel, base_com)
    parts = (qpos[7:] - default_pose, qvel[6:], gravity, linear, angular, command, last_action)
    return xp.concat(parts)


def context(obs, action):
    """The copied part [15] of the observation that follows `obs` [..., 48] and `action`."""
    xp = obs.__array_namespace__()
    return xp.concat((obs[..., COMMAND], action), axis=-1)


def noise_scale(noise, xp):
    """Half widths [48] of the uniform observation noise; `noise` is the config's group."""
    parts = (
        [noise.joint_pos] * 12,
        [noise.joint_vel] * 12,
        [noise.gravity] * 3,
        [noise.linear_velocity] * 3,
        [noise.angular_velocity] * 3,
        [0.0] * CONTEXT_SIZE,
    )
    return xp.stack([xp.asarray(v) for part in parts for v in part])
