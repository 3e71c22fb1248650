"""A run for each combination of values: `dynappo train --sweep=FIELD=VALUE,VALUE`. Start at `sweep.py`.

- `sweep`: all combinations, one group after the other, told to a person
- `grid`: the combinations of a command line, validated; which of them train in one program
- `folder`: the folder of a sweep: `sweep.json`, what may change, what is done
- `table`, `picture`: what came out: sweep.csv, sweep.png

Each combination has a folder of its own inside, and that is an ordinary run of `dynappo.run`: nothing
that plays, evaluates, exports or goes on with a run knows of sweeps. Only the command `train` imports this
folder. It imports `run`, `program`, `config` and `policy.walks`.
"""
