"""Which code made a result: the commit of its checkout and of no other, versions that are installed."""

import subprocess
from importlib import metadata

from dynappo.config import versions


def test_a_result_names_the_commit_of_its_checkout_and_of_no_other(tmp_path):
    """Not of a repository around the folder in which a wheel lies."""
    git = ["git", "-c", "user.name=a", "-c", "user.email=a@b.c", "-C", str(tmp_path)]
    assert versions.commit(tmp_path) is None
    (tmp_path / "a").write_text("1")
    for command in (["init", "-q"], ["add", "a"], ["commit", "-qm", "a"]):
        subprocess.run(git + command, check=True)
    head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
    commit = versions.commit(tmp_path)
    assert commit and len(commit) == 12 and head.stdout.startswith(commit)
    (tmp_path / "a").write_text("2")
    assert versions.commit(tmp_path) == f"{commit}-dirty"
    (tmp_path / "site").mkdir()
    assert versions.commit(tmp_path / "site") is None


def test_the_package_is_in_a_checkout_or_in_none():
    """`ROOT` is the folder above the package, whatever the depth of this module."""
    assert (versions.ROOT / "dynappo" / "config" / "versions.py").samefile(versions.__file__)
    assert versions.of("jax") == metadata.version("jax") and versions.of("no-such") == "unknown"
