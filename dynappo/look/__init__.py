"""Look: the command `dynappo look`, which checks a robot before training. Start reading at `command.py`.

- `command`: its flags and what it prints
- `picture`: the robot as it looks, and the shapes that touch the floor
- `ground`: a picture of a rough ground, from above
- `facts`: mass, joints, stability of the PD, and how it stands

No other command imports it. It imports `policy`, `physics`, `description`,
`tasks.velocity.partners`, `terrain` and `config`, and no JAX.
"""
