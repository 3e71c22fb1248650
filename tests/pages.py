"""A page that dynappo.play wrote, read on its own: tags, text, and the numbers of its scene."""

import base64
import html.parser
import json

import numpy as np


class Reader(html.parser.HTMLParser):
    """Every tag with its attributes, the text, and that of scripts by their id."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.open, self.text = [], {}, None, ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag == "script":
            self.open = dict(attrs).get("id", "code")

    def handle_endtag(self, tag):
        self.open = None if tag == "script" else self.open

    def handle_data(self, data):
        if self.open:
            self.scripts[self.open] = self.scripts.get(self.open, "") + data
        else:
            self.text += data


def read(path):
    """The scene of the page at `path`, as its JSON has it."""
    return json.loads(Reader(path.read_text()).scripts["scene"])


def numbers(scene, name, kind, *shape):
    """An array `[rows, ...]` of a scene."""
    return np.frombuffer(base64.b64decode(scene[name]), kind).reshape(-1, *shape)


def unpack(scene):
    """`(position [T, B, 3], rotation [T, B, 3, 3])` of a scene's bodies."""
    bodies = scene["bodies"]
    position = numbers(scene, "position", "<i2", bodies, 3) * scene["unit"]
    position = position + numbers(scene, "root", "<f4", 3)[:, None]
    w, x, y, z = np.moveaxis(numbers(scene, "rotation", "<i2", bodies, 4) / 32767, -1, 0)
    turn = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
    return position, np.moveaxis(turn, (0, 1), (-2, -1))
