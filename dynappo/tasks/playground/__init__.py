"""MuJoCo Playground's locomotion tasks (0.2.0) as `types.Env`: `--config=playground:TASK`.

The task itself is Playground's, unchanged: its `reset` and its `step` are called. Read in this order:

- `assets`: where the robots' meshes come from, without network
- `room`: how many constraints and contacts a robot may have in MJX-Warp
- `loading`: a task by its name, on the engine that is here
- `warp_kernels`: MJX-Warp's kernels, built side by side
- `swapped`: the task's step with physics, or noise, replaced by what is given
- `parts`: what each number of an observation is, found by probing the task
- `mirrored`: left for right, found by trying
- `known`: what of reward and end follows from what the model predicts
- `commands`: which tasks have a command, and its ranges
- `env`: the `Env`
- `settings`: Playground's PPO settings as fields of our config
- `c_physics`: C MuJoCo in the place of MJX, for one robot to be looked at, and for evaluations on a CPU
- `single`: that robot, a control step at a time

`tasks/by_name.py` and configs/playground.py import it. It imports `tasks.velocity`, `tasks.names`,
`tasks.single`, `physics`, `config`, `types` and Playground.
"""
