"""Settings: from a config file to the input of the compiled program. Start reading at `loading.py`.

- `loading`: reads a config file and the fields set on the command line
- `fields`: which fields there are, and their types; `ConfigError`
- `validation`: checks which settings can run
- `splitting`: `static` and `hyper`, the two halves that the program takes; `halves`: their types
- `files`: finds configs/ and robots/, writes small files, locks
- `flags`, `shell`, `versions`: shared by every command: its flags and exit status, how to call commands
  on this machine, which code made a result
- `interpreter`: starts a module of this package in a process of its own

Every folder but those of the method may import it. It imports `schedule` and nothing that needs JAX.
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
