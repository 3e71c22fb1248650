"""The velocity task: commands, observations, rewards, resets. Start at `env.py`.

`env.make(robot, task, physics)` returns an `Env`. To change the task, change a function here and a
number in configs/: docs/task.md.

- `env`: the task as pure functions of one robot: reset, step, autoreset
- `rewards`: the terms of the reward, one function each; `payment`: matches them with weights and
  sums
- `commands`, `observe`, `pushes`: the commanded velocity, the 48 numbers a policy sees, kicks
- `view`: what policy, value function and model see of a robot; readings before, errors of sensors
- `mirror`: the mirror image of an observation and an action, from the robot's model
- `brax_env`: our task as a brax environment, and brax's environments in our trainer

The method never imports this folder: an `Env` is an argument. It imports `types`, `physics` and
`config`; `rewards`, `payment` and `observe` need no JAX, so that a policy can be played without it.
"""
