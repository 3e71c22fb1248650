"""Reads, checks and plays trained policies, without JAX. Start at `policy_file.py`.

- `policy_file`: reads and writes `policy.npz`
- `policy_source`: which policy, from where, with which robot; the flags that say so
- `checks`: checks a policy's types, ranges and shapes
- `checkpoint_file`: reads the arrays of a checkpoint
- `episode`: runs a policy on a robot in C MuJoCo and NumPy
- `asked`: how fast a task asks its robot to walk and to turn
- `walks`: whether a robot walks, by an evaluation; in words too
- `task_player`: a robot of another package's environment, a control step at a time
- `recorded`: what a process with JAX tells of such an environment
- `render`: makes a film or a picture of an episode

The commands, `run`, `sweeps` and `web` import it. It imports `config`, `description`,
`physics.actuators`, `tasks.names`, `tasks.single` and, of `tasks.velocity`, `observe` and `own`.
"""
