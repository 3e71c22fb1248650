"""brax 0.14.2's PPO on a Playground task, with Playground's settings: a row an evaluation, as run.py writes.

    python experiments/05_playground/brax_ppo.py --task=Go1JoystickFlatTerrain --out=results/go1-brax-0.csv

Trainer, networks, wrappers and resets are brax's and Playground's own. With `wrapper.wrap_for_brax_training`
a robot starts each episode from its one cached state. In between, Playground's settings reset all robots ten
times between two evaluations: a robot of Spot's trains for 140 control steps in a row, of an episode of 1000,
and never hears a second command. `--steps` and `--evals` are Playground's if not given; with others a robot
is reset about as often (`resets`). `--resets` sets how often between two evaluations.

Not theirs:

- What JAX has removed since is put back (`repaired`).
- An evaluation is like ours: 128 episodes with the policy's mean action, where brax draws actions. An episode
  has as many steps as in training: 1000, and 300 of a getup task.
- `seconds` are brax's own of training, without evaluations and those resets, and less what it takes to
  compile. The engine's kernels are built before.
- MuJoCo Warp has room for as many contacts and constraints as in our runs (dynappo/tasks/playground/room.py).
  Where Playground's own is too small, Warp leaves some out, and brax would not tell.
"""

import csv
import functools
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from brax.training import acting
from brax.training.agents.ppo import networks, train
from mujoco_playground import wrapper

from dynappo.program import devices
from dynappo.tasks.playground import loading
from experiments import paper

EPISODES = 128


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("--task", required=True)
    parser.add_argument("--out", type=Path, required=True, help="a CSV")
    parser.add_argument("--steps", type=int, help="of the simulator, in all")
    parser.add_argument("--robots", type=int)
    parser.add_argument("--evals", type=int, help="after the start")
    parser.add_argument("--resets", type=int, help="of all robots, between two evaluations")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--impl", choices=("jax", "warp"), help="warp on a GPU, else jax")
    args = parser.parse_args()
    devices.own_process()
    settings = asked(args.task, args.steps, args.robots, args.evals, args.resets)
    impl = args.impl or ("warp" if jax.default_backend() == "gpu" else "jax")
    run(args.task, impl, settings, args.seed, args.out)


def asked(
    name: str,
    steps: int | None = None,
    robots: int | None = None,
    evals: int | None = None,
    resets: int | None = None,
):
    """Playground's settings of a task, with other sizes where they are given.

    Between two resets a robot has about as many control steps as in Playground's, whatever the sizes are:
    brax counts resets by evaluations.
    """
    settings = loading.ppo_config(name)
    own = control_steps(settings)
    settings.num_timesteps = steps or settings.num_timesteps
    settings.num_envs = robots or settings.num_envs
    settings.num_minibatches = min(settings.num_minibatches, settings.num_envs)
    settings.batch_size = settings.num_envs // settings.num_minibatches  # as it is for 8192 robots
    if evals:
        settings.num_evals = evals + 1  # brax counts the one at the start
    if resets is None:
        resets = round(settings.num_resets_per_eval * control_steps(settings) / own) or 1
    settings.num_resets_per_eval = resets
    return settings


def control_steps(settings) -> float:
    """Of a robot between two resets of all."""
    epochs = (settings.num_evals - 1) * max(settings.num_resets_per_eval, 1)
    return settings.num_timesteps / settings.num_envs / epochs


def run(name: str, impl: str, settings, seed: int, out: Path) -> None:
    task = loading.load(name, impl, settings.num_envs).task
    build_kernels(task, settings.num_envs)
    factory = functools.partial(networks.make_ppo_networks, **settings.network_factory)
    own = {name: value for name, value in settings.items() if name != "network_factory"}
    a_step = settings.num_envs * settings.unroll_length * settings.action_repeat
    rows, spent = [], []
    sizes = settings.num_timesteps, settings.num_evals - 1, settings.num_resets_per_eval
    about = "steps={} evals={} resets={}".format(*sizes)

    def progress(steps, metrics):
        if steps == 0:
            return
        row = {
            "job": f"brax:{name} {about}",
            "seed": seed,
            "iteration": steps // a_step,
            "sim_steps": steps,
            "seconds": f"{metrics['training/walltime'] - sum(spent):.4g}",
            "return": f"{metrics['eval/episode_reward'].mean():.4g}",
            "fall_rate": f"{metrics['fall_rate']:.4g}",
        }
        rows.append(row)
        print(*row.values(), flush=True)
        write(out.with_name(f"{out.name}.part"), rows)

    out.parent.mkdir(parents=True, exist_ok=True)
    repaired(spent, settings.episode_length)
    train.train(
        environment=task,
        max_devices_per_host=1,
        wrap_env_fn=wrapper.wrap_for_brax_training,
        network_factory=factory,
        seed=seed,
        num_eval_envs=EPISODES,
        deterministic_eval=True,
        progress_fn=progress,
        **own,
    )
    out.with_name(f"{out.name}.part").replace(out)


def repaired(spent: list[float], length: int) -> None:
    """brax's trainer made to run on today's JAX, to compile ahead, and to tell falls; compiling a program of
    training adds its seconds to `spent`."""
    # JAX 0.10 has removed it; brax puts its first state on the devices with it
    jax.device_put_replicated = replicated
    pmap, evaluate = jax.pmap, acting.Evaluator.run_evaluation

    def ahead(function, **options):
        mapped, programs = pmap(function, **options), []
        if getattr(function, "__name__", "") != "training_epoch":  # brax counts this one alone
            return mapped

        def epoch(*arguments):
            if not programs:
                began = time.perf_counter()
                programs.append(mapped.lower(*arguments).compile())
                spent.append(time.perf_counter() - began)
            return programs[0](*arguments)

        return epoch

    def told(self, params, training_metrics):
        metrics = evaluate(self, params, training_metrics)
        steps = self._eval_state_to_donate.info["eval_metrics"].episode_steps
        return metrics | {"fall_rate": np.mean(np.asarray(steps) < length)}

    jax.pmap, acting.Evaluator.run_evaluation = ahead, told


def replicated(tree, devices):
    """`jax.device_put_replicated` of one device, as `jax.pmap` places its arguments."""
    (device,) = devices
    mesh = jax.sharding.Mesh(np.array([device]), ("i",))
    placed = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("i"))
    return jax.tree.map(lambda x: jax.device_put(jnp.asarray(x)[None], placed), tree)


def build_kernels(task, robots: int) -> None:
    """Call physics once: an engine builds and loads its kernels when they are first launched."""
    state = jax.jit(jax.vmap(task.reset))(jax.random.split(jax.random.PRNGKey(0), robots))
    jax.block_until_ready(
        jax.jit(jax.vmap(task.step))(state, jnp.zeros((robots, task.action_size)))
    )


def write(path: Path, rows: list[dict]) -> None:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
