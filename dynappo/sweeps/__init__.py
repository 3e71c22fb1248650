"""`dynappo train --sweep=FIELD=VALUE,VALUE`: a run for each combination of values. Start at `run.py`.

- `grid`: the combinations of a command line, validated; which of them train in one program
- `folder`: the folder of a sweep: `sweep.json`, what may change, what is done
- `together`: the loop over chunks of iterations of several runs in one program
- `run`: all combinations, one group after the other, told to a person
- `table`, `picture`: what came out: sweep.csv, sweep.png

Each combination has a folder of its own inside, and that is an ordinary run of `dynappo.train`: nothing
that plays, evaluates, exports or goes on with a run knows of sweeps. Only `train.command` imports this
folder. It imports `train` (but its `command`), `program`,
`sweep`, `config` and `policy.walks`.
"""
