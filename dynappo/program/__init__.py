"""From a config to a compiled program on this machine. Start at `build.py`: `program(config)`.

- `build`: robot, environment, first state, the compiled call that a run repeats
- `environment`: one of the user's own in place of the robot's: is it what `types.Env` asks for?
- `devices`: which devices and engine, and what a command sets for its own process
- `memory`: whether it fits
- `distributed`: one run over several processes; `meeting`: where they meet

Shared by the commands `train`, `bench` and `evaluate`. It imports the method, `task`,
`physics` and `config`.
"""
