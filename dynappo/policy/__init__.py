"""A trained policy: its file, and an episode of it in C MuJoCo. Start at `policy_file.py`.

- `policy_file`: `policy.npz`
- `source`: what a name, a workdir or a path means
- `npz_file`: an npz file from anybody, read within bounds
- `checks`: what a policy must be: types, ranges, shapes
- `carried`: the robot that a policy carries with it, and the one of its name here
- `choice`: the flags that say which policy and which robot
- `checkpoint_file`: the arrays of a checkpoint, read without JAX
- `episode`: a robot under a policy in C MuJoCo and NumPy
- `render`: a film or a picture of an episode
- `beside`: a small GIF of several episodes side by side

Shared by the commands. Nothing here needs JAX. It imports `config`, `physics` and `task.observe`.
"""
