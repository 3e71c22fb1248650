"""Evaluate: the command `dynappo evaluate`, which measures a policy. Start reading at `command.py`.

- `command`: its flags, what it prints and writes
- `episodes`: episodes of the training task on MJX (`dynappo/evaluation.py`): return, falls, tracking
- `trials`: one trial for each command of a grid, in C MuJoCo: tracking, effort, gait
- `figures`: pictures of the trials

No other command imports it. It imports `program`, `policy`, `physics`, `task`, `config` and
`evaluation`.
"""
