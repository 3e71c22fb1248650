"""Which devices and which engine: what a config asks for and this machine has not is one line."""

import importlib.util
import json
import pathlib
import re
import threading
from types import SimpleNamespace

import jax
import pytest
from answers import refused, shell

from dynappo import config as config_lib
from dynappo.program import devices


def config(**fields):
    """A valid config with `group__field` set."""
    config = config_lib.load("configs/go1.py:dyna4")
    for name, value in fields.items():
        group, _, leaf = name.partition("__")
        config[group][leaf] = value
    return config_lib.validate(config)


@pytest.fixture
def machine(monkeypatch):
    """`machine(platform, count, warp)`: JAX sees so many devices of a kind, with warp-lang or without."""

    def pretend(platform, count=1, warp=True):
        these = [SimpleNamespace(platform=platform) for _ in range(count)]
        cpus = [SimpleNamespace(platform="cpu")]
        monkeypatch.setattr(jax, "devices", lambda kind=None: cpus if kind == "cpu" else these)
        monkeypatch.setattr(jax, "default_backend", lambda: platform)
        found = object() if warp else None
        monkeypatch.setattr(importlib.util, "find_spec", lambda name: found)

    return pretend


@pytest.mark.parametrize(
    ("impl", "device", "platform", "warp", "expected"),
    [
        ("auto", "auto", "gpu", True, "warp"),
        ("auto", "auto", "gpu", False, "jax"),
        ("auto", "auto", "cpu", True, "jax"),
        ("auto", "cpu", "gpu", True, "jax"),
        ("jax", "gpu", "gpu", True, "jax"),
        ("warp", "gpu", "gpu", True, "warp"),
    ],
)
def test_the_engine_is_warp_where_it_can_run(machine, impl, device, platform, warp, expected):
    machine(platform, warp=warp)
    assert devices.engine(config(physics__impl=impl, run__device=device)) == expected


@pytest.mark.parametrize(
    ("fields", "platform", "warp", "expected"),
    [
        (
            {"run__device": "gpu"},
            "cpu",
            True,
            "run.device is gpu, but JAX sees none; .* pip install .*cuda12",
        ),
        ({"physics__impl": "warp"}, "cpu", True, "JAX sees no NVIDIA GPU; .* pip install "),
        ({"physics__impl": "warp"}, "gpu", False, "warp-lang is not installed; .* pip install "),
        ({"run__mesh_env": 4}, "gpu", True, "is 1 x 4, but JAX sees 2 devices in 1 processes"),
    ],
)
def test_what_is_not_there_is_one_line(machine, fields, platform, warp, expected):
    machine(platform, 2, warp)
    assert re.search(expected, refused(devices.engine, config(**fields)))


def test_devices_start_in_a_thread_which_leaves_errors_to_who_asks(monkeypatch):
    threads, began = [], []

    def without_devices(kind=None):
        began.append(threading.current_thread())
        raise RuntimeError("no such platform")

    monkeypatch.setattr(jax, "devices", without_devices)
    monkeypatch.setattr(threading, "excepthook", threads.append)
    before = threading.enumerate()
    devices.begin()
    for thread in set(threading.enumerate()).difference(before):
        thread.join(10)
    assert refused(devices.available, "auto") == "JAX finds no device: no such platform"
    assert len(began) == 2 and began[0] is not began[1] is threading.current_thread()
    assert not threads  # nothing was printed


def test_a_process_of_our_own_keeps_its_programs_and_leaves_the_gpu_alone(tmp_path, monkeypatch):
    """Compiled programs go into the user's cache, unless they have a place already; small ones too."""
    code = (
        "import os, sys, jax; from dynappo.program import devices\n"
        "def told(device):\n"
        "    devices.own_process(device)\n"
        "    print(jax.config.jax_platforms, jax.config.jax_compilation_cache_dir, "
        "jax.config.jax_persistent_cache_min_compile_time_secs)\n"
        "told('cpu')\n"
        "del os.environ['JAX_COMPILATION_CACHE_DIR']\n"
        "jax.config.update('jax_platforms', None)\n"
        "told('auto')"
    )
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    ours, theirs = tmp_path / "dynappo" / "jax", tmp_path / "theirs"
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(theirs))
    done = shell("-c", code)
    assert done.stdout == f"cpu {theirs} 0.0\nNone {ours} 0.0\n", done.stderr


@pytest.mark.parametrize("own", [None, "0"])
def test_the_alarms_of_a_slow_compiler_are_off_on_a_cpu(monkeypatch, own):
    """Unless the shell says what XLA may print."""
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    if own:
        monkeypatch.setenv("TF_CPP_MIN_LOG_LEVEL", own)
    code = "import sys; from dynappo.program import devices; assert 'jax' not in sys.modules\n"
    code += "devices.own_process('cpu'); import jax, os; print(os.environ['TF_CPP_MIN_LOG_LEVEL'])"
    done = shell("-c", code)
    assert done.stdout.strip() == (own or "3"), done.stderr


@pytest.mark.parametrize("plugin", [False, True])
def test_they_are_off_where_python_imports_dynappo_and_no_gpu_may_be(monkeypatch, tmp_path, plugin):
    """JAX sets a level of its own when it is imported, and a Playground task's settings import it before
    `own_process`; a plugin's lines are about its GPU."""
    monkeypatch.delenv("TF_CPP_MIN_LOG_LEVEL", raising=False)
    if plugin:
        (tmp_path / "jax_plugins").mkdir()
    code = f"import sys; sys.path.append({str(tmp_path)!r}); import dynappo, jax, os\n"
    done = shell("-c", code + "print(os.environ['TF_CPP_MIN_LOG_LEVEL'])")
    assert done.stdout.strip() == ("1" if plugin else "3"), done.stderr


def test_what_a_shell_sets_for_other_programs_is_off_and_told(monkeypatch):
    """A robot's program cannot be traced with any of these."""
    other = {name: "1" for name in devices.USUAL if isinstance(devices.USUAL[name], bool)}
    other |= {"jax_numpy_dtype_promotion": "strict", "jax_numpy_rank_promotion": "raise"}
    assert other.keys() == devices.USUAL.keys()
    for name, value in other.items():
        monkeypatch.setenv(name.upper(), value)
    code = "from dynappo.program import devices; devices.own_process('cpu'); import jax, json\n"
    code += "print(json.dumps({name: getattr(jax.config, name) for name in devices.USUAL}))"
    done = shell("-c", code)
    assert json.loads(done.stdout) == devices.USUAL
    assert done.stderr.startswith("dynappo: JAX_ENABLE_X64, ") and done.stderr.count("\n") == 1


def test_that_brax_is_not_maintained_is_not_told_to_who_trains():
    """The words are those of brax's source: to load an environment takes ten seconds."""
    package = importlib.util.find_spec("brax").submodule_search_locations[0]
    source = pathlib.Path(package, "io", "mjcf.py").read_text()
    begins = re.search(r"warnings.warn\(\s*'(.*)'", source)[1]
    code = "import warnings; from dynappo.program import devices; devices.own_process('cpu')\n"
    done = shell("-c", code + f"warnings.warn({begins!r}); warnings.warn('another')")
    assert done.stderr == "dynappo: another\n"
