"""`python -m dynappo.bench`."""

from dynappo.bench import command

command.main()
