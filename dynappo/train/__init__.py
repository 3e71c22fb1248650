"""Train: the command `dynappo train`, and `train(config)` from Python. Start reading at `run.py`.

- `command`, `show`: the flags the command reads, and what it prints
- `run`: the loop over chunks of iterations
- `workdir`: the folder of a run: open it, resume it, save into it
- `checkpoint`, `log`: what a run writes while it trains
- `restore`: start from the networks of another run
- `finish`, `curves`: what a run writes at its end: summary, policy, film, picture
- `nonfinite`: what is printed and saved when numbers blow up

No other command imports it, but for `sweeps`, which `command` starts. It imports `program`, `policy`,
`config`, `schedule` and what starts the page of `--serve`. What a checkpoint
holds is `types.TrainState`, and what `workdir.save` puts beside it.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what an editor completes
    from dynappo.train.run import train as train

__all__ = ["train"]


def __getattr__(name: str):
    if name != "train":
        raise AttributeError(f"module 'dynappo.train' has no attribute {name!r}")
    # not above: it imports MuJoCo, which the command must prepare (`config.flags.start`)
    from dynappo.train.run import train

    return train
