"""Every notebook runs, at a tiny size, and shows its outputs, small and clean (those for Colab have none).

The outputs are written by `make notebooks`, which runs notebooks/execute.py, at their full size.
"""

import ast
import base64
import importlib
import os
import re
from types import SimpleNamespace

import nbformat
import pytest
from answers import ROOT
from IPython.core.inputtransformer2 import TransformerManager
from nbclient import NotebookClient

from dynappo import config as config_lib

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
FOR_COLAB = ("05_colab", "06_playground")  # which carry no outputs
WITH_OUTPUTS = [path for path in NOTEBOOKS if path.stem not in FOR_COLAB]
MAX_BYTES, MAX_GIF = 300_000, 120_000  # of what is stored with every change
SHOWS = {"print": "stream", "show": "image/", "display": "image/", "show_sweep": "stream"}
SHOWN = ("return", "fall_rate")  # by the first run's evaluation
# a path that begins at the root of a machine, or at a drive; not part of an address or a fraction
ABSOLUTE = re.compile(r"(?<![\w.:/<])/(?!/)\w+/\w|\b[A-Z]:\\")
# notebook -> what its cell "parameters" is replaced by
TINY = {
    "01_first_run": {
        "spec": "configs/go1.py:laptop",
        "changes": {
            "run.num_iterations": 2,
            "run.log_every": 1,
            "run.eval_envs": 2,
            "run.video_seconds": 0.1,
            "rollout.num_envs": 16,
            "rollout.horizon": 12,
            "schedule.end_iteration": 1,  # a tail from the first iteration
            "schedule.end_steps": 2,
            "task.episode_length": 20,
        },
    },
    "02_look_at_a_policy": {
        "what": "go1",
        "points": 2,
        "seconds": 1.2,
        "film_seconds": 0.2,
        "serve_seconds": 0.1 if importlib.util.find_spec("mjviser") else 0,
        "mjx_episodes": 0,
    },
    "03_model_error": {
        "spec": "configs/go1.py:quick",
        "changes": {
            "run.num_iterations": 4,
            "run.log_every": 2,
            "run.eval_envs": 0,
            "rollout.num_envs": 16,
            "rollout.horizon": 8,
            "schedule.end_steps": 2,
        },
        "steps": 3,
    },
    "04_seed_sweep": {
        "spec": "configs/go1.py:quick",
        "changes": {
            "run.num_iterations": 4,
            "run.log_every": 2,
            "run.eval_envs": 2,
            "rollout.num_envs": 8,
            "rollout.horizon": 8,
            "schedule.end_steps": 2,
            "task.episode_length": 20,
        },
        "num_seeds": 2,
        "field": "ppo.entropy_coef",
        "values": [0.0, 0.3],
    },
}


TINY["05_colab"] = {
    "repository": "",
    "config": "go1:laptop",
    "flags": " ".join(
        f"--config.{field}"
        for field in (
            "run.num_iterations=2 run.log_every=1 run.eval_envs=2 run.video_seconds=0.1 rollout.num_envs=16 "
            "rollout.horizon=12 schedule.end_iteration=1 schedule.end_steps=2 task.episode_length=20"
        ).split()
    ),
    "workdir": "set by its test",
    "install": False,
}

TINY["06_playground"] = TINY["05_colab"] | {
    "task": "Go1JoystickFlatTerrain",
    "flags": " ".join(
        f"--config.{field}"
        for field in (
            "run.num_iterations=2 run.log_every=1 run.eval_envs=2 run.eval_steps=4 run.video_seconds=0.2 "
            "rollout.num_envs=8 rollout.horizon=6 schedule.end_iteration=0 schedule.end_steps=4 "
            "model.minibatches=3 ppo.minibatches=2 ppo.shuffle_blocks=1 run.device=cpu "
            "model.precision=highest ppo.precision=highest"
        ).split()
    ),
}
del TINY["06_playground"]["config"]


def read(path):
    """The notebook, checked against the format's schema."""
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    return notebook


def code(notebook):
    """Its code cells."""
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def python(cell):
    """The syntax tree of a cell; its lines of IPython (!, %) as the calls that they stand for."""
    return ast.parse(TransformerManager().transform_cell(cell.source))


def parameters(notebook):
    """The one cell tagged "parameters"."""
    (cell,) = [c for c in notebook.cells if "parameters" in c.metadata.get("tags", [])]
    return cell


def assigned(source):
    """Names that are assigned in `source`."""
    nodes = ast.walk(ast.parse(source))
    return {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def execute(path, sizes):
    """The notebook as run with `sizes`, in its own folder, as a person would.

    Half of the time is compilation, so XLA optimises little.
    """
    notebook = read(path)
    cell = parameters(notebook)
    assert assigned(cell.source) == set(sizes), "the test must set every parameter"
    cell.source = "\n".join(f"{name} = {value!r}" for name, value in sizes.items())
    client = NotebookClient(notebook, timeout=300, kernel_name="python3")
    client.resources = {"metadata": {"path": str(path.parent)}}
    paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
    flags = os.environ.get("XLA_FLAGS", "") + " --xla_backend_optimization_level=0"
    ours = {"PYTHONPATH": os.pathsep.join(filter(None, paths)), "XLA_FLAGS": flags.strip()}
    client.execute(env=os.environ | ours)  # raises at the first cell that does
    return notebook


def outputs(notebook, kind):
    """Data of the outputs of one MIME type."""
    found = [out for cell in code(notebook) for out in cell.outputs]
    return [out.data[kind] for out in found if "data" in out and kind in out.data]


def printed(notebook):
    """Everything printed to stdout."""
    found = [out for cell in code(notebook) for out in cell.outputs]
    return "".join(
        out.text for out in found if out.output_type == "stream" and out.name == "stdout"
    )


def test_every_notebook_is_executed_by_a_test():
    assert NOTEBOOKS and {path.stem for path in NOTEBOOKS} == set(TINY)


@pytest.mark.slow
def test_the_first_run_trains_plots_and_evaluates():
    path = ROOT / "notebooks" / "01_first_run.ipynb"
    notebook = execute(path, TINY[path.stem])
    figures = [base64.b64decode(data) for data in outputs(notebook, "image/png")]
    assert len(figures) >= 2 and all(len(png) > 5000 for png in figures)
    text = printed(notebook)
    assert "iterations 1 to 24: 2 2" in text
    assert "iteration    1" in text and "iteration    2" in text
    for name in ("return", "length", "fall_rate", "tracking_error", "yaw_error"):
        assert any(line.split()[:1] == [name] for line in text.splitlines()), f"no {name}:\n{text}"
    assert outputs(notebook, "image/gif") or "no video:" in text  # which says what to install


@pytest.mark.slow
def test_the_model_error_is_shown_for_every_group_of_numbers():
    path = ROOT / "notebooks" / "03_model_error.ipynb"
    notebook = execute(path, TINY[path.stem])
    (figure,) = [base64.b64decode(data) for data in outputs(notebook, "image/png")]
    assert len(figure) > 5000
    lines = [line for line in printed(notebook).splitlines() if "1 step" in line]
    assert len(lines) == 5
    for line in lines:  # the ratios are numbers, and a model fitted twice is not yet wild
        assert all(0 < float(line.split()[i]) < 30 for i in (-4, -1)), line


@pytest.mark.slow
def test_a_look_at_a_policy_shows_tables_maps_and_gaits():
    path = ROOT / "notebooks" / "02_look_at_a_policy.ipynb"
    notebook = execute(path, TINY[path.stem])
    figures = [base64.b64decode(data) for data in outputs(notebook, "image/png")]
    assert len(figures) >= 3 and all(len(png) > 5000 for png in figures)
    text = printed(notebook)
    assert "a policy of go1, an action every 20 ms" in text
    assert "cost of transport" in text and "1 m/s ahead" in text
    assert outputs(notebook, "image/gif") or "no video:" in text  # which says what to install
    if TINY[path.stem]["serve_seconds"]:
        assert any("iframe" in page for page in outputs(notebook, "text/html"))


@pytest.mark.slow
def test_a_sweep_shows_curves_of_its_seeds_and_of_a_setting():
    path = ROOT / "notebooks" / "04_seed_sweep.ipynb"
    notebook = execute(path, TINY[path.stem])
    figures = [base64.b64decode(data) for data in outputs(notebook, "image/png")]
    assert len(figures) == 2 and all(len(png) > 5000 for png in figures)
    text = printed(notebook)
    assert "95 % interval" in text and text.count("iteration    4  return of each seed") == 2
    for name in ("return", "fall_rate"):  # a number of each seed
        (line,) = [line for line in text.splitlines() if line.startswith(f"{name:15s} [")]
        assert len(line.replace("[", " ").replace("]", " ").split()) == 3, line


@pytest.mark.slow
def test_on_colab_a_run_is_trained_and_its_film_is_shown(tmp_path):
    """Here on a CPU, and what it installs is there already."""
    path = ROOT / "notebooks" / "05_colab.ipynb"
    notebook = execute(path, TINY[path.stem] | {"workdir": str(tmp_path / "run")})
    text = printed(notebook)
    assert "evaluation: return" in text and "walk.html (" in text
    assert (tmp_path / "run" / "walk.html").stat().st_size > 50_000
    assert outputs(notebook, "image/png")
    filmed = "<video" in "".join(outputs(notebook, "text/html"))
    assert filmed or "no video:" in text  # which says what to install


@pytest.mark.slow
def test_on_colab_a_task_of_playground_is_trained_shown_and_exported(tmp_path):
    pytest.importorskip("mujoco_playground", reason="MuJoCo Playground is not installed")
    path = ROOT / "notebooks" / "06_playground.ipynb"
    notebook = execute(path, TINY[path.stem] | {"workdir": str(tmp_path / "run")})
    text = printed(notebook)
    assert "evaluation: return" in text and "policy.onnx (" in text
    assert (tmp_path / "run" / "policy.onnx").is_file() and outputs(notebook, "image/png")
    filmed = "<video" in "".join(outputs(notebook, "text/html"))
    assert filmed or "no video:" in text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_uses_only_what_there_is(path):
    """Every module of dynappo, and beside it, that it imports, and every name that it takes from one."""
    nodes = [n for cell in code(read(path)) for n in ast.walk(python(cell))]
    modules = {}
    for node in nodes:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dynappo"):
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                found = getattr(importlib.import_module(node.module), alias.name, None)
                modules[alias.asname or alias.name] = found or importlib.import_module(name)
        if isinstance(node, ast.Import):  # a file beside the notebook
            here = [a.name for a in node.names if (path.parent / f"{a.name}.py").exists()]
            modules |= {name: importlib.import_module(f"notebooks.{name}") for name in here}
    used = [n for n in nodes if isinstance(n, ast.Attribute) and isinstance(n.value, ast.Name)]
    taken = {(n.value.id, n.attr) for n in used if n.value.id in modules}
    missing = [f"{name}.{attr}" for name, attr in taken if not hasattr(modules[name], attr)]
    assert (taken or path.stem in FOR_COLAB) and not missing


@pytest.mark.parametrize("name", FOR_COLAB)
@pytest.mark.parametrize(
    ("repository", "said"),
    [(None, "put your clone's address into"), ("https://no.example/x", "could not be cloned")],
)
def test_on_colab_nothing_is_installed_without_a_clone(
    name, repository, said, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    inputs, install = (
        python(cell) for cell in code(read(ROOT / "notebooks" / f"{name}.ipynb"))[:2]
    )
    names, shell = {}, SimpleNamespace(system=lambda _: None)  # a git that clones nothing
    names["get_ipython"] = lambda: shell
    exec(compile(inputs, name, "exec"), names)
    names["repository"] = repository or names["repository"]
    with pytest.raises(SystemExit, match=said):
        exec(compile(install, name, "exec"), names)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_defines_nothing(path):
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef, ast.Lambda)
    cells = code(read(path))
    found = [n for cell in cells for n in ast.walk(python(cell)) if isinstance(n, kinds)]
    assert not found, "what a notebook needs belongs into dynappo/, where it is tested"


def test_the_first_runs_words_have_the_numbers_of_its_outputs_and_of_the_configs():
    """Those of README.md: tests/results/test_claims.py."""
    notebook = read(ROOT / "notebooks" / "01_first_run.ipynb")
    words = " ".join(c.source for c in notebook.cells if c.cell_type == "markdown").split()
    words, shown = " ".join(words), printed(notebook)
    found = {name: float(re.findall(rf"(?m)^{name} +([0-9.]+)$", shown)[0]) for name in SHOWN}
    laptop, best = (config_lib.load(name) for name in ("go1:laptop", "go1"))
    falls = round(found["fall_rate"] * laptop.run.eval_envs)
    for text in (
        f"its return is {found['return']:.1f} of 45, and {falls} of {laptop.run.eval_envs} robots fell",
        f"`go1:laptop` is {laptop.rollout.num_envs} robots on C MuJoCo",
        f"`configs/go1.py` trains {best.rollout.num_envs} robots.",
        f"After {laptop.run.num_iterations} iterations, the default of `go1:laptop`",
        f"From iteration {laptop.schedule.end_iteration} on it writes {laptop.schedule.end_steps} of "
        f"{laptop.rollout.horizon} steps",
    ):
        assert text in words, text


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_a_notebook_is_small(path):
    notebook = read(path)
    assert path.stat().st_size <= MAX_BYTES
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert notebook.metadata.kernelspec.name == "python3"
    assert notebook.metadata.language_info == {"name": "python"}


@pytest.mark.parametrize("name", FOR_COLAB)
def test_a_notebook_for_colab_carries_no_outputs_and_is_named_in_the_page(name):
    page = (ROOT / "docs" / "install.md").read_text().split("## Colab")[1].split("\n## ")[0]
    assert f"../notebooks/{name}.ipynb" in page
    for cell in code(read(ROOT / "notebooks" / f"{name}.ipynb")):
        assert not cell.outputs and cell.execution_count is None, "clear all outputs, then save"


def kinds(cell):
    """The MIME types of a cell's outputs; of what is printed `stream`."""
    return [kind for out in cell.outputs for kind in out.get("data", [out.output_type])]


@pytest.mark.parametrize("path", WITH_OUTPUTS, ids=lambda p: p.stem)
def test_a_notebook_was_run_from_top_to_bottom_and_shows_what_it_prints_and_draws(path):
    cells = code(read(path))
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    for cell in cells:
        tree = python(cell)
        inner = {n for node in ast.walk(tree) if isinstance(node, ast.If) for n in ast.walk(node)}
        calls = [n.func for n in ast.walk(tree) if isinstance(n, ast.Call) and n not in inner]
        named = {getattr(call, "id", None) or getattr(call, "attr", None) for call in calls}
        for name in named & set(SHOWS):
            found = [kind for kind in kinds(cell) if kind.startswith(SHOWS[name])]
            assert found, f"no output of {name}; run make notebooks:\n{cell.source}"
    every = [kind for cell in cells for kind in kinds(cell)]
    assert ("image/gif" in every) == (path.stem in ("01_first_run", "02_look_at_a_policy"))


@pytest.mark.parametrize("path", WITH_OUTPUTS, ids=lambda p: p.stem)
def test_outputs_hold_no_error_no_escape_code_and_no_path_of_a_machine(path):
    notebook = read(path)
    for out in (out for cell in code(notebook) for out in cell.outputs):
        assert out.output_type in ("stream", "display_data"), out
        assert out.get("name", "stdout") == "stdout", out
        data = out.get("data", {})
        assert set(data) <= {"text/plain", "image/png", "image/gif"}
        for text in (out.get("text", ""), data.get("text/plain", "")):
            assert "\x1b" not in text and "\r" not in text and not ABSOLUTE.search(text), text
    for gif in outputs(notebook, "image/gif"):
        assert len(base64.b64decode(gif)) <= MAX_GIF


def test_a_path_of_a_machine_is_seen():
    for text in ("/home/me/dynappo/x.py:3: Warning", "in /tmp/tmp3/film.gif", "C:\\Users\\me"):
        assert ABSOLUTE.search(text), text
    for text in ("13.9 k steps/s", "https://host/a/b", "runs/go1/metrics.csv", "error / error"):
        assert not ABSOLUTE.search(text), text
