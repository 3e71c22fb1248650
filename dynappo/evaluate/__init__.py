"""The command `python -m dynappo.evaluate`: what a policy is worth. Start at `command.py`.

- `command`: what it reads, prints and writes
- `episodes`: episodes of the training task on MJX (`dynappo/evaluation.py`): return, falls, tracking
- `trials`: one trial a command of a grid, in C MuJoCo: tracking, effort, gait
- `figures`: pictures of the trials

No other command imports it. It imports `program`, `policy`, `physics`, `task`, `config` and
`evaluation`.
"""
