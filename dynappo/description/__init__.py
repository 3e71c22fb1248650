"""What a robot's file says, from a published MJCF or URDF to what a task needs to know. Start at `robot.py`.

- `robot`: loads a robot's file; its legs, feet, parts and default pose
- `mjcf`: compiles an MJCF, with errors in one line; the MJCF inside a policy may read no file
- `complete`: puts in place what a robot's file lacks, and says so: the steps; one robot, floor and camera
- `collision`, `joints`, `home_pose`: its steps for shapes and masses, for joints and motors, for keyframes
- `feet`: which of a robot's shapes are its feet
- `primitives`: the smallest primitive around a mesh
- `robot_contract`: checks the rules that remain
- `faults`: reads a file that was refused once more, for all that is wrong with it
- `motors`: gives a robot the motors of a config, joint by joint
- `text`: writes a completed robot as an MJCF that needs no other file
- `kinematics`: where the feet are at given joint angles
- `contacts`: how a robot's primitives touch the floor
- `kinds`: what joints of different legs or sides have in common
- `rotation`: rotation matrices and quaternions

It needs no JAX. `physics`, tasks, `policy`, `program`, `web` and the commands import it; it imports `config`.
"""
