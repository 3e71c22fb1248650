"""Evaluate: the command `dynappo evaluate`, which measures a policy. Start reading at `command.py`.

- `command`: its flags, what it writes; `tables`: what it prints
- `episodes`: episodes of the training task (`dynappo/scores.py`): return, falls, tracking
- `task_episodes`: the same of a policy of another package's environment
- `task_facts`: what `export` needs to know of such an environment
- `task_steps`: steps its robot for `play` and films, which start this as a process
- `trials`: one trial for each command of a grid, in C MuJoCo: tracking, effort, gait
- `slow`: from which speed on a robot that stands follows a command
- `spread`: trials, changes and disturbances on all cores
- `foot_motion`: how the feet move: clearance, slip, symmetry
- `changes`: falls when the command changes, and on the tours of the film and of the live page
- `crossing`: which tiles of a rough ground a policy crosses, by kind and by row
- `stress`: trials with late actions, loads, slippery floors, pushes, in other physics
- `recording`: a log as a robot's controller would write it, to learn from
- `stairs`: the same on stairs made of boxes, for policies of rough ground
- `figures`: pictures of the trials
- `report`, `report.html`: all of it on one page, with a robot that plays each command

No other command imports it. It imports `program`, `page`, `policy`, `description`, `tasks`, `physics`,
`terrain`, `config` and `scores`.
"""
