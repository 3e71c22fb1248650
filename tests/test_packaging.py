"""What installs: versions that belong together, one set of exact ones, and a wheel with its data."""

import ast
import os
import pathlib
import re
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata

import published
import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

ROOT = pathlib.Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT = PYPROJECT["project"]
NAMES_NO_INDEX = ("pyproject.toml", "constraints.txt", "Makefile", ".ci/run", "Dockerfile")
PINNED_EXTRAS = ("dev", "video", "web", "export", "notebook", "warp")


def requirements(*extras):
    """`{name: Requirement}` of the dependencies and of these extras."""
    texts = [*PROJECT["dependencies"]]
    for extra in extras:
        texts += PROJECT["optional-dependencies"][extra]
    return {canonicalize_name(r.name): r for r in map(Requirement, texts)}


def pins():
    """`{name: Requirement}` of constraints.txt."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    rows = [Requirement(line) for line in lines if line and not line.startswith("#")]
    assert len({canonicalize_name(r.name) for r in rows}) == len(rows), "a name appears twice"
    return {canonicalize_name(r.name): r for r in rows}


def exact(requirement):
    """The version of `name==version`."""
    (spec,) = requirement.specifier
    assert spec.operator == "==" and "*" not in spec.version, f"{requirement} is no exact version"
    return spec.version


def third_party_imports(folder):
    """Top-level names that the Python files of a folder import from outside."""
    names = set()
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name.split(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module.split(".")[0])
    return names - sys.stdlib_module_names - {"dynappo", "configs"}


def test_mujoco_is_pinned_to_the_series_of_mjx():
    ours = requirements()
    assert ours["mujoco"].specifier == ours["mujoco-mjx"].specifier
    version = exact(pins()["mujoco-mjx"])
    series, after = version.rsplit(".", 1)[0], int(version.split(".")[1]) + 1
    assert ours["mujoco"].specifier == SpecifierSet(f">={series},<{version.split('.')[0]}.{after}")
    assert exact(pins()["mujoco"]) == version


def test_warp_is_the_version_that_mjx_declares():
    declared = [Requirement(text) for text in metadata.requires("mujoco-mjx") or ()]
    (warp,) = [
        r for r in declared if r.name == "warp-lang" and r.marker.evaluate({"extra": "warp"})
    ]
    assert requirements("warp")["warp-lang"].specifier == warp.specifier
    assert exact(pins()["warp-lang"]) == exact(warp)


def test_every_direct_dependency_has_one_exact_version_that_fits():
    pinned = pins()
    for name, requirement in requirements(*PINNED_EXTRAS).items():
        assert name in pinned, f"constraints.txt lacks {name}: make it again, as it says"
        assert requirement.specifier.contains(exact(pinned[name]), prereleases=True), requirement


def test_what_is_installed_is_what_constraints_say():
    found = {}
    for name, requirement in pins().items():
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue  # of an extra that is not installed
        if (requirement.marker is None or requirement.marker.evaluate()) and (
            version != exact(requirement)
        ):
            found[name] = f"{version}, expected {exact(requirement)}"
    assert not found, f"{found}: pip install -c constraints.txt -e '.[dev,video,web]'"


def test_cuda_is_a_name_of_cuda13():
    """And each is what JAX calls so, of the version that is pinned for the CPU too."""
    extras = PROJECT["optional-dependencies"]
    assert extras["cuda"] == extras["cuda13"] == ["jax[cuda13]"] and extras["cuda12"] == [
        "jax[cuda12]"
    ]
    provided = metadata.metadata("jax").get_all("Provides-Extra") or []
    assert {"cuda12", "cuda13"} <= set(provided)
    assert exact(pins()["jax"]) == exact(pins()["jaxlib"])


@pytest.mark.parametrize("folder", ["dynappo", "configs"])
def test_everything_imported_is_declared(folder):
    distributions = metadata.packages_distributions()
    optional = {name for extra in PROJECT["optional-dependencies"] for name in requirements(extra)}
    for name in third_party_imports(folder):
        if name == "warp":  # where it is not installed, nobody knows whose it is
            name = "warp-lang"
        providers = {canonicalize_name(d) for d in distributions.get(name, [name])}
        assert providers & optional, f"{folder} imports {name}, which pyproject.toml lacks"


@pytest.mark.parametrize("name", NAMES_NO_INDEX)
def test_no_file_names_an_index_or_a_machine(name):
    text = (ROOT / name).read_text()
    for word in ("index-url", "find-links", "://", "/root", "/home", "/tmp", "/opt"):
        assert word not in text, f"{name} has {word}"


def test_the_container_has_what_the_package_is_made_of():
    """Every path that it copies is there, and sent to Docker; they hold what the wheel and its build need."""
    text = (ROOT / "Dockerfile").read_text()
    words = [line.split() for line in text.splitlines()]
    copied = {name for line in words if line[:1] == ["COPY"] for name in line[1:-1]}
    sent = (ROOT / ".dockerignore").read_text().splitlines()
    assert copied == {line[1:] for line in sent if line.startswith("!")} and "*" in sent
    wheel = PYPROJECT["tool"]["hatch"]["build"]["targets"]["wheel"]["only-include"]
    needed = {
        *wheel,
        "pyproject.toml",
        PROJECT["readme"],
        *PROJECT["license-files"],
        "constraints.txt",
    }
    assert copied == needed and all((ROOT / name).exists() for name in copied)
    (extras,) = re.findall(r"ARG EXTRAS=(\S+)", text)
    for extra in [*extras.split(","), "cuda12"]:
        assert extra in PROJECT["optional-dependencies"]
    assert 'pip install --no-cache-dir -c constraints.txt -e ".[${EXTRAS}]"' in text


def test_the_licence_and_the_citation_agree_with_the_project():
    assert PROJECT["license"] == "Apache-2.0"
    text = (ROOT / "LICENSE").read_text()
    assert "Apache License" in text and "END OF TERMS AND CONDITIONS" in text
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0" and citation["type"] == "software"
    assert str(citation["version"]) == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]
    (paper,) = citation["references"]
    assert paper["title"].startswith("Learning to Walk With Less") and len(paper["authors"]) == 7


def test_what_ci_runs_can_be_run_and_ends_with_the_tests():
    script = ROOT / ".ci" / "run"
    assert os.access(script, os.X_OK)
    lines = script.read_text().splitlines()
    assert lines[0].startswith("#!") and "set -euo pipefail" in lines
    assert [re.sub(r"^make .*?(\w+)$", r"\1", x) for x in lines[-2:]] == ["check", "test"]


@pytest.mark.slow
def test_the_wheel_carries_configs_and_robots_and_finds_them(tmp_path):
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check", "-q"]
    subprocess.run([*pip, "wheel", "--no-deps", "-w", tmp_path, ROOT], check=True)
    (wheel,) = tmp_path.glob("dynappo-*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    expected = {"dynappo/page/page.html", "dynappo/page/page.js", "dynappo/robots/go1/policy.npz"}
    for folder, inside in (("dynappo", "."), ("configs", "dynappo"), ("robots", "dynappo")):
        files = [f.relative_to(ROOT) for f in (ROOT / folder).rglob("*") if f.is_file()]
        files = [f for f in files if "__pycache__" not in f.parts]
        expected |= {(pathlib.PurePath(inside) / f).as_posix() for f in files}
    assert {"dynappo/configs/go1.py", "dynappo/robots/go1/go1.xml"} < expected <= names
    assert {name.split("/")[0] for name in names} == {
        "dynappo",
        f"dynappo-{wheel.name.split('-')[1]}.dist-info",
    }
    assert any(name.endswith("LICENSE") for name in names)

    site = tmp_path / "site"
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    subprocess.run([*pip, "install", "--no-deps", "--target", site, wheel], check=True)
    command = [sys.executable, "-m", "dynappo.train", "--config=configs/go1.py:quick"]
    play = [sys.executable, "-m", "dynappo.play", "go1", "--command=0.6,0,0", "--seconds=3"]
    environment = os.environ | {"PYTHONPATH": str(site)}
    published.write(elsewhere)
    adopt = [sys.executable, "-m", "dynappo.adopt", "toy.xml", "--name=mine"]
    look = [sys.executable, "-m", "dynappo.look", "configs/mine.py"]
    train = [sys.executable, "-m", "dynappo.train", "--config=configs/mine.py:laptop"]
    small = "num_iterations=2 log_every=2 checkpoint_every=0 eval_envs=2 eval_steps=20 video_seconds=0.2"
    train += [f"--config.run.{field}" for field in small.split()]
    train += ["--config.rollout.num_envs=16", "--workdir=run"]
    show = "from dynappo import robot; from dynappo.config import files; "
    show += "print(files.find('configs', 'go1.py'), robot.load('go1').xml)"
    for arguments, status, text in (
        ([sys.executable, "-c", show], 0, f"{site}/dynappo/configs/go1.py {site}/dynappo/robots/"),
        ([*command, "--config.run.num_iterations=0"], 2, "run.num_iterations is 0"),
        ([*play, "--out=walk.html"], 0, "fall               none"),
        (adopt, 0, "written robots/mine/mine.xml, configs/mine.py"),
        (adopt, 2, "robots/mine is there already"),
        (look, 0, "12 joints"),
        (train, 0, "written to run: "),
    ):
        done = subprocess.run(
            arguments, cwd=elsewhere, env=environment, capture_output=True, text=True
        )
        assert done.returncode == status, done.stderr
        assert text in done.stdout + done.stderr
