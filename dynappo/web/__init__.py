"""Web: the page that `play --serve` opens in a browser. Start reading at `server.py`.

- `live`: the robot that walks, in real time, and what one can do to it
- `policies`: what can be chosen, and the newest policy of a run that trains
- `scene`: shapes, contacts, arrows, the camera, the hand that pulls
- `panels`: buttons, sliders, keys, plots
- `run_plots`: the curves of a run
- `address`: what `--serve` means
- `guard`: who is let in, and what a browser may say
- `child`: the page in a process of its own, for `train --serve`
- `server`: puts them together

`play` imports it where it is asked to serve, `train` only `address` and `child`. It imports `policy`,
`physics` and `config`, no JAX, and viser and mjviser: `pip install 'dynappo[web]'`.
"""
