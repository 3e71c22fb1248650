"""The command `python -m dynappo.play`: see a policy walk. Start at `command.py`.

- `command`: what it reads and prints
- `film`: films and pictures, by `policy.render`
- `page`, `page.html`, `page.js`: one HTML file that plays an episode
- `viewer`: MuJoCo's viewer, with keys that steer

No other command imports it. It imports `policy`, `physics` and `config`, and no JAX.
"""
