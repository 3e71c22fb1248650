"""Play: the command `dynappo play`, which shows a policy walking. Start reading at `command.py`.

- `command`: its flags and what it prints
- `film`: films and pictures, drawn with `policy.render`
- `page`, `page.html`, `page.js`: one HTML file that plays an episode
- `viewer`: MuJoCo's viewer, with keys that steer

No other command imports it. It imports `policy`, `physics` and `config`, and no JAX.
"""
