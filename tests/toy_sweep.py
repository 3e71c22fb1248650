"""A sweep over commands as `trials.run` gives it, made up so that every number tells its command."""

from dynappo.evaluate import tables as evaluate_tables

FEET = ("FL", "FR", "RL", "RR")


def foot(duty=0.5):
    swings = {"air_time": 0.2, "stride_frequency": 2.5, "clearance": 0.05, "slip": 0.1}
    return {"duty_factor": duty} | swings


def numbers(fallen=(), speeds=(0.5, 1.0)):
    """A sweep with errors of 0.3 + x/10 + y/25 + turn/30 (tracking) and 0.1 + x/50 (yaw)."""
    grid = {"vx": [-1.0, 0.0, 0.5, 1.0], "vy": [-0.5, 0.0, 0.5], "wz": [-1.0, 0.0, 1.0]}
    cells = [(x, y, 0.0) for x in grid["vx"] for y in grid["vy"]]
    cells += [(x, 0.0, turn) for x in grid["vx"] for turn in grid["wz"]]
    names = [name for name, *_ in evaluate_tables.ROWS]
    rows = [
        dict.fromkeys(names, 1.0)
        | {
            "command": [x, y, turn],
            "fall": 1.5 if (x, y, turn) in fallen else None,
            "tracking_error": 0.3 + x / 10 + y / 25 + turn / 30,
            "yaw_error": 0.1 + x / 50,
        }
        for x, y, turn in dict.fromkeys(cells)
    ]
    gait = foot() | {"feet": {name: foot(0.2 + j / 10) for j, name in enumerate(FEET)}}
    ahead = [rows[0] | gait | {"command": [speed, 0.0, 0.0], "speed": speed} for speed in speeds]
    every = dict.fromkeys(names, 2.0) | gait | {"episodes": len(rows), "falls": len(fallen)}
    standing = rows[0] | gait | {"command": [0.0, 0.0, 0.0]}
    some = dict(seconds=6.0, axes=grid, held={"vy": 0.0, "wz": 0.0}, all=every)
    some |= dict(slow={"ahead": 0.3, "turning left": None})
    return some | dict(ahead=ahead, standing=standing, commands=rows)


def changes():
    """What `changes.run` finds where nothing falls, with its tours."""
    about = {"changes": 16, "falls": 0, "walks": 2, "start_falls": 0, "every": [2.0, 3.0]}
    return about | {"seed": 0, "fell": [], "tours": []}
