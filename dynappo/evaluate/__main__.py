"""`python -m dynappo.evaluate`."""

from dynappo.evaluate import command

command.main()
