"""What the robot is asked for and paid for. Start at `env.py`: `make(robot, task, physics) -> Env`.

- `env`: the velocity task as pure functions of one robot: reset, step, autoreset
- `rewards`, `payment`: the terms of the reward, one function each; finds them by their weights and sums
- `commands`, `observe`, `pushes`: what it asks for, the 48 numbers a policy sees, kicks
- `mirror`: the mirror image of an observation and an action, from the robot's model
- `brax_env`: our task as a brax environment, and brax's environments under our trainer

To change the task, change a function here and a number in configs/: docs/task.md. The method never
imports this folder: an `Env` is an argument. It imports `types`, `physics` and `config`; `rewards`,
`payment` and `observe` need no JAX, so that a policy can be played without it.
"""
