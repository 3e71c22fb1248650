"""Play: the command `dynappo play`, which shows a policy walking. Start reading at `command.py`.

- `command`: its flags and what it prints
- `command_script`: the commands that `--command` gives: numbers, a script, a tour
- `film`: films and pictures, drawn with `policy.render`
- `serve`: the page in a browser, with folder `web`
- `task_episode`: films and pages of a policy of another package's environment
- `viewer`: MuJoCo's viewer, with keys that steer

No other command imports it. It imports `web`, `page`, `policy`, `description` and `config`, and no JAX.
"""
