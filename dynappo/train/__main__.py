"""`python -m dynappo.train`."""

from dynappo.train import command

command.main()
