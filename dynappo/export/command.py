"""A policy as one file for a robot: `dynappo export NAME_OR_DIR --out=policy.onnx`.

`--out=FILE.npz` writes the project's own policy file instead. `--joint-order` gives the network another
order of the joints: it permutes rows and columns of the first and last weights, so the robot need not
reorder anything. Next: robots/DEPLOY.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from dynappo.config import ConfigError, files, shell
from dynappo.config import flags as flags_lib
from dynappo.description.robot import Robot
from dynappo.export import deploy_yaml, joint_order, onnx_file, task_onnx
from dynappo.policy import policy_source
from dynappo.policy.policy_file import Other, Policy

FILES = (".onnx", ".npz", ".xml", ".yaml")
USAGE = """\
NAME_OR_DIR is a workdir, a checkpoint folder, a policy.npz, or the name of a robot with a bundled policy
  python -m dynappo.export runs/go1 --out=policy.onnx
  python -m dynappo.export go2 --out=policy.onnx --joint-order=unitree --targets
  python -m dynappo.export go2_deploy --out=deploy.yaml --joint-order=isaaclab
  python -m dynappo.export anymal_c --out=policy.npz --joint-order=isaaclab
  python -m dynappo.export runs/seeds --run-seed=3 --out=third.npz
  python -m dynappo.export old.npz --robot-xml=mine.xml --out=policy.npz
a policy.npz carries its robot's MJCF, so you can play it anywhere
joint orders (of the observation, the action and everything in the metadata)
  mjcf      as in robots/NAME/NAME.xml: leg by leg (what training uses)
  isaaclab  as Isaac Sim numbers them: all hips, all thighs, all calves; limbs by name
  unitree   the motor numbers of Go1 and Go2: FR FL RR RL, leg by leg
  or the names of all joints, comma-separated
how to use the file on a robot: robots/DEPLOY.md
"""


def parse(argv: list[str] | None) -> argparse.Namespace:
    """The flags of a command line; ConfigError if it cannot be understood."""
    parser = flags_lib.parser(
        "export", "Write a policy for a robot: an ONNX network, or a policy.npz.", USAGE
    )
    flag = parser.add_argument
    policy_source.add_flags(parser)
    names = "FILE.onnx, FILE.npz, FILE.yaml (for unitree_rl_lab) or FILE.xml (only the robot)"
    flag("--out", metavar="FILE", type=flags_lib.path, help=names)
    flag(
        "--joint-order",
        metavar="ORDER",
        help=f"{', '.join(joint_order.ORDERS)} or all names, see below",
    )
    flag("--targets", action="store_true", help="add a second output: joint position targets, rad")
    flags = flags_lib.read(parser, argv)
    if not flags.what:
        raise ConfigError(
            "nothing to export; name a workdir, as in: "
            "python -m dynappo.export runs/laptop --out=policy.onnx"
        )
    if flags.out is None:
        raise ConfigError("--out is missing; try --out=policy.onnx")
    if flags.out.suffix not in FILES:
        raise ConfigError(f"--out={flags.out}: expected a file named {', '.join(FILES)}")
    if flags.joint_order and flags.out.suffix == ".xml":
        raise ConfigError(f"--joint-order: not for {flags.out}; an MJCF keeps its joint order")
    policy_source.check_flags(flags)
    if flags.targets and flags.out.suffix != ".onnx":
        raise ConfigError(f"--targets: only an .onnx has outputs, not {flags.out}")
    return flags


def check_out(flags, path: Path) -> None:
    """ConfigError if nothing can be written at `--out`, or it is read; leaves no file behind."""
    read = {"the policy": path, "--robot-xml": flags.robot_xml, "--terms": flags.terms}
    flags_lib.check_kept(flags.out, read)
    flags_lib.check_writable(flags.out)


def table(policy: Policy, out: Path, order: str, targets: bool) -> list[tuple[str, str]]:
    """What was written and how to use it, as (name, text) for printing."""
    kind = f"ONNX, float32, opset {onnx_file.OPSET}" if out.suffix == ".onnx" else "policy file"
    rows = [("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB, {kind})")]
    if out.suffix == ".onnx":
        size, count = len(onnx_file.order(policy)), len(policy.joint_names)
        code = (
            "import numpy as np, onnxruntime as ort; print(ort.InferenceSession("
            f"{str(out)!r}).run(None, {{'obs': np.zeros((1, {size}), np.float32)}}))"
        )
        rows += [
            (
                "input",
                f"obs [batch, {size}]; its table is in the metadata, a Go1's in robots/DEPLOY.md",
            ),
            (
                "output",
                f"action [batch, {count}]" + f", targets [batch, {count}] (rad)" * targets,
            ),
        ]
        after = f'python -c "{code}"'
    else:
        after = shell.line("play", out, "--out=walk.html")
    joints = f"{' '.join(policy.joint_names)} ({order})"
    if out.suffix in (".xml", ".yaml"):
        kind = (
            "MJCF"
            if out.suffix == ".xml"
            else "for unitree_rl_lab, beside an ONNX in the same order"
        )
        rows = [("written", f"{out} ({out.stat().st_size / 1024:.0f} KiB, {kind})")]
        return [*rows, ("joints", joints)]
    return [
        *rows,
        ("joints", joints),
        ("try", after),
        ("on a robot", shell.pasted("robots/DEPLOY.md")),
    ]


def run(flags) -> None:
    """Export as the flags say, and print what was written."""
    theirs = policy_source.other(flags)
    if theirs is not None:
        return of_task(*theirs, flags)
    policy, path, named = policy_source.of_flags(flags)
    check_out(flags, path)
    robot, note = policy_source.robot(policy, flags.robot_xml)
    if set(robot.joint_names) != set(policy.joint_names):
        raise ConfigError(
            f"{path}: its joints are {', '.join(policy.joint_names)}, "
            f"those of {robot.xml} are {', '.join(robot.joint_names)}"
        )
    names, order = joint_order.parse(flags.joint_order, policy.joint_names, robot)
    carried = policy.mjcf
    policy = joint_order.permute(policy, names)._replace(mjcf=robot.alone)
    if flags.out.suffix == ".xml":
        save_robot(robot, flags.out)
    elif flags.out.suffix == ".yaml":
        files.write_text(flags.out, deploy_yaml.text(policy, robot))
    else:
        onnx_file.save(policy, robot, flags.out, flags.targets)
    print(shell.pasted(f"dynappo exports {policy.robot}: {named}"))
    if flags.robot_xml and not same_pose(policy, robot):
        note = f"note: the default pose of {robot.xml} is another; the policy keeps its own"
    if flags.robot_xml and flags.out.suffix == ".npz" and carried != robot.alone:
        text = (
            f"the robot in {flags.out} is now that of {robot.xml}, no longer that of its training"
        )
        note = "\n".join(filter(None, [f"note: {text}", note]))
    if note:
        print(note)
    for name, text in table(policy, flags.out, order, flags.targets):
        print(f"{name:10s}  {text}")


def same_pose(policy: Policy, robot: Robot) -> bool:
    """Whether the robot's default pose is the policy's, whatever the order of their joints."""
    own = dict(zip(robot.joint_names, robot.default_pose.tolist(), strict=True))
    there = zip(policy.joint_names, policy.default_pose.tolist(), strict=True)
    return all(abs(own[name] - angle) < 1e-6 for name, angle in there)


def of_task(policy: Other, path: Path, named: str, flags) -> None:
    """`run` for a policy of another package's environment."""
    task_onnx.check(policy, path, flags)
    check_out(flags, path)
    told = (
        "asks the environment for its joints and times, a minute or two where the machine is slow"
    )
    print(f"dynappo exports {policy.config.env}: {named}; {told}", flush=True)
    facts = task_onnx.save(policy, path, flags.out)
    for name, text in task_onnx.table(facts, policy, flags.out):
        print(f"{name:10s}  {text}")


def save_robot(robot: Robot, out: Path) -> None:
    """Write the MJCF of a robot as one file; ConfigError if it needs others."""
    if not robot.alone:
        raise ConfigError(f"--out={out}: {robot.xml} needs other files; copy it with these")
    files.write_text(out, robot.alone)


def main(argv: list[str] | None = None) -> None:
    """The command; its exit statuses are those of `flags.answer`."""
    flags_lib.answer(lambda: run(parse(argv)))
