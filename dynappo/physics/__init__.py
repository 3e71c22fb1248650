"""A robot, and one control step of it. Start at `engine.py`.

- `robot`: a robot's file, checked rule by rule against the contract
- `actuators`: from a policy's action to joint torques
- `engine`: a control step: PD, motor limits, physics steps, contacts by geometry
- `warp_engine`: MuJoCo Warp, called with only what a step needs
- `randomize`: what makes one robot's body differ from the next
- `contacts`: how many contacts a robot can have, for which an engine keeps room

The task and the commands import it; it imports `types` and `config`. `robot` and `actuators` need no JAX.
"""
