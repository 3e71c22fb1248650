"""Adopt: the command `dynappo adopt`, which makes a robot of a published MJCF or URDF. Start at `command.py`.

- `command`: its flags, its steps, what it prints
- `pose`: a default pose, where the file has none in which it stands
- `normal`: the form that dynappo trains: solver, feet, joints, frames
- `source`: reads the file, its meshes, its licence, and what it says of its motors
- `joint_roles`: which joint is a hip, a knee, a wrist
- `gains`: gains, limits and the action scale, from the file or by rule
- `bipeds`: what the config of a robot on two feet has of its own
- `looks`: puts the published meshes back on the completed robot
- `writing`: the texts of the three files

No other command imports it. It imports `description`, `config`, what checks a robot before training
(`physics.engine_contract`, `tasks.velocity`'s `gait`, `partners`, `reward_sum`), and no JAX.
"""
