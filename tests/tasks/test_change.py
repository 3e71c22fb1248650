"""docs/task.md: its differences are taken from the page, applied to a copy of the project, and run."""

import os
import pathlib
import re
import shlex
import shutil
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]
PAGE = ROOT / "docs" / "task.md"
TITLES = ["A reward term", "An observation", "A command range", "A termination"]


def blocks(kind):
    """`{title of the section: block}` of the page's blocks of this kind."""
    sections = re.split(r"^## ", PAGE.read_text(), flags=re.M)[1:]
    found = {
        s.split("\n")[0]: re.findall(rf"^```{kind}\n(.*?)^```", s, re.M | re.S) for s in sections
    }
    assert list(found) == TITLES
    return {title: "".join(texts) for title, texts in found.items() if texts}


def run(folder, *command):
    """A command in the copy, with the copy's own package; its output is shown where it fails."""
    around = {"PYTHONPATH": str(folder), "GIT_CEILING_DIRECTORIES": str(folder.parent)}
    done = subprocess.run(
        command, cwd=folder, env=os.environ | around, text=True, capture_output=True
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-3000:]}\n{done.stderr[-5000:]}"
    return done.stdout


def copy(folder):
    """The project as it is shipped."""
    if shutil.which("git") is None:
        pytest.skip("git apply, of which the page speaks, needs git")
    ignore = shutil.ignore_patterns("__pycache__", "*.stl", "*.obj")
    for name in ("dynappo", "configs", "robots", "tests"):
        shutil.copytree(ROOT / name, folder / name, ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def apply(folder, title):
    (folder / "change.diff").write_text(blocks("diff")[title])
    run(folder, "git", "apply", "change.diff")


def test_a_reward_term_of_ones_own_is_two_places_and_breaks_no_other_test(tmp_path):
    folder = copy(tmp_path / "copy")
    apply(folder, "A reward term")
    changed = re.findall(r"^\+\+\+ b/(.*)", blocks("diff")["A reward term"], re.M)
    assert sorted(changed) == ["configs/default.py", "dynappo/tasks/velocity/rewards.py"]
    tests = ("tests/tasks/test_rewards.py", "-q", "-p", "no:cacheprovider")
    assert "failed" not in run(folder, sys.executable, "-m", "pytest", *tests)


@pytest.mark.parametrize("title", ["An observation", "A termination"])
def test_each_difference_can_be_applied_alone(title, tmp_path):
    folder = copy(tmp_path / "copy")
    apply(folder, title)
    of_all = "from dynappo.tasks.velocity import observe; import dynappo.policy.episode; "
    of_all += "print(observe.name('full', 12))"
    name = run(folder, sys.executable, "-c", of_all).strip()
    assert name == ("velocity-gait-51" if title == "An observation" else "velocity-48")


@pytest.mark.parametrize("how", ["traced", pytest.param("trained", marks=pytest.mark.slow)])
def test_the_four_differences_together_do_what_the_page_says(how, tmp_path):
    """Against C MuJoCo and NumPy, and through an iteration with a tail: changed_task.py."""
    folder = copy(tmp_path / "copy")
    for title in blocks("diff"):
        apply(folder, title)
    (command,) = blocks("sh").values()
    flags = [word for word in shlex.split(command) if word.startswith("--config.")]
    assert flags == ["--config.task.command_x=(0.0,2.0)"]
    run(folder, sys.executable, "tests/changed_task.py", how, *flags)
