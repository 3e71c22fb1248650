"""Loads robots and simulates a control step on one of three engines. Start at `engine.py`.

- `robot`: loads a robot's file, and what the task needs to know about it
- `mjcf`: compiles an MJCF, with errors in one line; the MJCF inside a policy may read no file
- `complete`: puts in place what a robot's file lacks, and says so
- `feet`: which of a robot's shapes are its feet
- `fit`: the smallest primitive around a mesh
- `robot_contract`: checks the rules that remain
- `text`: writes a completed robot as an MJCF that needs no other file
- `rotation`: rotation matrices and quaternions
- `engine_contract`: whether an engine has what a robot's file asks for
- `kinematics`: where the feet are at given joint angles
- `actuators`: from a policy's action to joint torques
- `motors`: gives a robot the motors of a config, joint by joint
- `engine`: a control step: PD, motor limits, physics steps, contacts by geometry
- folder `warp`: a control step on a GPU, in a kernel of our own or by MuJoCo Warp
- `c_mujoco`: C MuJoCo on all cores of a CPU, one call per control step
- `randomize`: each robot's own physical parameters
- `xla_call`: lets compiled CPU programs call a Python function
- `kinds`: what joints of different legs or sides have in common
- `contacts`: how a robot's primitives touch the floor

Tasks, `policy`, `program`, `web` and the commands import it; it imports `types` and `config`. `robot`,
`mjcf`, `complete`, `feet`, `fit`, `robot_contract`, `kinematics`, `contacts`, `kinds`, `motors`, `text`,
`rotation` and `actuators` need no JAX; `engine_contract` needs it for unusual files only.
"""
