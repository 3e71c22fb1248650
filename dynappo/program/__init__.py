"""Turns a config into a compiled program on this machine. Start at `build.py`: `program(config)`.

- `build`: robot, environment, first state, the compiled call that a run repeats
- `environment`: checks an environment of your own against `types.Env`
- `devices`: which devices and engine to use, and settings for a command's process
- `memory`: whether a run fits into memory
- `distributed`: one run over several processes

`run`, `sweeps` and the commands `train`, `bench` and `evaluate` import it. It imports the method, `tasks`,
`physics`, `description` and `config`.
"""
