"""A training run: what happens around the compiled method, on the host. Start reading at `training.py`.

- `training`: the training sequence: check, open, build, resume, loop, finish
- `loop`: the loop over chunks of iterations
- `joint`: several runs as one program, and taken apart again
- `workdir`: the folder of a run: open it, resume it, save into it
- `checkpoint`, `log`: what a run writes while it trains
- `restore`: start from the networks of another run
- `finish`, `learning_curves`: what a run writes at its end: summary, policy, film, picture
- `nonfinite`: what is told and saved when numbers blow up
- `show`: what is printed of a run
- `stop`: ctrl-C and SIGTERM

`sweeps` and the command `train` import it; no other command does. It imports `program`, `policy`, `config`,
`schedule` and `sweep`. What a checkpoint holds is `types.TrainState`, and what `workdir.save` puts beside it.
"""
