"""`python -m dynappo.bench`."""

from dynappo.config import flags

flags.start("bench")
