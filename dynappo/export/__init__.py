"""Export: the command `dynappo export`, a policy for a robot or another program. See `command.py` first.

- `command`: its flags and what it prints
- `task_onnx`: of another package's environment
- `onnx_file`: the policy as an ONNX network with everything a robot needs in its metadata
- `deploy_yaml`: its settings for the controllers of unitree_rl_lab
- `joint_order`: the orders of joints that robots and simulators use

No other command imports it. It imports `policy`, `description`,
`tasks.velocity.observe` and `config`, no JAX.
"""
