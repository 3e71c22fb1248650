"""`python -m dynappo.look`."""

from dynappo.config import flags

flags.start("look")
