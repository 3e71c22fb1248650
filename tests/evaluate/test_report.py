"""The report of an evaluation: what it holds, and what a click in it plays."""

import json
import re

import browser
import numpy as np
import pages
import pytest
import toy_sweep
from answers import until
from toy_policy import save

from dynappo.evaluate import figures, report, tables, trials
from dynappo.policy import episode, policy_source

EPISODES = dict(seconds=20.0, randomize=False, device="cpu", impl="jax", episodes=5)
EPISODES |= {"return": 33.25, "return_std": 1.5, "length": 987.0, "fall_rate": 0.2}


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory):
    """`(folder, player, numbers, recordings)` of a Go1 that stands for a while, and falls at 1 m/s."""
    folder = tmp_path_factory.mktemp("evaluated")
    policy, _ = policy_source.load(str(save(folder / "policy.npz")))
    player, _ = policy_source.player(policy)
    numbers, recordings = trials.run(policy, 1.4, 3)
    for row in numbers["commands"]:
        if row["command"] == [1.0, 0.0, 0.0]:
            row["fall"] = recordings[1.0, 0.0, 0.0]["fall"] = 1.0
            for name in ("velocity", "qpos"):
                recordings[1.0, 0.0, 0.0][name] = recordings[1.0, 0.0, 0.0][name][:50]
    figures.write(folder, "go1", numbers, recordings, policy.timestep)
    report.write(
        folder, "a </script> policy", player, numbers, recordings, toy_sweep.changes(), EPISODES
    )
    return folder, player, numbers, recordings


@pytest.fixture(scope="module")
def text(evaluated):
    return (evaluated[0] / "report.html").read_text()


def part(text, name):
    """The JSON of `name` in the report's script."""
    found = re.search(rf"\b{name} = ", text)
    assert found
    return json.JSONDecoder().raw_decode(text, found.end())[0]


def test_the_tables_are_those_that_are_printed(evaluated, text):
    seen = " ".join(pages.Reader(text).text.split())
    _, _, numbers, _ = evaluated
    rows = tables.trials_rows(numbers) + tables.episodes_rows(EPISODES)
    for row in [*rows, [tables.trials_text(numbers)], [tables.episodes_text(EPISODES)]]:
        assert " ".join("".join(row).split()) in seen.replace("\n", ""), row
    for line in tables.notes(numbers) + tables.changes_lines(toy_sweep.changes()):
        assert line in seen
    assert (
        "a </script> policy" in seen
        and "{{" not in text.replace(json.dumps(text), "").split("<script>")[0]
    )


def test_every_command_has_a_button_with_its_errors(evaluated, text):
    buttons = dict(re.findall(r'data-play="([^"]+)"[^>]*>(.*?)</button>', text))
    _, _, numbers, _ = evaluated
    assert set(buttons) == {report.name(row) for row in numbers["commands"]}
    for row in numbers["commands"]:
        said = buttons[report.name(row)]
        if row["fall"] is None:
            assert said == f"{row['tracking_error']:.2f}<small>{row['yaw_error']:.2f}</small>"
        else:
            assert said == "fell<small>1.0 s</small>" and report.name(row) == "1,0,0"
    assert set(part(text, "clips")) == set(buttons) | {"0.5,0,0"}


def test_a_clip_is_the_recording_of_its_command(evaluated, text):
    """Poses against MuJoCo's own, every second control step, the last one among them."""
    _, player, _, recordings = evaluated
    clips, shared = part(text, "clips"), part(text, "shared")
    for command, recording in recordings.items():
        key = ",".join(f"{v:g}" for v in command)
        scene = shared | clips[key]["scene"]
        times = np.arange(len(recording["qpos"]))[::-1][::2][::-1]
        position, _ = pages.unpack(scene)
        np.testing.assert_allclose(position[:, 0], recording["qpos"][times, :3], atol=1e-3)
        np.testing.assert_allclose(
            pages.numbers(scene, "velocity", "<f4", 3), recording["velocity"][times], atol=1e-5
        )
        assert (pages.numbers(scene, "command", "<f4", 3) == command).all()
        assert scene["dt"] == pytest.approx(2 * episode.period(player)) and scene["rows"] == len(
            times
        )
        assert (scene["fall"] is None) == (recording["fall"] is None)
        assert clips[key]["subtitle"].startswith("asked for {:g}, {:g} m/s".format(*command))


def test_without_pictures_and_without_mjx(evaluated, tmp_path):
    """Nothing stands where they would be; a robot that fell at once has no clip."""
    _, player, _, recordings = evaluated
    numbers, empty = (
        toy_sweep.numbers(),
        {k: v[:0] for k, v in recordings[0.0, 0.0, 0.0].items() if np.ndim(v) == 2},
    )
    recordings = {tuple(r["command"]): empty for r in numbers["commands"] + numbers["ahead"]}
    report.write(tmp_path, "policy", player, numbers, recordings, toy_sweep.changes(), None)
    text = (tmp_path / "report.html").read_text()
    assert (
        part(text, "clips") == {} and "<img" not in text and "return" not in pages.Reader(text).text
    )


@browser.needed
def test_a_click_on_a_command_plays_it_and_it_fits_a_phone(evaluated, tmp_path):
    inside = "document.getElementById('player').contentDocument"
    with browser.chromium(tmp_path) as open_:
        tab = open_((evaluated[0] / "report.html").as_uri())
        tab.until(f"document.readyState === 'complete' && !!{inside}.getElementById('time')")
        assert "0.5, 0 m/s" in tab.value(f"{inside}.getElementById('subtitle').textContent")
        for name, said in (("0,-1,0", "0, -1 m/s"), ("1,0,0", "1, 0 m/s")):
            tab.click(*tab.middle(f"document.querySelector('[data-play=\"{name}\"]')"))
            words = f"({inside}.getElementById('subtitle') || {{textContent: ''}}).textContent"
            tab.until(f"{words}.includes({json.dumps(said)})")
            pressed = (
                f"document.querySelector('[data-play=\"{name}\"]').getAttribute('aria-pressed')"
            )
            assert tab.value(pressed) == "true"
        tab.until(f"!{inside}.getElementById('fell').hidden", "the robot that falls has fallen")
        tab.value("document.getElementById('player').scrollIntoView({block: 'center'})")
        until(
            lambda: (tab.pixels().astype(int).mean(-1) < 90).mean() > 0.002
        )  # dark parts of a Go1
        tab.resize(browser.NARROW)
        root = "document.documentElement"
        tab.until(f"{root}.clientWidth === {browser.NARROW[0]}")
        assert tab.value(f"{root}.scrollWidth <= {root}.clientWidth"), "nothing sticks out"
        assert not tab.errors
