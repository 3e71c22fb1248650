"""The command `python -m dynappo.export`: a policy for another program or a robot. Start at `command.py`.

- `command`: what it reads and prints
- `onnx_file`: the policy as an ONNX network with all that a robot needs in its metadata
- `joint_order`: the orders of joints that robots and simulators use

No other command imports it. It imports `policy`, `physics`, `task.observe` and `config`, and no JAX.
"""
