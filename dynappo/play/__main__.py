"""`python -m dynappo.play`."""

from dynappo.config import flags

flags.start("play")
