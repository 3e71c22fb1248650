"""An MJCF from anybody: what MuJoCo would compute for hours is refused at once, in one line."""

import os
import re
import time

import mujoco
import pytest
from answers import refused
from toy_policy import GO1, actor, described

from dynappo.physics import mjcf, robot
from dynappo.policy import episode, policy_file

TEXT = GO1.xml.read_text()
BALL = '<body><freejoint/><geom size="0.1"/></body>'
FIELD = '<asset><hfield name="h" nrow="{0}" ncol="{0}" size="1 1 1 1"/></asset>'


def world(inside):
    """The Go1's file with more in its world."""
    return TEXT.replace("<worldbody>", f"<worldbody>{inside}", 1)


def top(inside):
    """The Go1's file with more at its top."""
    return TEXT.replace("<worldbody>", f"{inside}<worldbody>", 1)


def option(text):
    return top(f"<option {text}/>")


def texture(text):
    return top(f'<asset><texture name="t" type="2d" builtin="flat" {text}/></asset>')


HOSTILE = {  # a file, what the line must say
    "no time": (option('timestep="0"'), "expected a timestep of 1e-05 to 0.1 s, found 0"),
    "hardly any time": (option('timestep="1e-12"'), "found 1e-12"),
    "time that is no number": (
        option('timestep="nan"'),
        "option has timestep='nan', expected numbers",
    ),
    "time backwards": (option('timestep="-0.01"'), "found -0.01"),
    "a step of a minute": (option('timestep="60"'), "found 60"),
    "a hundred thousand balls": (
        world(f'<replicate count="100000" offset="1 0 0">{BALL}</replicate>'),
        "replicate has count='100000', expected at most 10000",
    ),
    "a thousand times a thousand": (
        world(
            f'<replicate count="1000"><replicate count="1e3">{BALL}</replicate></replicate>',
        ),
        "more than 20000 elements, expected a robot",
    ),
    "a count in hexadecimal": (
        world(f'<replicate count="0x186a0">{BALL}</replicate>'),
        "replicate has count='0x186a0'",
    ),
    "a cloth": (
        world('<flexcomp name="c" type="grid" count="999 999 1" dim="2"><pin id="0"/></flexcomp>'),
        "more than 20000 elements",
    ),
    "too many bodies": (
        world(f'<replicate count="2500" offset="1 0 0">{BALL}</replicate>'),
        "expected at most 2000 bodies, found 2514",
    ),
    "too many ways to move": (
        world(f'<replicate count="200" offset="1 0 0">{BALL}</replicate>'),
        "expected at most 1000 degrees of freedom, found 1218",
    ),
    "a field of 40 GB": (top(FIELD.format(100_000)), "hfield has nrow='100000', expected at most"),
    "a picture of 30 GB": (
        texture('width="100000" height="100000"'),
        "texture has width='100000', expected at most 4096",
    ),
    "8 GB of nothing": (
        top('<custom><numeric name="n" size="1000000000"/></custom>'),
        "numeric has size='1000000000', expected at most 1000000",
    ),
    "memory": (top('<size memory="9T"/>'), "size has memory='9T', expected at most 4294967296"),
    "user data": (top('<size nuser_geom="2000000000"/>'), "nuser_geom='2000000000'"),
    "a solver without end": (option('iterations="2000000000"'), "option has iterations='200"),
    "a list of entities": (
        '<!DOCTYPE x [<!ENTITY a "aaaa">]>' + TEXT,
        "a DOCTYPE, which MJCF does not have",
    ),
    "a text cut in half": (TEXT[: len(TEXT) // 2], "XML parse error"),
    "no XML": ("robot: go1", "XML parse error"),
    "nothing": ("", "XML parse error"),
    "too long": (TEXT + " " * mjcf.MAX_BYTES, f"expected at most {mjcf.MAX_BYTES} bytes"),
    "a joint of no body": (
        top('<equality><joint joint1="no"/></equality>'),
        "no",
    ),  # MuJoCo's own words
}


@pytest.fixture(scope="module")
def policy():
    return policy_file.describe(*described(), actor())


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_one_line(tmp_path, policy, name, monkeypatch, capfd):
    """Both where another file is played and where a robot is loaded; within seconds, and nothing else
    is said or written."""
    text, expected = HOSTILE[name]
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.xml"
    path.write_text(text)
    start = time.process_time()
    lines = refused(episode.load, path, policy), refused(robot.load_xml, path)
    assert time.process_time() - start < 30  # it does not hang
    for line in lines:
        assert line.startswith(f"{path}: ") and line.isprintable()
    assert expected in lines[0]
    assert [*tmp_path.iterdir()] == [path] and not any(capfd.readouterr())


def test_what_a_file_includes_is_looked_at_too(tmp_path, policy):
    """Each as often as it is included; a file that includes itself is MuJoCo's to refuse."""
    (tmp_path / "parts").mkdir()
    balls = f'<mujoco><replicate count="9000">{BALL}</replicate></mujoco>'
    (tmp_path / "parts" / "balls.xml").write_text(balls)
    path = tmp_path / "mine.xml"
    path.write_text(world('<include file="parts/balls.xml"/>'))
    line = refused(episode.load, path, policy)
    assert line.startswith(f"{path}: {tmp_path}/parts/balls.xml: more than 20000 elements")
    path.write_text(world('<include file="mine.xml"/>'))
    assert str(path) in refused(episode.load, path, policy)


@pytest.mark.parametrize("inside", ['<include file="{}"/>', '<asset><mesh file="{}"/></asset>'])
def test_a_device_is_no_file(tmp_path, policy, inside):
    """MuJoCo would read /dev/zero until memory ends, and wait for what nobody writes into a pipe."""
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "mine.xml").write_text(top(inside.format("pipe.stl")))
    line = refused(episode.load, tmp_path / "mine.xml", policy)
    assert "pipe.stl is a device, expected a file" in line


def test_what_mujoco_cannot_compute_is_one_line(tmp_path, policy, monkeypatch):
    """150 boxes in one place have more contacts than its memory holds, at once or when they have fallen."""
    box = '<body pos="3 0 1"><freejoint/><geom type="box" size=".1 .1 .1"/></body>'
    path = tmp_path / "mine.xml"
    path.write_text(world(f'<replicate count="150" offset="0 0 0.001">{box}</replicate>'))
    body = episode.load(path, policy)
    act = policy_file.actor(policy.params, policy.activation)
    line = refused(episode.play, body, act, lambda t: [0, 0, 0], 0.1)
    assert line.startswith(f"{path}: ") and "out of memory" in line

    def full(model, data):
        raise mujoco.FatalError("mj_stackAlloc: out of memory")

    body = episode.load(GO1.xml, policy)
    monkeypatch.setattr(mujoco, "mj_step", full)
    line = refused(episode.play, body, act, lambda t: [0, 0, 0], 0.1)
    assert line == f"{GO1.xml}: mj_stackAlloc: out of memory"


def test_a_robot_with_a_terrain_is_none_of_them(tmp_path, policy):
    """A thousand boxes, a height field of a megapixel, an included file, a byte order mark, Latin-1."""
    boxes = (
        '<replicate count="1000" offset="0.3 0 0"><geom type="box" size=".1 .1 .1"/></replicate>'
    )
    (tmp_path / "field.xml").write_text(f"<mujoco>{FIELD.format(1024)}</mujoco>")
    text = world(boxes).replace("<worldbody>", '<include file="field.xml"/><worldbody>', 1)
    path = tmp_path / "mine.xml"
    path.write_bytes(("\ufeff" + text).encode() + "<!-- Grüße -->".encode("latin-1"))
    body = episode.load(path, policy)
    assert body.model.ngeom > 1000 and body.model.nhfielddata == 1024**2
    assert body.model.opt.timestep == mujoco.MjModel.from_xml_path(str(GO1.xml)).opt.timestep


# ---- one in a policy, which may read no file


def schema():
    """`(element, attribute)` of all that MuJoCo's MJCF has, and `(element, "")`."""
    table = mujoco.mj_printSchema(True, True)
    for element, names in re.findall(r'class="el">(\w+)</td>.*?class="at">(.*?)</td>', table, re.S):
        yield element, ""
        yield from ((element, name) for name in names.split() if name.isidentifier())


FILES = sorted({(e, name) for e, name in schema() if name.startswith("file")})
# words that a new way to name a file would have; what has them today and names none is after it
PATHS = re.compile("file|path|dir|url|uri|include|plugin|extension|model|load|import|resource")
NONE = {("light", "dir"), ("light", "directional"), ("compiler", "strippath"), ("mujoco", "model")}
NONE |= {("attach", "model")}  # of an element `model`, which is refused
NONE |= {("compiler", name) for name in mjcf.FOLDERS}  # of files that something else names


def test_the_schema_names_files_in_no_other_way():
    """A new MuJoCo may have more; then `mjcf.check_alone` must know it."""
    found = {(e, name) for e, name in schema() if PATHS.search(name or e)}
    elements = {(e, "") for e in mjcf.OUTSIDE}
    assert len(FILES) > 10
    assert found - set(FILES) - elements - NONE == {("plugin", "plugin")}


@pytest.mark.parametrize(("element", "name"), FILES, ids=map(" ".join, FILES))
def test_a_file_in_it_is_not_even_looked_for(element, name, tmp_path):
    """Whether there is one is not told either."""
    for path in (tmp_path / "none", tmp_path):
        text = top(f'<asset><{element} {name}="{path}"/></asset>')
        line = refused(robot.load_text, text, "go1", tmp_path / "policy.npz")
        assert f"needs no other file, found {element} {name}=" in line


@pytest.mark.parametrize("element", sorted(mjcf.OUTSIDE))
def test_what_brings_files_or_code_is_refused(element, tmp_path):
    line = refused(robot.load_text, top(f"<{element}/>"), "go1", tmp_path / "policy.npz")
    assert f"needs no other file, found {element}" in line
