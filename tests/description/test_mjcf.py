"""An MJCF with mistakes is one line; one that a policy carries may read no file."""

import re
import warnings

import mujoco
import pytest
from answers import refused
from toy_policy import GO1, actor, described

from dynappo.description import mjcf, robot
from dynappo.policy import episode, policy_file

TEXT = GO1.xml.read_text()


def world(inside):
    """The Go1's file with more in its world."""
    return TEXT.replace("<worldbody>", f"<worldbody>{inside}", 1)


def top(inside):
    """The Go1's file with more at its top."""
    return TEXT.replace("<worldbody>", f"{inside}<worldbody>", 1)


WRONG = {  # a file, what the line must say
    "hardly any time": (
        top('<option timestep="1e-12"/>'),
        "expected a timestep of 1e-05 to 0.1 s, found 1e-12",
    ),
    "time that is no number": (top('<option timestep="nan"/>'), "found nan"),
    "a mass that is no number": (TEXT.replace("5.204", "nan", 1), "mass and inertia"),
    "a text cut in half": (TEXT[: len(TEXT) // 2], "XML"),
    "no XML": ("robot: go1", "XML"),
    "nothing": ("", "XML"),
    "a joint of no body": (top('<equality><joint joint1="no"/></equality>'), "no"),
    "a file that includes itself": (world('<include file="mine.xml"/>'), "include"),
}


@pytest.fixture(scope="module")
def policy():
    return policy_file.describe(*described(), actor())


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_file_is_one_line(tmp_path, policy, name, monkeypatch, capfd):
    """Both where another file is played and where a robot is loaded; nothing else is said or written."""
    text, expected = WRONG[name]
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "mine.xml"
    path.write_text(text)
    lines = refused(episode.load, path, policy), refused(robot.load_xml, path)
    for line in lines:
        assert line.startswith(f"{path}: ") and line.isprintable()
    assert expected in lines[0]
    assert [*tmp_path.iterdir()] == [path] and not any(capfd.readouterr())


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


def test_an_error_of_another_file_names_that(tmp_path):
    xml, other = tmp_path / "mine.xml", tmp_path / "other"

    def read(path):
        with mjcf.one_line(xml, "a part: "):
            path.read_text()

    assert refused(read, xml) == f"{xml}: a part: No such file or directory"
    assert refused(read, other) == f"{xml}: a part: {other}: No such file or directory"


def test_a_comment_that_is_no_xml_to_all_is_no_fault(tmp_path):
    """MuJoCo reads it, and writes it again."""
    path = tmp_path / "mine.xml"
    text = re.sub(r"(<mujoco[^>]*>)", r"\1<!-- Licence: MIT -- mine -->", TEXT)
    path.write_text(text.replace('name="track"', 'name="other"'))
    assert mjcf.check_alone(robot.load_xml(path).alone) is None


def test_a_name_that_is_no_xml_to_all_is_an_error(tmp_path):
    path = tmp_path / "mine.xml"
    path.write_text(TEXT.replace('name="track"', 'name="tr&#1;ack"'))
    said = refused(robot.load_xml, path)
    assert said == f"{path}: a name in it has a character that no XML has; rename it"


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
NONE |= {
    ("compiler", name) for name in ("assetdir", "meshdir", "texturedir")
}  # of other elements' files


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


def test_an_attribute_that_mujoco_will_drop_warns_nobody(tmp_path):
    """Of the file; its line would name ours."""
    (tmp_path / "mine.xml").write_text(top('<statistic meaninertia="0.05"/>'))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = robot.load_xml(tmp_path / "mine.xml")
    assert found.foot_names
