"""Web: the page that `play --serve` opens in a browser. Start reading at `server.py`.

- `live`: the robot that walks, in real time, and what one can do to it
- `policies`: the policies to choose from, and the newest policy of a run that trains
- `scene`: shapes, contacts, arrows, the camera, the hand that pulls
- `ground_mesh`: rough ground as few triangles and lines
- `panels`: buttons, sliders, keys, plots
- `run_plots`: the curves of a run
- `address`: what `--serve` means
- `guard`: which requests the server answers, and what a browser may send
- `child`: the page in a process of its own, for `train --serve`
- `server`: puts them together

`play` imports it with `--serve`, `train` only `address` and `child`. It imports `policy`, `terrain`,
`description` and `config`, no JAX, and viser and mjviser: `pip install 'dynappo[web]'`.
"""
