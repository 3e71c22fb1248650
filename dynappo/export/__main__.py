"""`python -m dynappo.export`."""

from dynappo.export import command

command.main()
