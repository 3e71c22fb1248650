"""The tasks that can be trained: each module or folder here makes a `types.Env`.

- folder `velocity`: robots that follow a commanded velocity
- `of_robots`: which task of robots a config trains, for `program`
- `by_name`: environments of other packages that a config names, for `program` and `evaluate`
- `names`: the names of these, without importing their packages
- `single`: one robot of these, to be looked at
- folder `playground`: MuJoCo Playground's locomotion tasks
- `brax_env`: the environments of brax and MuJoCo Playground, and ours as a brax environment
- `brax_named`: brax's by their names, trained, drawn and exported
- `env_contract`: checks an environment of your own against what `types.Env` asks for

To add a task, write a module, or a folder of modules, with a function that returns an `Env`, and a branch
in `of_robots`; there is no registry. A climb over rough ground may import what it shares with `velocity`,
such as `commands`. Tasks import `terrain`, `physics`, `description`, `config` and `types`. The method imports
no task, because an `Env` is its argument. `brax_env` and `brax_named` alone import brax.

Why `tasks` and not `envs`: two folders differ in commands and rewards. `Env` is the type that all of them
return, and the config's group is `task`.
"""
