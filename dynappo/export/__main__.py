"""`python -m dynappo.export`."""

from dynappo.config import flags

flags.start("export")
