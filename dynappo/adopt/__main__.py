"""`python -m dynappo.adopt`."""

from dynappo.config import flags

flags.start("adopt")
