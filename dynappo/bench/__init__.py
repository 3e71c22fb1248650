"""The command `python -m dynappo.bench`: where the time of an iteration goes. Start at `command.py`.

- `command`: what it reads, prints and writes
- `phases`: the time of each part, measured on the program that trains

No other command imports it. It imports `program`, `config`, the method, `model` and
`task.observe`.
"""
