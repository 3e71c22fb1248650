"""A policy of the Go1 that nobody trained, and the Go1 as another file would have it."""

import itertools
import math
import xml.etree.ElementTree as ET

import numpy as np

from dynappo import config as config_lib
from dynappo.description import robot as robot_lib
from dynappo.policy import checks, policy_file

ROBOTS = ("go1", "go2", "anymal_c", "anymal_d")
GO1 = robot_lib.load("go1")


def described(name="go1"):
    """`(config, robot)` of a bundled robot."""
    return config_lib.validate(config_lib.load(f"configs/{name}.py:dyna4")), robot_lib.load(name)


def actor(seed=0, hidden=(16, 16), size=0.5):
    """Parameters of an actor that moves the legs, but leaves the robot on its feet for a while."""
    rng, sizes = np.random.default_rng(seed), (48, *hidden, 12)
    layers = {
        f"Dense_{i}": {
            "kernel": (size * rng.normal(size=pair) / np.sqrt(pair[0])).astype(np.float32),
            "bias": (size * rng.normal(size=pair[1])).astype(np.float32),
        }
        for i, pair in enumerate(zip(sizes[:-1], sizes[1:], strict=True))
    }
    return {"actor": {"params": layers}, "std": np.ones(12, np.float32)}


def params_in(path):
    """The nested parameters in a policy.npz, of a robot or not."""
    with np.load(path) as file:
        names = [name for name in file.files if not name.startswith(("about", "trained/"))]
        return checks.nested({name: file[name] for name in names})


def trot():
    """A new policy that lifts diagonal legs in turn, 2.5 times a second, whatever it sees."""
    count = itertools.count()

    def act(obs):
        swing = math.sin(2 * math.pi * 2.5 * 0.02 * next(count))
        lift = np.array([max(0, swing), max(0, -swing), max(0, -swing), max(0, swing)])
        return np.stack([0 * lift, 2.0 * lift + 0.3, -4.0 * lift], 1).ravel()

    return act


def save(path, seed=0):
    """That actor's policy.npz; returns its path."""
    policy_file.save(path, actor(seed), *described())
    return path


def child(node, path):
    """The element at `path` below `node`, which is there."""
    found = node.find(path)
    assert found is not None, path
    return found


def other_file(path, change=None):
    """The Go1 as another file would have it: another order of joints and bodies, position servos, a
    ball before the robot, no keyframe, camera, names of feet, nor looks; then `change(root, trunk)`."""
    tree = ET.parse(GO1.xml)
    root = tree.getroot()
    for tag in ("actuator", "keyframe"):
        root.remove(child(root, tag))
    world = child(root, "worldbody")
    trunk = child(world, "body")
    trunk.remove(child(trunk, "camera"))
    legs = {leg.attrib["name"][:2]: leg for leg in trunk.findall("body")}
    for leg in legs.values():
        trunk.remove(leg)
    trunk.extend(legs[name] for name in ("RR", "FL", "RL", "FR"))
    for parent in list(trunk.iter("body")):
        for geom in parent.findall("geom"):
            if (geom.get("name") or "").endswith("_foot"):
                geom.attrib.pop("name")
            elif geom.get("name") is None:
                parent.remove(geom)
    ball = ET.Element("body", name="ball", pos="3 3 1")
    ET.SubElement(ball, "freejoint")
    ET.SubElement(ball, "geom", type="sphere", size="0.1")
    world.insert(0, ball)
    servos = ET.SubElement(root, "actuator")
    for joint in trunk.iter("joint"):
        ET.SubElement(servos, "position", joint=joint.attrib["name"], kp="500")
    if change:
        change(root, trunk)
    tree.write(path)
    return path
