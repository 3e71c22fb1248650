"""`python -m dynappo.evaluate`."""

from dynappo.config import flags

flags.start("evaluate")
