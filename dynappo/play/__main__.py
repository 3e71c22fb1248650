"""`python -m dynappo.play`."""

from dynappo.play import command

command.main()
