"""A robot, and one control step of it. Start at `engine.py`.

- `robot`: a robot's file and what the task must know of it
- `mjcf`: an MJCF from anybody: what is looked at before and after MuJoCo compiles it
- `contract`: the rules that such a file keeps, checked one by one
- `actuators`: from a policy's action to joint torques
- `engine`: a control step: PD, motor limits, physics steps, contacts by geometry
- `warp_engine`: MuJoCo Warp, called with only what a step needs
- `randomize`: what makes one robot's body differ from the next
- `c_engine`: C MuJoCo on all cores of a CPU, a control step a call
- `xla_call`: a Python function that compiled CPU programs can call
- `contacts`: how a robot's primitives meet the floor

The task and the commands import it; it imports `types` and `config`. `robot`, `mjcf`,
`contract`, `contacts` and `actuators` need no JAX.
"""
