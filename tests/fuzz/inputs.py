"""Bad command lines and small files, by a seeded generator: `inputs(number)` is always the same.

An input is a command, its arguments, and a file or two beside them. Most hold one or two things that are
wrong; some are right, so that the generator itself is seen to reach what lies behind the checks.
"""

import io
import json
import random
import re
from typing import NamedTuple

import numpy as np
import published

from dynappo.config import fields, files

COMMANDS = ("train", "bench", "play", "evaluate", "export", "look", "adopt")
NUMBERS = """
-1 0 1 2 3 7 16 64 100 4096 -0.0 0.5 1.0 1.5 -1.5 1e-45 1e-12 1e-9 1e-3 1e3 1e9 1e12 1e39 1e308 1e999 -1e12
2147483647 2147483648 -2147483649 3000000000 1000000000000 nan inf -inf 1_000 0x10 1j
""".split()
TEXTS = [
    "",
    " ",
    "None",
    "True",
    "False",
    "[]",
    "()",
    "(1,)",
    "(1,2)",
    "(1,2,3)",
    "(2,1)",
    "(nan,1)",
]
TEXTS += [
    "'a'",
    "{}",
    "{[]:1}",
    "(1e400,)",
    "auto",
    "cpu",
    "c",
    "go1",
    "go2",
    "../go1",
    "ü€\n\x1b[2J",
]
TEXTS += ["\udcff", "a" * 300, "9" * 5000, "1" + "0" * 400, "(" * 300, "-" * 3000 + "1", "[" * 99]
TEXTS += [
    "(64,64)",
    "(0,64)",
    "(-1,1)",
    "(-9,9)",
    "(3,)*9",
    "__import__('os').abort()",
    "1e5",
    "=",
    "--",
]
PATHS = [
    "",
    ".",
    "..",
    "new",
    "new/deep",
    "taken",
    "taken/below",
    "thesis",
    "thesis/thesis.txt",
    "old",
]
PATHS += [
    "a" * 300,
    "a/" * 2000,
    "line\nbreak",
    "ü",
    "/dev/null",
    "/proc/nothing",
    "~",
    "-",
    "*",
    "young",
]
SPECS = [
    "",
    ":",
    "go1.py",
    "go1.py:",
    "go9.py",
    "configs/go1.py:dyna9",
    "configs",
    "configs/",
    "a" * 300,
]
SPECS += [
    "/no/such/dir/go1.py:quick",
    "no/go1.py",
    "thesis/thesis.txt",
    "taken",
    "go1.py:" + "a" * 300,
]
GOOD = [
    "configs/go1.py",
    "go1.py:quick",
    "configs/go2.py:ppo16",
    "configs/anymal_c.py:dyna4",
    "mine.py",
]
FLAGS = {  # command -> flag: texts that its value may be
    "train": {
        "--workdir": PATHS,
        "--fresh": None,
        "--restore": PATHS,
        "--coordinator": ["localhost:99999999", "localhost:7", ":1", "localhost", "x:-1", *TEXTS],
        "--processes": [*NUMBERS, *TEXTS],
        "--process": [*NUMBERS, *TEXTS],
    },
    "bench": {
        "--vs": [*GOOD, *SPECS],
        "--engines": ["c,jax", "c", "jax,warp", ",", "c,c,c", *TEXTS],
        "--repeats": [*NUMBERS, *TEXTS],
        "--compile": None,
        "--out": PATHS,
    },
    "play": {
        "--command": ["1,0,0", "1,2", "nan,0,0", "1e300,0,0", "mine.csv", "no.csv", *TEXTS, *PATHS],
        "--seconds": [*NUMBERS, *TEXTS],
        "--out": ["walk.html", "walk.mp4", "walk.avi", "no/walk.html", "a" * 300 + ".gif", *PATHS],
        "--policy": ["zero", "random", "best", *TEXTS],
        "--seed": [*NUMBERS, *TEXTS],
        "--robot-xml": ["mine.xml", "no.xml", *PATHS],
        "--keep-joints": None,
        "--run-seed": [*NUMBERS, "best", *TEXTS],
    },
    "evaluate": {
        "--episodes": [*NUMBERS, *TEXTS],
        "--randomize": None,
        "--seed": [*NUMBERS, *TEXTS],
        "--run-seed": [*NUMBERS, "best", *TEXTS],
        "--robot-xml": ["mine.xml", "no.xml", *PATHS],
        "--fast": None,
        "--out": PATHS,
    },
    "export": {
        "--out": ["a.onnx", "a.npz", "a.xml", "a.pt", "no/a.onnx", "a" * 300 + ".npz", *PATHS],
        "--joint-order": ["mjcf", "isaaclab", "unitree", ",", "FR_hip_joint", *TEXTS],
        "--targets": None,
        "--run-seed": [*NUMBERS, "best", *TEXTS],
        "--robot-xml": ["mine.xml", "no.xml", *PATHS],
    },
    "adopt": {"--name": ["mine", "go1", "default", "a/b", *TEXTS], "--force": None},
    "look": {"--out": ["a.png", "a.html", "no/a.png", *PATHS]},
}


# with what robots rarely have; its mesh is not there
TIED = published.mjcf().replace(
    "<actuator>",
    '<tendon><fixed stiffness="9"><joint joint="RR_hip_joint" coef="2"/></fixed></tendon><equality>'
    '<weld body1="FL_hip" body2="trunk"/></equality><actuator><motor joint="FL_hip_joint" gear="3"/>',
)
GO2 = str(files.find("robots", "go2/go2.xml", own=True))
RIGHT = {  # arguments with which a command goes on; one of each group
    "train": (GOOD[:-1] + ["mine.py"], [], ["--workdir=new", "--workdir=old", "--fresh"]),
    "bench": (GOOD[:-1], [], ["--out=new", "--repeats=3", "--engines=c,jax"]),
    "play": (
        ["go1", "anymal_d", "mine.npz"],
        ["--out=walk.html"],
        ["--command=mine.csv", "--robot-xml=mine.xml", "--policy=zero"],
    ),
    "evaluate": (["go1", "anymal_d", "mine.npz"], [], ["--out=new", "--seed=3", "--episodes=9"]),
    "export": (["go1", "go2", "mine.npz"], ["--out=a.onnx", "--out=a.npz"], ["--joint-order=mjcf"]),
    "look": (GOOD[:-1] + ["mine.py", "go1"], [], ["--out=a.png"]),
    "adopt": (["mine.xml", "toy.xml", "mine.urdf", GO2], ["--name=mine", "--name=other"], []),
}


class Input(NamedTuple):
    """A command line, and the files that are made for it in the working directory."""

    command: str
    argv: list[str]
    files: dict[str, bytes]


def draw(number: int, seed: int = 22) -> Input:
    """Input `number`."""
    rng = random.Random(f"{seed} {number}")
    command = COMMANDS[number % len(COMMANDS)]
    configured = command in ("train", "bench", "look")
    what, needed, more = RIGHT[command]
    argv = [rng.choice(what if rng.random() < 0.9 else SPECS if configured else [*PATHS, *TEXTS])]
    if configured and command != "look":  # it names its config without a flag
        argv[0] = f"--config={argv[0]}"
    argv += [rng.choice(group) for group in (needed, more) if group and rng.random() < 0.9]
    for _ in range(rng.choice((0, 1, 1, 1, 2, 3))):
        argv.append(_setting(rng) if configured and rng.random() < 0.6 else _flag(rng, command))
    if rng.random() < 0.1:
        rng.shuffle(argv)
    if rng.random() < 0.05:
        argv.append(
            rng.choice(["--bogus", "word", "--config", "--out", "--config.ppo", "--", "-x"])
        )
    text = " ".join(argv)
    made = {name: make(rng) for name, make in MAKERS.items() if name in text}
    return Input(command, argv, made)


def _flag(rng, command: str) -> str:
    name = rng.choice(list(FLAGS[command]))
    values = FLAGS[command][name]
    return name if values is None else f"{name}={rng.choice(values)}"


def _setting(rng) -> str:
    """`--config.FIELD=VALUE` of any field, sometimes misspelt; the value is often of the right type."""
    name = rng.choice(list(fields.every()))
    field = fields.every()[name]
    value = rng.choice([*NUMBERS, *TEXTS])
    if rng.random() < 0.5 and type(field.default) in (int, float):
        value = repr(type(field.default)(field.default * rng.choice((-1, 0, 0.5, 2, 1e3, 1e9))))
    if rng.random() < 0.05:
        name = name[:-1]
    return f"--config.{name}={value}"


def _damaged(rng, data: bytes) -> bytes:
    """Cut off, with a piece missing, doubled or overwritten."""
    a, b = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    b = min(b, a + 200)
    ways = (data[:a], data[:a] + data[b:], data[:b] + data[a:], b"")
    return rng.choice((*ways, data[:a] + rng.randbytes(b - a) + data[b:]))


def _config_file(rng) -> bytes:
    """A file with settings of any type, or one that is no config at all."""
    own = files.find("configs", "go1.py", own=True)
    name = rng.choice(list(fields.every()))
    value = rng.choice(
        ["'many'", "None", "[]", "{}", "object()", "1e999", "-1", "3", "10**30", "lambda: 0"]
    )
    lines = [
        "import runpy, sys",
        "from ml_collections import config_dict",
        f"go1 = runpy.run_path({str(own)!r})",
        "def get_config(variant=''):",
        "    config = go1['get_config'](variant)",
        f"    c = {rng.choice(('config', 'config_dict.ConfigDict(config.to_dict())', 'config.to_dict()'))}",
        f"    {rng.choice(('pass', 'sys.exit(0)', 'raise OSError(5, chr(10))', 'return variant', 'c = [c]'))}"
        if rng.random() < 0.4
        else "    pass",
        f"    c.{name} = {value}" if rng.random() < 0.7 else "    pass",
        "    return c",
    ]
    text = "\n".join(lines).encode()
    return _damaged(rng, text) if rng.random() < 0.2 else text


def _script(rng) -> bytes:
    """Rows t,vx,vy,wz, of which one is not."""
    rows = [f"{i}, 0.5, 0, {i / 9}" for i in range(9)]
    for _ in range(rng.choice((0, 1, 2))):
        cells = rows[rng.randrange(9)].split(",")
        cells[rng.randrange(4)] = rng.choice([*NUMBERS[:30], "", "x", ","])
        rows[rng.randrange(9)] = ",".join(cells)
    data = "\n".join(rows).encode()
    return _damaged(rng, data) if rng.random() < 0.3 else data


def _xml(rng, text: str = "") -> bytes:
    """The Go1's file or `text`, damaged, or with another value of an attribute."""
    text = text or files.find("robots", "go1/go1.xml", own=True).read_text()
    if rng.random() < 0.5:
        return _damaged(rng, text.encode())
    at = rng.choice(list(re.finditer(r'="([^"]*)"', text)))
    value = rng.choice([*NUMBERS, "", "x", "0 0 0", "1 1 1", "nan nan nan", "9" * 400])
    return f'{text[: at.start()]}="{value}"{text[at.end() :]}'.encode()


def _policy(rng) -> bytes:
    """A small policy.npz, damaged, or with another value in its `about`."""
    path = files.find("robots", "go1/policy.npz", own=True)
    if rng.random() < 0.5:
        return _damaged(rng, path.read_bytes())
    with np.load(path) as file:
        arrays = dict(file)
    about = json.loads(str(arrays["about"]))
    name = rng.choice(list(about))
    about[name] = rng.choice(
        [None, [], {}, "x", True, -1, 0, 1e12, 1e999, float("nan"), [1.0] * 12, "go2"]
    )
    if rng.random() < 0.2:
        del about[name]
    arrays["about"] = np.array(json.dumps(about))
    if rng.random() < 0.3:
        name = rng.choice(list(arrays))
        others = np.zeros(3), np.zeros((0, 2)), np.array("x"), np.array([[np.nan]])
        arrays[name] = others[rng.randrange(4)]
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


MAKERS = {
    "mine.py": _config_file,
    "mine.csv": _script,
    "mine.xml": _xml,
    "mine.npz": _policy,
    "mine.urdf": lambda rng: _xml(rng, published.urdf()),
    "toy.xml": lambda rng: _xml(rng, TIED),
}
