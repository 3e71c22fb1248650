"""Train: the command `dynappo train`, and `train(config)` from Python (`run.training.train`).

- `command`: the flags of the command; it trains one run, or a sweep

No other command imports it. It imports `run`, `sweeps`, `program`, `config` and what starts the page of
`--serve`.
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
