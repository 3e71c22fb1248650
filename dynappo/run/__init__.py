"""A training run: what happens around the compiled method, on the host. Start reading at `training.py`.

- `training`: the training sequence: check, open, build, resume, loop, finish
- `loop`: the loop over chunks of iterations
- `merged`: runs several runs as one program, and takes their results apart
- `workdir`: the folder of a run: open it, resume it, save into it
- `checkpoint`, `log`: what a run writes while it trains
- `worth`: which checkpoint, and which seed, is the best
- `restore`: starts from the networks of another run
- `finish`, `learning_curves`: what a run writes at its end: summary, policy, film, picture
- `overflow`: an engine that had no room for all contacts
- `blowups`: physics that an engine could not compute
- `nonfinite`: what a run says and saves when numbers blow up
- `show`: what `train` prints of a run

`sweeps` and the command `train` import it; no other command does. It imports `program`, `policy`, `config`,
`schedule` and `seeds`. A checkpoint holds a `types.TrainState`, and what `workdir.save` puts beside it.
"""
