"""A control step on one of three engines. Start at `engine.py`.

- `engine`: a control step: PD, motor limits, physics steps, contacts by geometry
- folder `warp`: a control step on a GPU, in a kernel of our own or by MuJoCo Warp
- `c_mujoco`: C MuJoCo on all cores of a CPU, one call per control step
- `ground`: how high a point is above it; a height map as MuJoCo's floor
- `engine_contract`: whether an engine has what a robot's file asks for
- `actuators`: from a policy's action to joint torques
- `randomize`: each robot's own physical parameters
- `cores`: how many cores a process may use
- `xla_call`: lets compiled CPU programs call a Python function

Tasks, `policy`, `program` and some commands import it; it imports `terrain`, `description`, `types`
and `config`.
`actuators` needs no JAX; `engine_contract` needs it for unusual files only.
"""
