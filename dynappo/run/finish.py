"""What a run writes at its end: policy, summary.json, curves and film."""

from __future__ import annotations

import errno
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dynappo.config import ConfigError, files, versions
from dynappo.policy import policy_file
from dynappo.program import distributed
from dynappo.run import blowups, learning_curves, log
from dynappo.run import workdir as workdir_lib
from dynappo.run.workdir import OpenRun

ROOM = (errno.ENOSPC, errno.EDQUOT)


def finish(
    run: OpenRun,
    program,
    state,
    evaluation: dict,
    say: Callable[[str], None] = print,
    evaluation_seconds: float | None = None,
) -> dict[str, Any]:
    """Write policy.npz, summary.json, curves and film of a run, and log them; returns the summary.

    `evaluation` is that of its last policy, {} where there is none; it took `evaluation_seconds`. Of several
    processes the first does this.
    """
    from dynappo.policy import render

    whole = distributed.whole(state.learner.params)
    if not distributed.first():  # the others have no history to sum up
        return {}
    config, workdir, metrics = run.config, run.workdir, run.metrics()
    summary = summarise(config, program, metrics, evaluation)
    evaluated = evaluation or log.last_evaluation(metrics)
    params = policy_file.scaled(workdir_lib.best_params(config, whole, evaluated))
    seed = workdir_lib.best_seed(config, evaluated)
    far = summary["iterations"], summary["sim_steps"]
    policy_file.save(workdir / "policy.npz", params, config, program.robot, seed, *far)
    seeds = f" x {config.run.num_seeds} seeds" if config.run.num_seeds > 1 else ""
    robots = f"{config.robot}: {config.rollout.num_envs} robots"
    copies = f"{config.env or workdir.resolve().name}: {config.rollout.num_envs} copies"
    title = (robots if config.robot else copies) + seeds
    problem = learning_curves.draw(metrics, workdir / "curves.png", title)
    summary["curves"] = problem or str(workdir / "curves.png")
    if evaluation_seconds is not None:  # of all runs of a program at once
        summary["evaluation_seconds"] = evaluation_seconds
    if len(run.origins) > 1:  # else all of it is in the summary itself
        summary["origins"] = list(run.origins)
    if (workdir / "restored_from").exists():
        text = (workdir / "restored_from").read_bytes().decode(errors="replace")
        summary["restored_from"] = ", ".join(text.split("\n")).strip(", ")
    files.write_json(workdir / "summary.json", summary)  # a film may take longer than all of this
    film, began = workdir / "video.mp4", time.perf_counter()
    if seconds := config.run.video_seconds:
        try:
            if config.robot:
                act = policy_file.actor(params, config.ppo.activation)
                task = config.task
                tour = render.tour(seconds, (task.command_x, task.command_y, task.command_yaw))
                episode = render.simulate(program.robot, config, act, tour, seconds)
                problem = render.film(program.robot, episode, film)
            else:
                problem = _film_of_task(config, workdir)
        except (FloatingPointError, ConfigError) as error:  # the run itself has ended well
            problem, summary["playable"] = f"no video: {error}", False
        except OSError as error:  # a full disk
            problem = f"no video: {error}"
        summary["video"] = problem or str(film)
        summary["video_seconds"] = time.perf_counter() - began
        files.write_json(workdir / "summary.json", summary)
    if film.exists() and summary.get("video") != str(film):
        say(f"{film} is of an earlier end of this run")
    shown = config, workdir, summary
    if config.run.tensorboard:
        log.attempt(
            "TensorBoard's events", partial(to_tensorboard, *shown), say, "all else is there"
        )
    if config.run.wandb:
        log.attempt("Weights & Biases", partial(to_wandb, *shown), say, "all else is there")
    return summary


def _film_of_task(config, workdir: Path) -> str:
    """The film of an episode of another package's environment; "", or why there is none. Errors as of
    `render.simulate`."""
    from dynappo.policy import render, task_player

    policy = policy_file.load_other(workdir / "policy.npz")
    assert policy is not None
    with task_player.playing(config.env) as player:
        act = task_player.actor(player, policy)
        episode = task_player.episode(player, act, config.run.video_seconds)
    with task_player.shown(player) as shown:
        return render.film(shown, episode, workdir / "video.mp4")


def final(summary: dict[str, Any]) -> dict[str, float]:
    """The numbers of the last evaluation by their names in the logs: `final/return`, `.../seed0`, ..."""
    numbers = {}
    for name, value in summary.get("evaluation", {}).items():
        seeds = isinstance(value, list)
        for seed, number in enumerate(value if seeds else [value]):
            if number is not None:
                numbers[f"final/{name}" + (f"/seed{seed}" if seeds else "")] = number
    return numbers


def to_tensorboard(config, workdir: Path, summary: dict[str, Any]) -> None:
    """The last evaluation, and the curves as a picture, in a file of their own beside the other events."""
    from tensorboardX.event_file_writer import EventsWriter
    from tensorboardX.proto.event_pb2 import Event
    from tensorboardX.proto.summary_pb2 import Summary

    values = [Summary.Value(tag=tag, simple_value=x) for tag, x in final(summary).items()]
    if summary["curves"] == str(workdir / "curves.png"):
        png = (workdir / "curves.png").read_bytes()
        width, height = (int.from_bytes(png[i : i + 4], "big") for i in (16, 20))
        picture = Summary.Image(height=height, width=width, colorspace=4, encoded_image_string=png)
        values.append(Summary.Value(tag="final/curves", image=picture))
    # else a run of less than a second would write over the events of its training
    file = EventsWriter(str(workdir / "events"), filename_suffix=".final")
    event = Event(wall_time=time.time(), step=summary["iterations"])
    event.summary.value.extend(values)
    file.write_event(event)
    file.close()


def to_wandb(config, workdir: Path, summary: dict[str, Any]) -> None:
    """The last evaluation, the curves as a picture and the film, in the run of this workdir."""
    run = log.wandb_run(config, workdir)
    import wandb  # pyright: ignore[reportMissingImports]

    content: dict[str, Any] = dict(final(summary))
    if summary["curves"] == str(workdir / "curves.png"):
        content["final/curves"] = wandb.Image(summary["curves"])
    if summary.get("video") == str(workdir / "video.mp4"):
        content["final/film"] = wandb.Video(summary["video"], format="mp4")
    try:
        run.log(content)  # without a step: that of the last row is taken
    finally:
        run.finish()


def check_saved(run: OpenRun, robot, state, say) -> None:
    """Read the last checkpoint; if it is missing, save it once more.

    OSError that says why it cannot be saved, or ConfigError that says why it cannot be read.
    """
    workdir, done, state = run.workdir, run.iterations(), distributed.whole(state)

    def check():
        from dynappo.run import checkpoint

        if done not in workdir_lib.saved(workdir):
            save_again(checkpoint)
        checkpoint.read_back(workdir / "checkpoints" / str(done), state)

    def save_again(checkpoint):
        try:
            with checkpoint.opened(workdir, say) as checkpoints:
                workdir_lib.begin_save(run._replace(checkpoints=checkpoints), robot, state)
                checkpoint.wait(checkpoints)
        except Exception as error:
            before = workdir_lib.saved(workdir)
            then = "goes on from the one before" if before else "starts anew"
            room = "make room; " if log.errno_of(error) in ROOM else ""
            raise OSError(
                f"{workdir}: the checkpoint of iteration {done} could not be saved ({log.reason(error)}); "
                f"{room}the same command {then}"
            ) from None

    distributed.on_first(check)


def summarise(config, program, metrics, evaluation: dict) -> dict[str, Any]:
    """The results of a run: return (`log.at_the_end`), cost, and evaluation if there is one."""
    returns = metrics["episode_return"]
    summary = {
        "robot": config.robot,
        "num_envs": config.rollout.num_envs,
        "iterations": int(metrics["iteration"][-1]),
        "sim_steps": int(metrics["sim_steps"][-1]),
        "return": _numbers(log.at_the_end(returns)),
        "return_max": _numbers(np.fmax.reduce(returns, 0)),
        "return_of_all": _numbers(_return_of_all(config, metrics)),
        "seconds": _numbers(metrics["seconds"][-1]),
        "compile_seconds": program.compile_seconds,
        "bytes_needed": program.bytes_needed,
        "device": program.device,
        "impl": program.impl,
        "versions": {name: versions.of(name) for name in ("dynappo", "jax", "mujoco-mjx")},
        "commit": versions.commit(),
    }
    if share := blowups.share(metrics, config.rollout.num_envs):
        summary["blowups"] = share  # of the rows that physics wrote
    if evaluation:
        summary["evaluation"] = {name: _numbers(v) for name, v in evaluation.items()}
    return summary


def _return_of_all(config, metrics):
    """Mean return of all episodes that ended in the last episode's length of control steps."""
    n_real = metrics["n_real"]
    steps_after = np.cumsum(n_real[::-1])[::-1] - n_real  # those of later iterations
    last = steps_after < config.task.episode_length
    count, total = (metrics[n][last].sum(0) for n in ("episodes", "episode_return_sum"))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _numbers(values):
    """A float, or a list of one a seed; None where no episode has ended yet (JSON has no NaN)."""
    numbers = [float(v) if np.isfinite(v) else None for v in np.ravel(values)]
    return numbers if np.ndim(values) else numbers[0]
