"""The cluster's files, run by bash with stand-ins for srun, scontrol and Python.

The stand-in srun starts as many processes as Slurm would, with the variables of a step; the stand-in
Python writes down what it was asked and exits with a status of our choice. What it was asked goes
through dynappo's own parser.
"""

import json
import os
import pathlib
import re
import shutil
import subprocess
import sys

import pytest
import yaml
from answers import PATIENCE, ROOT

from dynappo.train import command as train_command

CLUSTER = ROOT / "experiments" / "cluster"
SCRIPTS = ("train.sbatch", "array.sbatch")
PYTHON = f"""#!{sys.executable}
import json, os, pathlib, sys
kept = ("SLURM_", "CUDA_VISIBLE", "SKYPILOT_")
env = {{name: value for name, value in os.environ.items() if name.startswith(kept)}}
record = dict(argv=sys.argv[1:], cwd=os.getcwd(), env=env)
path = pathlib.Path(os.environ["RECORDS"]) / (os.environ.get("SLURM_PROCID", "0") + ".json")
path.write_text(json.dumps(record))
sys.exit(int(os.environ["STATUS"]))
"""
SRUN = f"""#!{sys.executable}
import os, subprocess, sys
args = sys.argv[1:]
while args and args[0].startswith("-"):
    assert "=" in args[0], args[0] + ": the stand-in knows --option=value only"
    args.pop(0)
tasks, nodes = int(os.environ["SLURM_NTASKS"]), int(os.environ["SLURM_JOB_NUM_NODES"])
step = dict(SLURM_STEP_ID="0", SLURM_STEP_NUM_TASKS=str(tasks), SLURM_STEP_NUM_NODES=str(nodes))
step["SLURM_STEP_NODELIST"] = "gpu07" if nodes == 1 else "gpu[07-" + format(6 + nodes, "02d") + "]"
started = []
for i in range(tasks):
    own = dict(SLURM_PROCID=str(i), SLURM_LOCALID=str(i % (tasks // nodes)))
    started.append(subprocess.Popen(args, env=os.environ | step | own))
sys.exit(max(process.wait() for process in started))
"""
RESTARTED = {"SLURM_RESTART_COUNT": "20"}
SCONTROL = """#!/bin/sh
echo "$@" >> "$RECORDS/scontrol"
"""


@pytest.fixture
def cluster(tmp_path):
    """`cluster(command, status, **variables)` runs bash: `(exit status, records, calls of scontrol)`."""
    for name, text in (("python", PYTHON), ("srun", SRUN), ("scontrol", SCONTROL)):
        path = tmp_path / "bin" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        path.chmod(0o755)

    def call(command, status=0, cwd=ROOT, **variables):
        records = tmp_path / "records"
        shutil.rmtree(records, ignore_errors=True)
        records.mkdir()
        env = {n: v for n, v in os.environ.items() if not n.startswith(("SLURM", "SKYPILOT"))}
        env |= {"PATH": f"{tmp_path / 'bin'}:{env['PATH']}", "PYTHON": str(tmp_path / "bin/python")}
        env |= {"RECORDS": str(records), "STATUS": str(status)} | variables
        done = subprocess.run(
            ["bash", *command], env=env, cwd=cwd, capture_output=True, text=True, timeout=PATIENCE
        )
        assert not done.stderr, done.stderr
        found = sorted(records.glob("*.json"), key=lambda path: int(path.stem))
        calls = records / "scontrol"
        lines = calls.read_text().splitlines() if calls.exists() else []
        return done.returncode, [json.loads(path.read_text()) for path in found], lines

    return call


def directives(script: str) -> dict[str, str]:
    """What the file asks of Slurm."""
    lines = re.findall(r"^#SBATCH --([\w-]+)(?:=(\S+))?", (CLUSTER / script).read_text(), re.M)
    return dict(lines)


def slurm(script: str, **more) -> dict[str, str]:
    """The variables that Slurm would set in the file's shell, as the directives ask."""
    asked = directives(script)
    nodes, gpus = int(asked.get("nodes", 1)), int(asked["gpus-per-node"])
    tasks = nodes * int(asked.get("ntasks-per-node", 0)) or int(asked["ntasks"])
    return {
        "SLURM_JOB_ID": "4711",
        "SLURM_JOB_NUM_NODES": str(nodes),
        "SLURM_NTASKS": str(tasks),
        "SLURM_GPUS_ON_NODE": str(gpus),
        "SLURM_CPUS_PER_TASK": asked["cpus-per-task"],
        "SLURM_SUBMIT_DIR": str(ROOT),
        "CUDA_VISIBLE_DEVICES": ",".join(map(str, range(gpus))),
    } | more


def parse(record) -> train_command.Command:
    """The command that a stand-in Python was given, by dynappo's own parser."""
    assert record["argv"][:2] == ["-m", "dynappo.train"] and record["cwd"] == str(ROOT)
    return train_command.parse(record["argv"][2:])


# ---- Slurm


@pytest.mark.parametrize("script", SCRIPTS)
def test_a_script_is_clean_and_saves_before_its_time_is_up(script):
    """bash and, where there is one, shellcheck read it; SIGTERM comes two minutes early."""
    checks = [["bash", "-n"]] + [["shellcheck"]] * bool(shutil.which("shellcheck"))
    for check in checks:
        done = subprocess.run([*check, str(CLUSTER / script)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
    asked = directives(script)
    assert asked["signal"] == "TERM@120"  # without B: to the processes, not to this shell
    assert "requeue" in asked and asked["open-mode"] == "append" and "time" in asked


def test_a_run_is_started_on_every_gpu_with_a_seed_each(cluster):
    """Two nodes with four GPUs: eight processes of one run, each with a GPU of its own; flags after
    the file count before those in it."""
    status, records, _ = cluster([str(CLUSTER / "train.sbatch")], **slurm("train.sbatch"))
    assert status == 0 and len(records) == 8
    commands = [parse(record) for record in records]
    assert len({str(command) for command in commands}) == 1
    run = commands[0].config.run
    assert (run.num_seeds, run.mesh_seed, run.mesh_env) == (8, 8, 1)
    for i, record in enumerate(records):
        env = record["env"]
        assert (env["SLURM_PROCID"], env["SLURM_LOCALID"]) == (str(i), str(i % 4))
        assert env["SLURM_STEP_NUM_TASKS"] == "8" and env["CUDA_VISIBLE_DEVICES"] == "0,1,2,3"
    more = "--config=configs/anymal_c.py --workdir=runs/c --config.run.num_seeds=4"
    more += " --config.run.mesh_seed=4 --config.run.mesh_env=2"
    command = [str(CLUSTER / "train.sbatch"), *more.split()]
    _, records, _ = cluster(command, **slurm("train.sbatch"))
    found = parse(records[3])
    assert found.config.robot == "anymal_c" and found.workdir == pathlib.Path("runs/c")
    run = found.config.run
    assert (run.num_seeds, run.mesh_seed, run.mesh_env) == (4, 4, 2)


@pytest.mark.parametrize("script", SCRIPTS)
@pytest.mark.parametrize("status", [0, 2, 143])
def test_only_a_run_that_was_stopped_is_requeued(cluster, script, status):
    """143 is SIGTERM; a finished run and a wrong setting stay as they are."""
    variables = slurm(script, SLURM_ARRAY_TASK_ID="3", SLURM_RESTART_COUNT="2")
    code, records, calls = cluster([str(CLUSTER / script)], status, **variables)
    assert code == status and records
    assert calls == (["requeue 4711"] if status == 143 else [])
    if status == 143:  # the job again is the same command; one that never gets on stops in the end
        code, again, calls = cluster([str(CLUSTER / script)], 143, **variables | RESTARTED)
        assert [r["argv"] for r in again] == [r["argv"] for r in records]
        assert code == 143 and not calls


def test_the_array_trains_every_config_with_every_seed_once(cluster):
    """As many elements as there are pairs; each is a run of its own, in a folder of its own."""
    first, last = re.fullmatch(r"(\d+)-(\d+)%\d+", directives("array.sbatch")["array"]).groups()
    pairs, folders = set(), set()
    for index in range(int(first), int(last) + 1):
        variables = slurm("array.sbatch", SLURM_ARRAY_TASK_ID=str(index))
        command = [str(CLUSTER / "array.sbatch"), "--config.run.num_iterations=30"]
        status, (record,), _ = cluster(command, **variables)
        assert status == 0 and record["env"]["SLURM_STEP_NUM_TASKS"] == "1"
        found = parse(record)
        assert found.config.run.num_iterations == 30 and found.config.run.num_seeds == 1
        pairs.add((record["argv"][2], found.config.run.seed))
        folders.add(found.workdir)
    assert len(pairs) == len(folders) == int(last) + 1 == 15
    assert {seed for _, seed in pairs} == set(range(5))
    assert pathlib.Path("runs/array/go1-ppo16-0") in folders
    beyond = slurm("array.sbatch", SLURM_ARRAY_TASK_ID="15")
    with pytest.raises(AssertionError, match="unbound"):
        cluster([str(CLUSTER / "array.sbatch")], **beyond)


# ---- SkyPilot, and processes by hand


@pytest.mark.parametrize("nodes", [1, 2])
def test_skypilots_machines_are_the_processes_of_one_run(cluster, tmp_path, nodes):
    """Every machine runs the same text; each sees its rank, and all the address of the first. The
    workdir is in a bucket that files can be appended to."""
    task = yaml.safe_load((CLUSTER / "sky.yaml").read_text())
    ((folder, bucket),) = task["file_mounts"].items()
    assert bucket == {"name": "${BUCKET}", "mode": "MOUNT_CACHED"} and "BUCKET" in task["envs"]
    here = tmp_path / "workdir"
    (here / ".venv" / "bin").mkdir(parents=True)
    shutil.copy(tmp_path / "bin" / "python", here / ".venv" / "bin")
    for rank in range(nodes):
        variables = task["envs"] | {
            "SKYPILOT_NUM_NODES": str(nodes),
            "SKYPILOT_NODE_RANK": str(rank),
            "SKYPILOT_NUM_GPUS_PER_NODE": "8",
            "SKYPILOT_NODE_IPS": "\n".join(["10.0.0.4", "10.0.0.7"][:nodes]),
        }
        status, (record,), _ = cluster(["-c", task["run"]], cwd=here, **variables)
        assert status == 0 and record["argv"][:2] == ["-m", "dynappo.train"]
        found = train_command.parse(record["argv"][2:])
        run = found.config.run
        assert found.processes == ("10.0.0.4:9876", nodes, rank)
        assert found.workdir == pathlib.Path(folder) / "go1" and run.checkpoint_every == 50
        assert run.num_seeds == run.mesh_seed == 8 * nodes


def test_the_commands_of_the_readme_are_understood():
    """Those for Slurm with the flags of the file before them, and the one without Slurm."""
    text = (CLUSTER / "README.md").read_text().replace("\\\n", " ")
    batches = re.findall(r"^ +sbatch experiments/cluster/train\.sbatch (.*)$", text, re.M)
    assert len(batches) == 2
    for line in batches:
        argv = ["--config=configs/go1.py", "--config.run.num_seeds=8", *line.split()]
        assert train_command.parse(argv).config.run.num_seeds in (4, 8)
    (line,) = re.findall(r"^ +python -m dynappo\.train (.*)$", text, re.M)
    found = train_command.parse(line.split())
    assert found.config.run.mesh_seed == 8 and found.processes == ("node1:9876", 2, 0)
