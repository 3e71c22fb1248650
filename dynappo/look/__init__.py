"""The command `python -m dynappo.look`: a robot before it is trained. Start at `command.py`.

- `command`: what it reads and prints
- `facts`: mass, joints, stability of the PD, and how it stands

No other command imports it. It imports `policy`, `physics` and `config`, and no JAX.
"""
