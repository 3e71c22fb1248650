"""The velocity task: commands, observations, rewards, resets. Start at `env.py`.

`env.make(robot, task, physics)` returns an `Env`. To change the task, change a function here and a
number in configs/: docs/task.md.

- `env`: the task as pure functions of one robot: reset, step, autoreset
- `checks`: whether a robot can learn it
- `state`: what a robot keeps from one control step to the next
- `rewards`: the terms of the reward, one function each; `reward_sum`: matches them with weights and
  sums
- `own`: terms of one's own, in a file of one's own
- `commands`, `observe`, `pushes`: the commanded velocity, the numbers that a policy sees, kicks
- `clearance`: a curriculum of the reward for high feet
- `surroundings`: where a robot is on rough ground, and that ground: known in a tail, too
- `gait`: the gait clock of a biped
- `view`: what policy, value function and model see of a robot; earlier readings, errors of sensors
- `log_file`: what a robot's controller recorded, as a file; `logged`: the environment whose rows these are
- `partners`: which joint is the mirror image of another; needs no JAX
- `mirror`: the mirror image of an observation and an action, from the robot's model

Sizes follow from the robot: any number of joints and feet. It imports `types`, `terrain`, `physics`,
`description` and `config`; `rewards`, `reward_sum`, `observe`, `own`, `gait` and `log_file` need no JAX, so
that a policy can be played without.
"""
