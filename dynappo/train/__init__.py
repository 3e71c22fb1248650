"""The command `python -m dynappo.train`, and the same from Python, `train(config)`. Start at `run.py`.

- `command`, `show`: what the command reads, and what it tells
- `run`: the loop over chunks of iterations
- `workdir`: the folder of a run: opened, gone on with, saved into
- `checkpoint`, `log`: what is written while it trains
- `restore`: starting from the networks of another run
- `finish`, `curves`: what a run that has ended leaves: summary, policy, film, picture
- `nonfinite`: what is said and kept when numbers blow up

No other command imports it, but for `sweeps`, which `command` starts. It imports `program`, `policy`,
`config` and `schedule`. What a checkpoint
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
