"""Reads the combinations of a sweep from a command line, and says which of them train in one program."""

from __future__ import annotations

import copy
import itertools
import json
import math
import re
from typing import Any, NamedTuple

from dynappo import config as config_lib
from dynappo.config import ConfigError, fields

MOST, LONGEST = 1000, 200  # combinations; characters of a folder's name
# floats that are built into the program, or say what is (which bodies differ: physics.randomize)
BUILT_IN = (
    "run.",
    "physics.",
    "task.randomize.",
    "task.tiles.",
    "task.armature",
    "task.joint_friction",
)
NOT_HERE = {  # what one process or one folder has once, and seeds, over which every combination is averaged
    "run.device": "a process has one; give a command for each",
    "run.seed": "for seeds use --config.run.num_seeds=2",
    "run.num_seeds": "for seeds use --config.run.num_seeds=2",
    "run.wandb": "a sweep does not log to Weights & Biases",
}
# of the group `task`: what leaves an evaluation's rewards, commands, episodes and ground as they are, and
# what changes its rewards alone. Every other field of `task` and `physics` changes what is asked
SAME_TASK = (
    "noise. push. randomize. random_clock carry_on start_anew keep_command observation history scan "
    "ground_in_tail actuator action_scale kp kd effort_limit saturation_effort velocity_limit "
    "clearance_ramp clearance_start"
).split()
REWARD = (
    "weights. tracking_std air_time fall_reward posture_std posture_std_standing gait_foot_height "
    "clearance_height feet_apart"
).split()
BY_RETURN, BY_ERRORS, BY_CROSSED = "return", "falls, then tracking error", "tiles crossed"


class Combination(NamedTuple):
    """One combination of values, and the run it means."""

    name: str  # of its folder: "ppo.entropy_coef=0.003,ppo.epochs=3"
    values: dict[str, Any]  # by field
    config: Any  # validated
    env: Any = None  # of one's own, instead of the robot's


def read(texts: list[str]) -> dict[str, list[str]]:
    """The values of each field, as text: of ["ppo.epochs=3,5"] {"ppo.epochs": ["3", "5"]}.

    Commas inside of brackets or quotes part no values: `ppo.hidden=(64,64),(128,128)` has two.
    """
    swept: dict[str, list[str]] = {}
    for text in texts:
        field, equals, values = text.partition("=")
        field = field.removeprefix("config.")
        if not equals:
            raise ConfigError(f"--sweep={text}: expected FIELD=VALUE,VALUE,...")
        if field in swept:
            raise ConfigError(f"--sweep={text}: {field} is swept twice; name all values in one")
        if field in NOT_HERE:
            raise ConfigError(f"--sweep={text}: {field} cannot be swept: {NOT_HERE[field]}")
        swept[field] = _parts(values)
        if "" in swept[field]:
            raise ConfigError(f"--sweep={text}: a value is empty, expected FIELD=VALUE,VALUE,...")
    return swept


def _parts(text: str) -> list[str]:
    """`text` split at its commas, but for those inside brackets or quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        depth += 0 if quote else (letter in "([{") - (letter in ")]}")
        if letter == "," and depth == 0 and not quote:
            parts.append("")
        else:
            parts[-1] += letter
    return [part.strip() for part in parts]


def combinations(config, swept: dict[str, list[str]]) -> list[Combination]:
    """Every combination of the values, the last field's change fastest; ConfigError for the first that is
    wrong.

    `config` is not validated; each combination's is, as if its values were `--config.FIELD=VALUE`.
    """
    count = math.prod(len(values) for values in swept.values())
    if count > MOST:
        raise ConfigError(f"--sweep: {count:,} combinations, expected at most {MOST:,}")
    found: dict[str, Combination] = {}
    for texts in itertools.product(*swept.values()):
        own = copy.deepcopy(config)
        for field, text in zip(swept, texts, strict=True):
            try:
                config_lib.override(own, field, text)
            except ConfigError as error:
                raise ConfigError(str(error).replace("--config.", "--sweep=", 1)) from None
        values = {field: config_lib.flat(own)[field] for field in swept}
        name = ",".join(f"{field}={_short(value)}" for field, value in values.items())
        if name in found:
            raise ConfigError(f"--sweep: {name} appears twice; name each value once")
        if len(name) > LONGEST:
            raise ConfigError(
                f"--sweep: the folder of a combination would have a name of {len(name)} characters, "
                f"expected at most {LONGEST}; sweep fewer fields at once"
            )
        try:
            found[name] = Combination(name, values, config_lib.validate(own))
        except ConfigError as error:
            raise ConfigError(f"--sweep: {error} (the combination {name})") from None
    return list(found.values())


def _short(value: Any) -> str:
    """A value as a part of a folder's name that needs no quotes in a shell: (64, 64) is 64x64, a pattern of
    joints and its number ._calf_joint-35.0."""
    if isinstance(value, tuple):
        value = "x".join("-".join(map(str, x)) if isinstance(x, tuple) else str(x) for x in value)
    return re.sub(r"[^\w.+-]", "_", str(value))


def by_vmap(field: str, own_env: bool = False) -> bool:
    """Whether values of a field can differ between the seeds of one program: floats, alone or in a tuple.

    With an environment of one's own only those of `ppo` and `model`: `get_env` may build others into the
    program.
    """
    kind = fields.field(field)
    assert kind is not None
    number = kind.like[0] if kind.kind is tuple else kind.kind()
    return (
        isinstance(number, float)
        and not field.startswith(BUILT_IN)
        and (not own_env or field.startswith(("ppo.", "model.")))
    )


def ranked_by(combinations: list[Combination]) -> str:
    """By which measure the combinations of a sweep can be ranked: one that does not depend on what is swept.

    `BY_RETURN`; `BY_ERRORS` where their rewards differ; on rough ground `BY_CROSSED` in place of both, as in
    a run (run/worth.py); "" where what is asked of them differs, or may, as in an environment of one's own.
    """
    first = combinations[0]
    config = first.config
    crosses = first.env is None and config.task.terrain == "rough" and config.run.eval_envs
    by = BY_CROSSED if crosses else BY_RETURN
    for field in first.values:
        group, _, name = field.partition(".")
        if field in ("robot", "env", "run.eval_steps"):
            return ""
        if group not in ("task", "physics") or field in ("physics.impl", "physics.threads"):
            continue
        evaluated = first.env is None and config.run.eval_envs
        within = name.partition(".")[0] + "." * ("." in name)
        alike, paid = within in SAME_TASK, within in REWARD
        if group == "physics" or not evaluated or not (alike or paid):
            return ""
        by = BY_ERRORS if paid and not crosses else by
    return by


def groups(combinations: list[Combination], done: list[int]) -> list[list[Combination]]:
    """The combinations in groups that can train in one program, in the order of their first members.

    They differ in floats alone (`by_vmap`), and have `done` as many iterations: `run.merged`. A field that
    has several numbers for the joints is part of the program, and so is one that is None.
    """
    of_joints = {name for name, field in fields.every().items() if field.per_joint}
    found: dict[str, list[Combination]] = {}
    for one, iterations in zip(combinations, done, strict=True):
        own = one.env is not None
        known = config_lib.flat(one.config)
        static = {
            name: value
            for name, value in known.items()
            if not by_vmap(name, own)
            or value is None
            or (name in of_joints and isinstance(value, tuple))
        }
        found.setdefault(json.dumps([iterations, static]), []).append(one)
    return list(found.values())
