"""A run for each combination of values: `dynappo train --sweep=FIELD=VALUE,VALUE`. Start at `sweep.py`.

- `sweep`: trains all combinations, one group after the other, and reports to the user
- `grid`: the combinations of a command line, validated; which of them train in one program
- `folder`: the folder of a sweep: `sweep.json`, what may change, what is done
- `table`, `sweep_picture`: the results: sweep.csv, sweep.png

Each combination has a folder of its own inside, an ordinary run of `dynappo.run`. So code that plays,
evaluates, exports or resumes a run knows nothing of sweeps. Only the command `train` imports this folder. It
imports `run`, `program`, `config` and `policy`.
"""
