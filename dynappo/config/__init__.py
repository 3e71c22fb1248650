"""Settings: from a config file to the input of the compiled program. Start reading at `loading.py`.

The settings:

- `loading`: reads a config file, and fields set on the command line
- `fields`: the fields of configs/default.py, and what each may hold; `ConfigError`
- `per_joint`: turns patterns of joint names into one number for each joint
- `validation`: which settings can run together
- `ground_map`: what follows from a file of the ground
- `own_code`: whether the code of an environment of one's own has changed
- `terms`: terms of one's own for the velocity task, in a file of one's own
- `splitting`: `static` and `hyper`, the two halves that the program takes; `halves`: their types

What every command also needs, without JAX:

- `flags`: a command's flags, and how it ends; `stop`: ctrl-C and other signals
- `files`: finds configs/ and robots/, writes small files, locks
- `shell`: shell commands in messages, as they can be pasted on this machine
- `versions`: which code made a result
- `interpreter`: starts a module of this package in a process of its own

Every folder but those of the method may import it. It imports `schedule` and
`terrain`, and nothing that needs JAX.
"""

from dynappo.config.fields import ConfigError, flat
from dynappo.config.loading import (
    difference,
    from_json,
    load,
    load_both,
    override,
    to_json,
    versions_apart,
)
from dynappo.config.splitting import split
from dynappo.config.validation import validate

__all__ = [
    "ConfigError",
    "difference",
    "flat",
    "from_json",
    "load",
    "load_both",
    "override",
    "split",
    "to_json",
    "validate",
    "versions_apart",
]
