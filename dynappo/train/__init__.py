"""Train: the command `dynappo train`, and `train(config)` from Python (`run.training.train`).

- `command`: its flags; trains one run, or a sweep

No other command imports it. It imports `run`, `sweeps`, `program`, `config`, and of `web` what `--serve`
needs.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # what an editor completes
    from dynappo.run.training import train as train

__all__ = ["train"]


def __getattr__(name: str):
    if name != "train":
        raise AttributeError(f"module 'dynappo.train' has no attribute {name!r}")
    # not above: it imports MuJoCo, which the command must prepare (`config.flags.start`)
    from dynappo.run.training import train

    return train
