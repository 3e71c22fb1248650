"""Bench: the command `dynappo bench`, where the time of an iteration goes. Start reading at `command.py`.

- `command`: its flags, what it prints and writes
- `phases`: the time of each part, measured on the program that trains

No other command imports it. It imports `program`, `config`, the method and `model`.
"""
