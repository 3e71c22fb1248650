"""What is trained: each module or folder here makes a `types.Env`.

- folder `velocity`: robots that follow a commanded velocity
- `brax_env`: the environments of brax and MuJoCo Playground, and ours as a brax environment
- `env_contract`: checks an environment of your own against what `types.Env` asks for

To add a task, write a module, or a folder of modules, with a function that returns an `Env`; nothing is
registered. A biped's walk or a climb over rough ground may take from `velocity` what it shares with it, such
as `commands`. Tasks import `physics`, `config` and `types`. The method imports none of them, because an `Env`
is an argument; `program` and the commands say which one they train. `brax_env` alone imports brax.

Why `tasks` and not `envs`: what differs between two folders is what the robot is asked to do and what it is
paid for. `Env` is the type that all of them return, and the config's group is `task`.
"""
