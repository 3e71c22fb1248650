"""The command `dynappo bench`: where the time of an iteration goes. Start reading at `command.py`.

- `command`: reads flags, prints and writes the result
- `phases`: times each part, on the program that trains

No other command imports it. It imports `program`, `config`, the method and `model`.
"""
