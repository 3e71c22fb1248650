"""`--restore=SOURCE`: start a run from the networks of another one, whose folder stays unchanged."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import config as config_lib
from dynappo import schedule
from dynappo.config import ConfigError, files, shell
from dynappo.policy import checkpoint_file, checks, policy_file, policy_source
from dynappo.program import distributed
from dynappo.run import workdir as workdir_lib

# fields without which a policy's observations and actions mean something else, though their numbers fit
MEANING = (
    "robot env task.action_scale task.kp task.kd task.actuator "
    "task.gait_frequency physics.timestep physics.substeps ppo.critic ppo.scale_inputs"
).split()


def start_from(
    folder: Path, config, state: Any, workdir: Path, say: Callable[[str], None] = print
) -> Any:
    """The first state of a run of `config`, with the networks of another run (`weights`); not yet placed on
    devices.

    `workdir/restored_from` then also names the checkpoint; it is removed where they do not fit.
    """

    def read(like):
        try:
            return weights(folder, config, like, say)
        except ConfigError:
            if not workdir_lib.begun(
                workdir
            ):  # else the command without --restore would try them again
                (workdir / "restored_from").unlink(missing_ok=True)
            raise

    taken, state = distributed.from_first(read, state)
    if distributed.first():
        say(f"starts from {folder}, {taken}")
        files.write_text(workdir / "restored_from", f"{folder.resolve()}\n{taken}\n")
    return state


def source(workdir: Path, given: Path | None) -> Path | None:
    """The run whose networks this one starts from; None if it starts with untrained ones, or resumes.

    `given` is `--restore`; `workdir/restored_from` remembers it. ConfigError if the run in `workdir` began
    from something else.
    """

    def remembered():
        path = workdir / "restored_from"
        there = path.read_bytes().decode(errors="replace") if path.exists() else ""
        there = there.strip().partition("\n")[0]
        here = str(given.resolve()) if given else there
        if workdir_lib.begun(workdir) and here != there:
            raise ConfigError(
                f"--restore={given}: the run in {workdir} began from {there or 'untrained networks'}; leave "
                "--restore out to go on with it, or --fresh to start over"
            )
        if given and not workdir_lib.begun(workdir):
            files.write_text(path, f"{here}\n")
        return "" if workdir_lib.saved(workdir) else here

    found = distributed.on_first(remembered)
    return Path(found) if found else None


def weights(source: Path, config, like: Any, say: Callable[[str], None] = print) -> tuple[str, Any]:
    """`(what was read, the state like, of a run of config, with the networks of another run)`.

    `source` is a workdir, of which the newest good checkpoint is read, a checkpoint's folder, or a
    policy.npz; nothing is changed there. The policy, the value function and, if both runs have one, the
    transition model with its moments are taken; optimisers, learning rate and robots start anew. A policy.npz
    may lack the value function, and serves every seed. A model that is to treat left and right alike
    (`model.symmetry`) is taken only from a run whose model did. `say` reports what was passed over or is
    missing. ConfigError if nothing can be read, or a network has another shape.
    """
    there, name = _read(source, say)
    alone = not any(name.startswith("learner/params/critic") for name in there)
    params = like.learner.params
    if alone:
        first = config.ppo.value_first
        then = f"learns for {first} iterations (ppo.value_first) before the policy does"
        then = then if first else "the policy learns with it at once: ppo.value_first is 0"
        say(
            f"{named(source)} holds a policy alone: its value function starts untrained, and {then}"
        )
    some = {name: part for name, part in params.items() if not (alone and name == "critic")}
    found = _taken(source, some, there, "policy", "learner/params")
    learner = like.learner.replace(params=params | found)
    model = like.model
    if model is None or not any(name.startswith("model/") for name in there):
        pass
    elif config.model.symmetry and not about(source)[0].get("model.symmetry"):
        say(
            f"{named(source)}: model.symmetry is False there, True here, so its transition model is not "
            "its own mirror image; it starts untrained"
        )
    else:
        parts = {
            name: _taken(source, getattr(model, name), there, f"model.{name}", f"model/{name}")
            for name in ("params", "inputs", "targets")
        }
        model = model.replace(**parts)
    return name, like.replace(learner=learner, model=model)


def _read(source: Path, say) -> tuple[dict[str, np.ndarray], str]:
    """The arrays of a policy.npz or a checkpoint, named as in a checkpoint, and the name of their source."""
    if source.is_file():
        leaves = checks.leaves(policy_file.load(source).params)
        return {f"learner/params/{k}": v for k, v in leaves}, "policy.npz"
    if (source / checkpoint_file.STATE).is_dir():
        return checkpoint_file.read(source), f"checkpoint {source.name}"
    problems = []
    for step in saved(source):
        try:
            there = checkpoint_file.read(source / "checkpoints" / str(step))
        except ConfigError as error:
            problems.append(str(error))
            continue
        for problem in problems:
            say(f"{problem}; checkpoint {step} is taken")
        return there, f"checkpoint {step}"
    raise ConfigError(
        f"{named(source)}: none of its {len(problems)} checkpoints can be read ({problems[0]}); "
        "expected a run with a good one"
    )


def check(source: Path, config) -> None:
    """ConfigError if the config in `source` has other network sizes than `config`, or another observation.

    To be called before anything is compiled, written or moved; `weights` checks the arrays themselves.
    """
    here, (there, robot) = config_lib.flat(config), about(source)
    if misfit := _of_another_body(there, robot, config):  # first: setting sizes would not help
        raise ConfigError(f"{named(source)}: {misfit}")
    names = ["ppo.hidden", "ppo.activation"]
    clock = "task.gait_frequency"  # with one, a policy also sees its phase
    if config.robot and clock in there and (there[clock] is None) != (here[clock] is None):
        names = [clock, *names]
    if config.robot:  # each of these makes an observation longer or shorter
        names = ["task.scan", "task.observation", "task.history", *names]
        there = {"task.scan": "none"} | there  # older runs have no such field
    if source.is_file() and config.ppo.normalize:
        raise ConfigError(
            f"{named(source)}: in a policy.npz the scaling of ppo.normalize is part of the weights; name "
            "the workdir of that run, or a checkpoint"
        )
    if not source.is_file():
        names += ["run.num_seeds", "ppo.critic_hidden", "ppo.normalize"]
        if schedule.uses_model(config) and there.get("schedule.end_steps"):
            names += ["model.hidden", "model.activation", "model.falls"]
    if config.ppo.symmetry and not there.get("ppo.symmetry", True):
        raise ConfigError(  # symmetric gradients keep what is not symmetric (learner/symmetry.py)
            f"{named(source)}: ppo.symmetry is False there, True here, and its policy is not its own "
            "mirror image; set --config.ppo.symmetry=False"
        )
    apart = [
        name
        for name in names
        if np.ravel(there.get(name, here[name])).tolist() != np.ravel(here[name]).tolist()
    ]
    if apart:
        name = apart[0]
        raise ConfigError(
            f"{named(source)}: {name} is {there[name]} there, {here[name]} here; set what that run has: "
            + " ".join(_flag(name, there[name]) for name in apart)
        )


def _of_another_body(there: dict[str, Any], robot, config) -> str:
    """Why a policy of the config `there`, for `robot`, cannot act or see as one of `config`, whatever the
    sizes of its networks; "" if it can."""
    own = policy_source.of_name(config.robot)
    if not robot or not own:
        return ""
    names, ours = robot.joint_names, own.joint_names
    if len(names) != len(ours):
        before = there.get("robot") or "its robot"
        return (
            f"{before} has {len(names)} joints, {config.robot} {len(ours)}, and a policy moves as many as it "
            f"was trained with; name a policy of {config.robot}"
        )
    if names != ours and sorted(names) == sorted(ours):
        return (
            f"its joints are {' '.join(names)}, expected the order of {config.robot}, {' '.join(ours)}; "
            "dynappo export with --joint-order=mjcf writes a policy.npz in this one"
        )
    if there.get("task.scan", "none") != "none" and config.task.terrain == "flat":
        return (
            "its policy sees a scan of rough ground, task.terrain is flat here; try "
            f"--config={config.robot}:rough"
        )
    sees, seen = (
        policy_file.own_sizes(x.get("task.terms_about", ""))
        for x in (there, config_lib.flat(config))
    )
    if [*sees.values()] != [*seen.values()]:
        file = there.get("task.terms", "")
        then = f"name them: --terms={file}" if sees and file else "leave --terms out"
        return (
            f"its policy sees {_told(sees)} of terms of one's own, here {_told(seen)}; {then}, or start "
            "without --restore"
        )
    return ""


def _told(sizes: dict[str, int | None]) -> str:
    return ", ".join(f"{name} [{size or 'joints'}]" for name, size in sizes.items()) or "nothing"


def named(source: Path) -> str:
    """The flag: a bundled policy by its name, however it was given, else the path."""
    for name in files.bundled():
        with contextlib.suppress(ConfigError):  # a robot without a policy
            if policy_file.bundled(name) == source:
                return f"--restore={name}"
    return f"--restore={source}"


def _flag(name: str, value: Any) -> str:
    """The flag that sets a field, for the shell; JSON has lists for tuples."""
    text = str(tuple(value) if isinstance(value, list) else value).replace(" ", "")
    return shell.quoted(f"--config.{name}={text}")


def about(source: Path) -> tuple[dict[str, Any], Any]:
    """`(config by dotted names, robot)` of what a run starts from; of the robot, None where it is not known,
    only `joint_names` and `default_pose` are to be read."""
    if source.is_file():
        try:
            policy = policy_file.load(source)
        except ConfigError as error:  # its text begins with the path
            raise ConfigError(f"--restore={error}") from None
        return config_lib.flat(policy.config), policy
    one = (source / checkpoint_file.STATE).is_dir()
    for folder in [source] if one else [source / "checkpoints" / str(s) for s in saved(source)]:
        with contextlib.suppress(checkpoint_file.Damaged, KeyError, TypeError, AttributeError):
            found = checkpoint_file.about(folder)
            config = config_lib.flat(found["config"])
            return config, policy_source.carried(found, config["robot"], folder)
    return {}, None


def apart(source: Path, config) -> str:
    """A line on what the numbers of the networks in `source` mean there and not here; "" if nothing does."""
    (there, robot), own = about(source), policy_source.of_name(config.robot)
    here = config_lib.flat(config)
    found = [
        f"{name} is {there[name]} there, {here[name]} here"
        for name in MEANING
        if name in there and np.ravel(there[name]).tolist() != np.ravel(here[name]).tolist()
    ]
    if robot and own and robot.joint_names != own.joint_names:
        found.append("its joints have other names")
    elif robot and own and not np.allclose(robot.default_pose, own.default_pose, atol=1e-6):
        found.append("its default pose is another")
    return f"{named(source)}: {'; '.join(found)}" if found else ""


def saved(folder: Path) -> list[int]:
    """Iterations of the checkpoints of another run, newest first; ConfigError if there is none."""
    if not (folder / "checkpoints").is_dir():
        if (folder / "sweep.json").is_file():
            runs = sorted(path.parent for path in folder.glob("*/checkpoints"))
            such = f", such as {runs[0]}" if runs else ""
            best = folder / "policy.npz"
            raise ConfigError(
                f"--restore={folder}: a sweep; name one of its runs{such}"
                + f", or its best policy, {best}" * best.is_file()
            )
        lacks = "no checkpoints/ there" if folder.exists() else "no such file or folder"
        name = str(folder)
        if name in files.bundled():  # a Path has lost the ./ that told it from the bundled one
            raise ConfigError(
                f"--restore=./{name}: {lacks}; expected a workdir or a checkpoint; --restore={name}, without "
                "./, is the bundled policy"
            )
        raise ConfigError(f"--restore={folder}: {lacks}; {policy_source.expected(name)}")
    found = checkpoint_file.iterations(folder / "checkpoints")
    if not found:
        raise ConfigError(
            f"--restore={folder}: it holds no checkpoint yet; expected a run that has saved one"
        )
    return found


def _taken(folder, like, there, what, prefix):
    """The arrays of `there` under `prefix`, in the structure of `like`."""
    # here: it imports Orbax for half a second, which most starts need not wait for
    from dynappo.run import checkpoint

    out = []
    for name, leaf in checkpoint.paths(like).items():
        array = there.get(f"{prefix}/{name}")
        if array is not None and folder.is_file() and array.shape == leaf.shape[1:]:
            array = np.broadcast_to(array, leaf.shape)  # one policy for all seeds
        if array is None or array.shape != leaf.shape:
            found = "absent" if array is None else f"of shape {array.shape}"
            raise ConfigError(
                f"--restore={folder}: {what} {name} is {found} there, of shape {leaf.shape} here; "
                "set the sizes and run.num_seeds of that run (its config.json has them)"
            )
        out.append(jnp.asarray(array, leaf.dtype))
    return jax.tree.unflatten(jax.tree.structure(like), out)
