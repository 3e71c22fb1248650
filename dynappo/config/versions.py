"""Which code made a result: the versions of packages, and the commit of a checkout."""

import subprocess
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def of(package: str) -> str:
    """The installed version of a package; "unknown" if it is not installed."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "unknown"


def commit(root: Path = ROOT) -> str | None:
    """The commit of this package's checkout, with `-dirty` if files differ; None without a checkout."""
    if not (root / ".git").exists():  # a wheel may lie inside of somebody else's checkout
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
