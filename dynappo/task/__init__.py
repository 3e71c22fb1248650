"""What the robot is asked for and paid for. Start at `env.py`: `make(robot, task, physics) -> Env`.

- `env`: the velocity task as pure functions of one robot: reset, step, autoreset
- `rewards`, `commands`, `observe`: its terms, what it asks for, the 48 numbers a policy sees
- `mirror`: the mirror image of an observation and an action, from the robot's model
- `brax_env`: our task as a brax environment, and brax's environments under our trainer

To change the task, change a function here and a number in configs/. The method never imports this
folder: an `Env` is an argument. It imports `types`, `physics` and `config`; `rewards` and `observe` need no
JAX, so that a policy can be played without it.
"""
