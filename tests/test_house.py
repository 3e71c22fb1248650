"""Who may import whom, who may print and read files, and how long things may get."""

import ast
import pathlib
import sys

import pytest

import dynappo

PACKAGE = pathlib.Path(dynappo.__file__).parent
CONFIGS = PACKAGE.parent / "configs"
# A file imports only from earlier groups; the last group imports what it likes.
GROUPS = (
    {"types", "config", "schedule", "validate"},
    {"networks", "gae", "rewards", "actuators", "observe", "moments"},
    {
        "robot",
        "env",
        "commands",
        "physics",
        "warp_physics",
        "contacts",
        "randomize",
        "dynamics",
        "ppo",
    }
    | {"rollout", "brax_env", "model_error", "model_rows", "first_order", "summary"},
    {"algorithm", "evaluate", "sweep"},
    {"checkpoint", "log", "render", "files", "export", "train", "play", "bench", "console", "flags"}
    | {
        "distributed",
        "curves",
        "memory",
        "policy_file",
        "episode",
        "page",
        "viewer",
        "measure",
        "report",
        "figures",
        "results",
        "joint_order",
        "versions",
    },
)
WITHIN = {
    "config": {"validate"},
    "validate": {"schedule"},
    "env": {"robot", "commands", "randomize", "physics"},
    "physics": {"robot", "randomize", "warp_physics", "contacts"},
    "contacts": {"robot"},
    "dynamics": {"model_rows"},
    "model_error": {"dynamics", "model_rows"},
    "evaluate": {"algorithm", "report"},  # report: only where it is run as a command
    "sweep": {"algorithm", "evaluate"},
}  # allowed inside a group
HOST = GROUPS[-1]
READ_FILES = {"config", "validate", "robot"}
WITHOUT_JAX = set("config validate schedule flags rewards actuators observe robot".split())
MAX_FILE, MAX_FUNCTION = 300, 70  # lines

FILES = sorted(PACKAGE.glob("*.py"))
MODULES = [f for f in FILES if f.stem != "__init__"]
CORE = [f for f in MODULES if f.stem not in HOST]


def tree(file):
    """The syntax tree of a file."""
    return ast.parse(file.read_text(), str(file))


def imports(file):
    """Dotted names of everything a file imports, at its top or inside functions."""
    names = set()
    for node in ast.walk(tree(file)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file.name} imports relatively, line {node.lineno}"
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def modules_of_ours(file):
    """The modules of dynappo that a file imports."""
    parts = [name.split(".") for name in imports(file)]
    return {p[1] for p in parts if p[0] == "dynappo" and len(p) > 1}


def third_party(file):
    """The packages outside Python and dynappo that a file imports."""
    return {name.split(".")[0] for name in imports(file)} - sys.stdlib_module_names - {"dynappo"}


def calls(file):
    """`(name, line)` of every call by its last name: `print(...)`, `jax.debug.print(...)`."""
    for node in ast.walk(tree(file)):
        if isinstance(node, ast.Call):
            name = getattr(node.func, "id", None) or getattr(node.func, "attr", None)
            yield name, node.lineno


def test_the_checks_see_the_package():
    assert {"types", "algorithm", "env"} <= {f.stem for f in MODULES}
    assert "ppo" in modules_of_ours(PACKAGE / "algorithm.py")
    assert "types" in modules_of_ours(PACKAGE / "ppo.py")
    assert "jax" in third_party(PACKAGE / "ppo.py")


@pytest.mark.parametrize("file", MODULES, ids=lambda f: f.stem)
def test_every_file_belongs_to_one_group(file):
    assert sum(file.stem in group for group in GROUPS) == 1, (
        f"dynappo/{file.name} is in no group of tests/test_layers.py: say what it may import"
    )


@pytest.mark.parametrize("file", CORE, ids=lambda f: f.stem)
def test_a_file_imports_from_earlier_groups_only(file):
    earlier = set()
    for group in GROUPS:
        if file.stem in group:
            break
        earlier |= group
    wrong = modules_of_ours(file) - earlier - WITHIN.get(file.stem, set())
    assert not wrong, f"dynappo/{file.name} imports {', '.join(sorted(wrong))}"


def test_the_package_itself_imports_nothing():
    assert imports(PACKAGE / "__init__.py") <= {"os", "importlib.metadata"}


@pytest.mark.parametrize(
    "file", [f for f in MODULES if f.stem in WITHOUT_JAX], ids=lambda f: f.stem
)
def test_what_play_and_validation_need_starts_without_jax(file):
    names = imports(file)
    heavy = {"jax", "jaxlib", "flax", "optax", "brax", "chex"}
    assert not third_party(file) & heavy
    assert not [name for name in names if name.startswith("mujoco.mjx")]
    # and so does everything of ours that it imports
    assert modules_of_ours(file) <= WITHOUT_JAX


@pytest.mark.parametrize("file", CORE, ids=lambda f: f.stem)
def test_only_host_files_print_read_the_clock_and_touch_files(file):
    banned = {"print", "input", "breakpoint", "callback", "pure_callback", "io_callback"}
    if file.stem not in READ_FILES:
        banned |= {"open", "read_text", "write_text", "read_bytes", "write_bytes", "mkdir"}
    found = [f"{name}() in line {line}" for name, line in calls(file) if name in banned]
    assert not found, f"dynappo/{file.name}: {', '.join(found)}"
    modules = {name.split(".")[0] for name in imports(file)}
    clocks = {"time", "datetime", "timeit", "logging", "subprocess", "socket", "threading"}
    assert not modules & clocks
    if file.stem not in READ_FILES:
        assert not modules & {"pathlib", "os", "shutil", "tempfile", "glob"}


@pytest.mark.parametrize("file", sorted(CONFIGS.glob("*.py")), ids=lambda f: f.stem)
def test_config_files_import_ml_collections_and_the_standard_library_only(file):
    assert third_party(file) <= {"ml_collections"} and not modules_of_ours(file)


@pytest.mark.parametrize("file", CORE, ids=lambda f: f.stem)
def test_core_files_stay_short(file):
    lines = len(file.read_text().splitlines())
    assert lines <= MAX_FILE, f"dynappo/{file.name} has {lines} lines, at most {MAX_FILE}"


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.stem)
def test_functions_stay_short(file):
    functions = [n for n in ast.walk(tree(file)) if isinstance(n, ast.FunctionDef)]
    lengths = [(f.name, f.end_lineno - f.lineno + 1) for f in functions]
    long = [f"{name} has {n} lines" for name, n in lengths if n > MAX_FUNCTION]
    assert not long, f"dynappo/{file.name}: {', '.join(long)}, at most {MAX_FUNCTION}"


def test_no_file_is_a_drawer_for_anything():
    drawers = ("util", "common", "base", "misc", "helper")
    assert not [f.name for f in FILES if any(word in f.stem for word in drawers)]


def test_every_file_says_what_it_is_for():
    assert not [f.name for f in FILES if not ast.get_docstring(tree(f))]
