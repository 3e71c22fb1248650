"""Who may import whom, by folder; who may print and touch files."""

import ast
import functools
import graphlib
import pathlib

import breaks
import pytest

import dynappo

PACKAGE = pathlib.Path(dynappo.__file__).parent
METHOD = {"types", "schedule", "stats", "rollout", "fast", "algorithm", "scores", "seeds"}
# folder -> other folders, and files beside them, that its modules may import; `method` are all these files
MAY_IMPORT = {
    "__main__": {"config"},
    "method": {"learner", "model"},
    "learner": {"types"},
    "model": {"learner", "types"},
    "config": {"terrain", "schedule"},
    "description": {"config"},
    "terrain": set(),
    "physics": {"terrain", "description", "config", "types"},
    "tasks": {"terrain", "physics", "description", "config", "types"},
    "policy": {"tasks", "terrain", "physics", "description", "config"},
    "page": {"policy", "terrain", "config"},
    "program": {"method", "tasks", "terrain", "physics", "description", "config"},
    "run": {"program", "policy", "config", "schedule", "seeds"},
    "sweeps": {"run", "program", "policy", "config"},
    "train": {"sweeps", "run", "program", "web", "config"},
    "evaluate": {
        "program",
        "page",
        "policy",
        "tasks",
        "terrain",
        "physics",
        "description",
        "config",
        "scores",
    },
    "adopt": {"tasks", "physics", "description", "config"},
    "look": {"policy", "tasks", "terrain", "physics", "description", "config"},
    "web": {"policy", "terrain", "description", "config"},
    "play": {"web", "page", "policy", "description", "config"},
    "export": {"policy", "tasks", "terrain", "description", "config"},
    "bench": {"program", "method", "model", "config"},
}
# of tasks and physics that is what these import, and the rewards, which NumPy computes too
WITHOUT_JAX = set("description policy page adopt look web play export config schedule".split())
WITHOUT_JAX |= {"tasks.velocity.rewards", "tasks.velocity.reward_sum"}
ASKS_MJX = {"physics.engine_contract"}  # about files with more in them than every engine has
JAX = {
    "description",
    "policy",
    "adopt",
    "look",
    "web",
    "play",
    "export",
    "config",
    "schedule",
}
WITHOUT_JAX |= {
    f"tasks.velocity.{name}"
    for name in ("rewards", "reward_sum", "observe", "own", "gait", "partners", "log_file")
}
WITHOUT_JAX |= {"physics.actuators", "physics.warp.scope"}
WITHOUT_JAX |= {f"terrain.{name}" for name in ("height_map", "tiles", "scan", "map_file")}
JAX = {"jax", "jaxlib", "flax", "optax", "orbax", "brax", "chex", "jaxtyping", "mujoco.mjx"}
# pure functions: nothing printed, no clock, no file
PURE = {"method", "learner", "model", "tasks", "terrain", "physics", "description"}
PURE |= {"config.splitting", "config.validation"}
SPEAKS = set("print input breakpoint callback pure_callback io_callback".split())
FILES = set("open read_text write_text read_bytes write_bytes mkdir unlink".split())
CLOCKS = set("time datetime timeit logging subprocess socket threading".split())
PATHS = set("pathlib os shutil tempfile glob".split())
# pure modules that may do more: some read a file, or write meshes that another package reads; some ask for
# cores, or lock what threads share
MAY_ALSO = {
    "tasks.names": FILES | PATHS,
    "tasks.playground.assets": FILES | PATHS,
    "tasks.playground.c_physics": {"pure_callback"},
    "tasks.playground.loading": {"pathlib", "os"},
    "tasks.playground.swapped": {"threading"},
    "description.faults": FILES,
    "description.robot": FILES | PATHS,
    "tasks.velocity.log_file": FILES | PATHS,
    "terrain.map_file": FILES | PATHS,
    "physics.warp.native": FILES | PATHS,
    "physics.c_mujoco": {"threading"},
    "physics.cores": FILES | {"os"},
    "physics.warp.building": {"threading"},
}


MAY_TOO = {
    "seeds": {"config.fields"}
}  # modules that may import more: it is asked for values of fields


def name_of(file):
    """`run.loop` of dynappo/run/loop.py; of an __init__ its folder, "" for that of the package."""
    parts = file.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(file): file for file in sorted(PACKAGE.rglob("*.py"))}
FOLDERS = sorted({file.parent for file in MODULES.values()} - {PACKAGE})


def inside(name, places):
    """Whether a module is one of `places`, or in one of these folders."""
    own = "method" in places and name in METHOD
    return own or any(name == p or name.startswith(f"{p}.") for p in places)


@functools.cache
def tree(name):
    """The syntax tree of a module, without what is there for type checkers only."""

    class Runs(ast.NodeTransformer):
        def visit_If(self, node):
            return None if ast.unparse(node.test) == "TYPE_CHECKING" else self.generic_visit(node)

    return Runs().visit(ast.parse(MODULES[name].read_text()))


@functools.cache
def imports(name):
    """Dotted names of all that a module imports, also inside functions."""
    names = set()
    for node in ast.walk(tree(name)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name} imports relatively, line {node.lineno}"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


@functools.cache
def ours(name):
    """The modules of dynappo that a module imports; a name in one counts as the module."""
    paths = [n.split(".")[1:] for n in imports(name) if n.split(".")[0] == "dynappo"]
    found = {".".join(p if ".".join(p) in MODULES else p[:-1]) for p in paths}
    return found - {name, ""}


@functools.cache
def reached(name):
    """All that is imported where a module is, its folders' __init__ among it."""
    seen, todo = set(), [name, ""]
    while todo:
        module = todo.pop()
        if module not in seen:
            seen.add(module)
            todo += [*ours(module), *([module.rpartition(".")[0]] if "." in module else [])]
    return seen


@pytest.mark.parametrize("name", [n for n in MODULES if n])
def test_a_module_imports_from_the_folders_that_its_own_may(name):
    folder = "method" if name in METHOD else name.split(".")[0]
    may = MAY_IMPORT[folder] | {folder} | MAY_TOO.get(name, set())
    assert not {other for other in ours(name) if not inside(other, may)}, sorted(may)


def test_no_import_goes_round_in_a_circle():
    graphlib.TopologicalSorter({name: ours(name) for name in MODULES}).prepare()


def test_no_two_folders_import_each_other():
    """Nor do more of them go round; the files beside the folders count alone."""
    between: dict[str, set[str]] = {}
    for name in MODULES:
        folder = name.split(".")[0]
        between.setdefault(folder, set()).update(other.split(".")[0] for other in ours(name))
    for folder, others in between.items():
        others.discard(folder)
    graphlib.TopologicalSorter(between).prepare()


@pytest.mark.parametrize("name", [n for n in MODULES if inside(n, WITHOUT_JAX)])
def test_what_plays_exports_and_checks_settings_needs_no_jax(name):
    found = {f"{m}: {n}" for m in reached(name) - ASKS_MJX for n in imports(m) if inside(n, JAX)}
    assert not found


@pytest.mark.parametrize("name", [n for n in MODULES if inside(n, PURE)])
def test_pure_modules_do_not_print_read_the_clock_or_touch_files(name):
    banned = (SPEAKS | FILES | CLOCKS | PATHS) - MAY_ALSO.get(name, set())
    calls = [n.func for n in ast.walk(tree(name)) if isinstance(n, ast.Call)]
    found = {getattr(f, "id", None) or getattr(f, "attr", None) for f in calls}
    found = found & (SPEAKS | FILES) | {n.split(".")[0] for n in imports(name)} & (CLOCKS | PATHS)
    assert not found & banned


def test_every_file_says_what_it_is_for():
    for name, file in MODULES.items():
        assert ast.get_docstring(tree(name)), file


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda f: f.name)
def test_a_folder_says_what_is_in_it_and_who_imports_it(folder):
    text = ast.get_docstring(tree(name_of(folder / "__init__.py"))) or ""
    names = [f.stem for f in folder.glob("*.py") if not f.stem.startswith("__")]
    assert "import" in text and not [name for name in names if f"`{name}`" not in text]


def test_what_breaks_py_breaks_is_there():
    """Each text is in its file once it is run, and the tests that must see it exist."""
    for path, text, instead, tests in breaks.BREAKS:
        whole = (breaks.ROOT / path).read_text()
        assert text in whole and text != instead, f"{path} has no {text!r}"
        assert all((breaks.ROOT / "tests" / name).is_file() for name in tests.split()), tests
