"""Settings: from a config file to what the compiled program takes. Start at `loading.py`.

- `loading`: a config file and the fields set on the command line
- `fields`: which fields there are, and their types; `ConfigError`
- `validation`: which settings can be run
- `splitting`: `static` and `hyper`, the two halves that the program takes
- `files`: where configs/ and robots/ are found, and how small files are written
- `flags`, `shell`, `versions`: what every command shares: its flags and how it ends, how commands are
  called here, which code made a result

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
