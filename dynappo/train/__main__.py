"""`python -m dynappo.train`."""

from dynappo.config import flags

flags.start("train")
