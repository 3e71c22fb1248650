"""Loads robots and simulates a control step on one of three engines. Start at `engine.py`.

- `robot`: loads a robot's file, and what the task needs to know about it
- `mjcf`: compiles an MJCF, with errors in one line; what a policy carries may read no file
- `robot_contract`: checks the rules that a robot's file must keep
- `actuators`: from a policy's action to joint torques
- `motors`: a robot with the motors that a config says, joint by joint
- `engine`: a control step: PD, motor limits, physics steps, contacts by geometry
- folder `warp`: a control step on a GPU, in a kernel of our own or by MuJoCo Warp
- `c_mujoco`: C MuJoCo on all cores of a CPU, one call per control step
- `randomize`: each robot's own physical parameters
- `xla_call`: lets compiled CPU programs call a Python function
- `contacts`: how a robot's primitives touch the floor

The task and the commands import it; it imports `types` and `config`. `robot`, `mjcf`,
`robot_contract`, `contacts`, `motors` and `actuators` need no JAX.
"""
