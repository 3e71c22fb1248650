"""Reads, checks and plays trained policies, without JAX. Start at `policy_file.py`.

- `policy_file`: reads and writes `policy.npz`
- `source`: finds the policy that a name, a workdir or a path means
- `npz_file`: reads an untrusted npz file within size limits
- `checks`: checks a policy's types, ranges and shapes
- `carried`: the robot stored with a policy, compared with the one in `robots/`
- `choice`: the command-line flags that choose policy and robot
- `checkpoint_file`: reads the arrays of a checkpoint
- `episode`: runs a policy on a robot in C MuJoCo and NumPy
- `walks`: whether a robot walks, by its evaluations; in words too
- `render`: makes a film or a picture of an episode
- `beside`: makes a small GIF of several episodes side by side

The commands import it. It imports `config`, `physics` and `task.observe`.
"""
