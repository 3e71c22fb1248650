"""Evaluate: the command `dynappo evaluate`, which measures a policy. Start reading at `command.py`.

- `command`: its flags, what it writes; `show`: what it prints
- `episodes`: episodes of the training task on MJX (`dynappo/evaluation.py`): return, falls, tracking
- `trials`: one trial for each command of a grid, in C MuJoCo: tracking, effort, gait
- `stress`: trials with late actions, loads, slippery floors, pushes, in other physics
- `figures`: pictures of the trials

No other command imports it. It imports `program`, `policy`, `physics`, `task`, `config` and
`evaluation`.
"""
