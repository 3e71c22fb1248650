"""Peers on the same machine, in one process, taking turns: RSL-RL's update, brax's PPO on our Go1.

    python experiments/03_speed/peers.py OUT.json [--only update|train] [--seconds 120]
        [--config configs/go1.py:ppo16] [--set FIELD=VALUE ...] [--brax normalize_observations=true ...]

`update`: ms of one PPO update (epochs x minibatches on N x R rows) by rsl_rl.algorithms.PPO (PyTorch)
and by dynappo.ppo, from the same weights and rows.

`train`: our task by our trainer and by brax.training.agents.ppo, through `brax_env.to_brax`. After each
chunk of brax's (`run.log_every` iterations) comes one of ours. Steps a second and the seconds until the
mean return of the last 100 finished training episodes reaches `--goal`; without compilation.

Both want a config without a tail. Packages and results: peers.md.
"""

import os

# before JAX starts: leave memory to PyTorch; rsl_rl imports GitPython for its logs, git may be absent
os.environ |= {"XLA_PYTHON_CLIENT_PREALLOCATE": "false", "GIT_PYTHON_REFRESH": "quiet"}

import collections
import contextlib
import functools
import io
import json
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np

from dynappo import algorithm, fast, schedule, stats
from dynappo import config as config_lib
from dynappo.learner import networks, ppo
from dynappo.program import build, devices
from dynappo.types import Transition
from experiments import paper

UPDATES = 4  # in one measurement
RETURNS = stats.RETURNS  # finished episodes in a mean return; brax's logger has 100 too
GO1: Any = SimpleNamespace(
    obs_size=48, action_size=12, prop_size=33, views=None
)  # sizes of its task


# ---- update


def learners(config):
    """Each precision's `(static, hyper)`; and a learner and rows that all start from."""
    groups = {}
    for name in ("highest", "tf32", "bfloat16"):
        config.ppo.precision = name
        groups[name] = config_lib.split(config)
    static, hyper = groups["highest"]
    learner = jax.jit(lambda key: ppo.init(static, hyper, 48, 12, key))(jax.random.key(0))
    shape = config.rollout.horizon, config.rollout.num_envs
    return groups, learner, rows_of(static, learner.params, shape)


def rows_of(static, params, shape) -> Transition:
    """A rollout [N, R] of the policy in noise, with rewards and ends; no physics."""
    *keys, paid, ends = jax.random.split(jax.random.key(1), 5)
    sizes = zip(keys, (48, 12, 48), strict=True)
    obs, noise, change = (jax.random.normal(key, (*shape, n)) for key, n in sizes)
    mean, value = networks.policy(static, params, obs), networks.value(static, params, obs)
    action, later, zero = mean + params["std"] * noise, jnp.roll(obs, -1, 0), jnp.zeros(shape)
    return Transition(
        obs=obs,
        action=action,
        action_mean=mean,
        log_prob=networks.log_prob(mean, params["std"], action),
        value=value,
        reward=0.05 * jax.random.normal(paid, shape),
        discount=1.0 - jax.random.bernoulli(ends, 0.01, shape),
        truncation=zero,
        next_obs=later + 0.1 * change,
        prop=obs[..., :33],
        next_prop=later[..., :33],
        valid=zero + 1,
        episode_return=zero,
        episode_length=zero,
    )


def ours(static, hyper, learner, buffer):
    """`(update, returns and update)`: functions that do UPDATES of them, as a scan as in training."""
    real = jnp.bool_(True)
    estimate = functools.partial(algorithm.estimate, static, hyper, GO1)

    def updates(learner, batch, buffer, key):
        def one(learner, i):
            rows = batch or estimate(learner.params, buffer, real)
            return fast.update(static, hyper, learner, rows, jax.random.fold_in(key, i))

        return jax.lax.scan(one, learner, jnp.arange(UPDATES))

    key = jax.random.key(1)
    batch = jax.jit(estimate)(learner.params, buffer, real)
    calls = []
    for arguments in ((learner, batch, None, key), (learner, None, buffer, key)):
        compiled = jax.jit(updates).lower(*arguments).compile()
        calls.append(functools.partial(compiled, *arguments))
    return calls, batch


def rsl_rl(static, hyper, learner, buffer, device):
    """RSL-RL's algorithm with our weights, and our rows in its storage; `(begin, algorithm, last_obs)`.

    `begin` puts first weights, learning rate and an empty Adam back.
    """
    import torch
    from rsl_rl.algorithms import PPO
    from rsl_rl.modules import ActorCritic
    from tensordict import TensorDict

    def tensor(x):
        return torch.tensor(np.asarray(x), device=device)

    horizon, robots = buffer.reward.shape
    obs = TensorDict({"policy": tensor(buffer.next_obs[-1])}, [robots], device=device)
    static, hyper = static.ppo, hyper.ppo
    groups, sizes = {"policy": ["policy"], "critic": ["policy"]}, list(static.hidden)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints its networks
        policy = ActorCritic(
            obs, groups, 12, actor_hidden_dims=sizes, critic_hidden_dims=sizes, activation="elu"
        )
    weights = {"std": tensor(learner.params["std"])}
    for name in ("actor", "critic"):
        for i, layer in enumerate(learner.params[name]["params"].values()):
            weights[f"{name}.{2 * i}.weight"] = tensor(layer["kernel"].T)
            weights[f"{name}.{2 * i}.bias"] = tensor(layer["bias"])
    algorithm = PPO(
        policy,
        num_learning_epochs=static.epochs,
        num_mini_batches=static.minibatches,
        clip_param=hyper.clip_epsilon,
        gamma=hyper.gamma,
        lam=hyper.lambda_,
        value_loss_coef=hyper.value_coef,
        entropy_coef=hyper.entropy_coef,
        learning_rate=hyper.learning_rate,
        max_grad_norm=hyper.max_grad_norm,
        desired_kl=hyper.desired_kl,
        device=device,
    )
    algorithm.init_storage("rl", robots, horizon, obs, [12])
    rows = algorithm.storage
    rows.observations["policy"].copy_(tensor(buffer.obs))
    rows.actions.copy_(tensor(buffer.action))
    rows.mu.copy_(tensor(buffer.action_mean))
    rows.sigma.copy_(weights["std"].expand_as(rows.mu))
    rows.rewards.copy_(tensor(buffer.reward[..., None]))
    rows.dones.copy_(tensor(1 - buffer.discount[..., None]))
    rows.values.copy_(tensor(buffer.value[..., None]))
    rows.actions_log_prob.copy_(tensor(buffer.log_prob[..., None]))

    def begin():
        policy.load_state_dict(weights)
        algorithm.learning_rate = hyper.learning_rate
        for moments in algorithm.optimizer.state.values():
            for x in moments.values():
                x.zero_()

    return begin, algorithm, obs


def measure_update(config, rounds):
    """ms an update of every case, `rounds` times in turn, and how far the two agree."""
    import torch

    cuda = torch.cuda.is_available()
    groups, learner, buffer = learners(config)
    begin, theirs, last_obs = rsl_rl(*groups["highest"], learner, buffer, "cuda" if cuda else "cpu")

    def by_torch(tf32, returns):
        def run():
            torch.backends.cuda.matmul.allow_tf32 = tf32
            begin()
            if cuda:
                torch.cuda.synchronize()
            began = time.perf_counter()
            for _ in range(UPDATES):
                if returns:
                    with torch.inference_mode():  # as rsl_rl's runner
                        theirs.compute_returns(last_obs)
                losses = theirs.update()
            if cuda:
                torch.cuda.synchronize()
            return (time.perf_counter() - began) / UPDATES * 1e3, losses

        return run

    def by_jax(call):
        def run():
            began = time.perf_counter()
            answer = jax.block_until_ready(call())
            ms = (time.perf_counter() - began) / UPDATES * 1e3
            return ms, {name: float(x[-1]) for name, x in answer[1].items()}

        return run

    cases = {}
    for tf32 in (False, True) if cuda else (False,):
        name = "rsl_rl, TF32" if tf32 else "rsl_rl, float32"
        cases[f"{name}: returns and update"] = by_torch(tf32, True)
        cases[f"{name}: update"] = by_torch(tf32, False)
    for precision, (static, hyper) in groups.items():
        calls, batch = ours(static, hyper, learner, buffer)
        for name, call in zip(("update", "returns and update"), calls, strict=True):
            cases[f"dynappo, {precision}: {name}"] = by_jax(call)
        if precision == "highest":
            begin()
            with torch.inference_mode():
                theirs.compute_returns(last_obs)
            difference = np.abs(theirs.storage.returns[..., 0].cpu().numpy() - batch.returns).max()
    out = {name: {"ms": []} for name in cases}
    for i in range(rounds + 2):  # the first two warm
        for name, run in cases.items():
            ms, losses = run()
            if i > 1:
                out[name]["ms"].append(ms)
                out[name]["losses of the last update"] = losses
    for row in out.values():
        row["median_ms"] = float(np.median(row["ms"]))
    return {"torch": torch.__version__, "returns_differ_by": float(difference), "cases": out}


# ---- train


class Enough(Exception):
    """The time is up; brax's trainer has no other way to stop early."""


def device_put_replicated(x, devices):
    """What brax 0.14.2 calls and JAX no longer has, as brax does it itself since (its commit 0b96d05,
    brax/training/agents/ppo/train.py): a leading axis of devices."""
    mesh = jax.sharding.Mesh(np.array(devices), ("devices",))
    sharding = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("devices"))
    return jax.tree.map(lambda x: jax.device_put(jnp.stack([x] * len(devices)), sharding), x)


def aged(env, **options):
    """brax's wrappers, but first episodes end at random, as ours and RSL-RL's: else all time-outs come
    in one wave, and the mean return of finished episodes is one of falls only in between."""
    from brax.envs.base import Wrapper
    from brax.envs.wrappers import training

    class Aged(Wrapper):
        def reset(self, rng):
            state = self.env.reset(rng)
            shape, length = state.info["steps"].shape, options["episode_length"]
            age = jax.random.randint(rng.reshape(-1, 2)[0], shape, 0, length)
            return state.replace(info=state.info | {"steps": age.astype(jnp.float32)})

    return Aged(training.wrap(env, **options))


def brax_ppo(env, config, own, progress_fn, episodes_fn):
    """brax's trainer with the settings of `config`, as far as it has them; `own` are arguments of it.

    What stays its own: advantages are computed anew in each minibatch, and normalised
    in it; a permutation for each epoch; minibatches of whole unrolls; no lower bound of the standard
    deviation; matrix products in JAX's default precision (TF32 on an NVIDIA GPU); episodes start
    again from the robot's first state with its first command.
    """
    import flax.linen as nn
    from brax.training.agents.ppo import networks
    from brax.training.agents.ppo import train as ppo_train
    from brax.training.logger import EpisodeMetricsLogger

    from dynappo.tasks import brax_env

    static, hyper = config_lib.split(config)
    robots, iterations = config.rollout.num_envs, config.run.num_iterations
    task = env._replace(metrics=())  # its bookkeeping would carry each reward term of each episode
    torch_like = {"scale": 1 / 3, "mode": "fan_in", "distribution": "uniform"}  # as our weights
    factory = functools.partial(
        networks.make_ppo_networks,
        policy_hidden_layer_sizes=static.ppo.hidden,
        value_hidden_layer_sizes=static.ppo.hidden,
        activation=getattr(nn, static.ppo.activation),
        distribution_type="normal",
        noise_std_type="scalar",
        init_noise_std=hyper.ppo.init_std,
        policy_network_kernel_init_fn=jax.nn.initializers.variance_scaling,
        policy_network_kernel_init_kwargs=torch_like,
        value_network_kernel_init_fn=jax.nn.initializers.variance_scaling,
        value_network_kernel_init_kwargs=torch_like,
    )
    arguments = dict(
        num_timesteps=iterations * robots * config.rollout.horizon,
        num_envs=robots,
        episode_length=config.task.episode_length,
        wrap_env_fn=aged,
        unroll_length=config.rollout.horizon,
        batch_size=robots // static.ppo.minibatches,
        num_minibatches=static.ppo.minibatches,
        num_updates_per_batch=static.ppo.epochs,
        learning_rate=hyper.ppo.learning_rate,
        learning_rate_schedule="ADAPTIVE_KL",
        desired_kl=hyper.ppo.desired_kl,
        entropy_cost=hyper.ppo.entropy_coef,
        discounting=hyper.ppo.gamma,
        gae_lambda=hyper.ppo.lambda_,
        clipping_epsilon=hyper.ppo.clip_epsilon,
        clipping_epsilon_value=hyper.ppo.clip_epsilon,
        vf_loss_coefficient=2 * hyper.ppo.value_coef,  # brax halves it
        max_grad_norm=hyper.ppo.max_grad_norm,
        normalize_observations=False,
        network_factory=factory,
        seed=config.run.seed,
        num_evals=iterations // config.run.log_every + 1,  # an epoch is one of our chunks
        run_evals=False,
        log_training_metrics=True,
        progress_fn=progress_fn,
    )
    with contextlib.ExitStack() as shims:
        if not hasattr(jax, "device_put_replicated"):
            shims.enter_context(
                mock.patch.object(jax, "device_put_replicated", device_put_replicated, create=True)
            )
        # brax's own picks finished episodes by JAX operations, compiled anew for each number of them
        shims.enter_context(
            mock.patch.object(EpisodeMetricsLogger, "update_episode_metrics", episodes_fn)
        )
        ppo_train.train(brax_env.to_brax(task, hyper), **(arguments | own))


def measure_train(config, own, seconds):
    """`{"dynappo": rows, "brax": rows}`, a row `{steps, seconds, return}` an iteration.

    An epoch of brax's in which XLA compiled counts as long as the median of the others.
    """
    config.run.update(eval_envs=0, video_seconds=0.0)
    config = config_lib.validate(config)
    program = build.program(config)
    every, batch = config.run.log_every, config.rollout.num_envs * config.rollout.horizon
    chunks = iter(np.arange(config.run.num_iterations).reshape(-1, every))
    out = {name: {"chunk_seconds": [], "returns": []} for name in ("dynappo", "brax")}
    out["brax"]["compiled"] = []
    state, compiles = program.state, []
    jax.monitoring.register_event_duration_secs_listener(
        lambda name, took, **_: compiles.append(took if "backend_compile" in name else 0.0)
    )
    ring, finished = collections.deque(maxlen=RETURNS), []
    clock = SimpleNamespace(compiled=None, epoch=time.perf_counter())

    def episodes(self, metrics, ended, losses):
        ended = np.asarray(ended).T > 0  # [R, N] -> [N, R]: the newest last
        ring.extend(np.asarray(metrics["sum_reward"]).T[ended].tolist())
        finished.append(float(np.mean(ring)) if ring else float("nan"))

    def our_chunk(rows):
        nonlocal state
        columns = {k: jnp.asarray(v[rows]) for k, v in program.columns.items()}
        began = time.perf_counter()
        state, metrics = jax.block_until_ready(program.step(program.hyper, state, columns))
        out["dynappo"]["chunk_seconds"].append(time.perf_counter() - began)
        out["dynappo"]["returns"] += np.asarray(metrics["episode_return"]).tolist()

    def progress(steps, metrics):
        """After each epoch: what it took, then a chunk of ours."""
        jax.effects_barrier()  # the callbacks of `episodes` belong to it
        now = time.perf_counter()
        out["brax"]["chunk_seconds"].append(now - clock.epoch)
        out["brax"]["compiled"].append(sum(compiles) > 0.3)
        out["brax"]["returns"], out["brax"]["losses"] = list(finished), _numbers(metrics)
        if (rows := next(chunks, None)) is not None:
            our_chunk(rows)
        line = (
            f"{k} {p['chunk_seconds'][-1]:.2f} s {p['returns'][-1]:.2f}" for k, p in out.items()
        )
        print(f"{steps / 1e6:7.2f} M steps", *line, sep="   ", flush=True)
        clock.compiled = clock.compiled or now  # once the first epoch is over
        if time.perf_counter() - clock.compiled > seconds:
            raise Enough
        compiles.clear()
        clock.epoch = time.perf_counter()

    with contextlib.suppress(Enough):
        brax_ppo(program.env, config, own, progress, episodes)
    for peer in out.values():
        times = np.array(peer["chunk_seconds"])
        compiled = np.array(peer.get("compiled", [False] * len(times)))
        median = float(np.median(times[~compiled]))
        each = np.where(compiled, median, times)
        iteration = np.arange(1, len(peer["returns"]) + 1)
        peer["steps"] = (iteration * batch).tolist()
        ends = np.concatenate([[0], np.cumsum(each)])
        peer["seconds"] = np.interp(iteration, every * np.arange(len(ends)), ends).tolist()
        peer["steps_per_second"] = every * batch / median
    return {"impl": program.impl, "setup_seconds": program.compile_seconds, **out}


def _numbers(metrics):
    return {name: float(value) for name, value in metrics.items()}


def reached(peer, goal):
    """`(seconds, steps)` at which the return first is `goal`; None where it never is."""
    first = next((i for i, x in enumerate(peer["returns"]) if x >= goal), None)
    return None if first is None else (peer["seconds"][first], peer["steps"][first])


# ---- both


def show_update(update):
    print(f"torch {update['torch']}; returns differ by {update['returns_differ_by']:.1e} at most")
    for name, row in update["cases"].items():
        print(f"{name:40s} {row['median_ms']:9.3f} ms  {min(row['ms']):9.3f}")


def show_train(result, goal):
    print(f"MJX-{result['impl']}; steps/s; return after the same steps; return {goal:g} after")
    last = min(len(result[name]["returns"]) for name in ("dynappo", "brax")) - 1
    for name in ("dynappo", "brax"):
        peer = result[name]
        at = reached(peer, goal)
        when = f"{at[0]:.1f} s, {at[1] / 1e6:.1f} M steps" if at else "not reached"
        print(
            f"{name:10s} {peer['steps_per_second']:10.0f}/s  {peer['returns'][last]:7.2f} after "
            f"{peer['steps'][last] / 1e6:.2f} M and {peer['seconds'][last]:.1f} s  {when}"
        )


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", choices=("update", "train"))
    parser.add_argument("--config", default="configs/go1.py:ppo16")
    parser.add_argument("--set", action="append", default=[], metavar="FIELD=VALUE")
    parser.add_argument(
        "--seconds", type=float, default=120, help="of training, both together, after compilation"
    )
    parser.add_argument("--brax", action="append", default=[], metavar="ARGUMENT=JSON")
    parser.add_argument("--rounds", type=int, default=15, help="of the update")
    parser.add_argument("--goal", type=float, default=34.0, help="the return to reach")
    args = parser.parse_args()
    devices.own_process()
    config = config_lib.load(args.config)
    for text in args.set:
        config_lib.override(config, *text.split("=", 1))
    if schedule.uses_model(config):
        parser.error("brax has no tail: --set schedule.start_steps=0 --set schedule.end_steps=0")
    own = {name: json.loads(text) for name, text in (x.split("=", 1) for x in args.brax)}
    result = {
        "device": jax.devices()[0].device_kind,
        "jax": jax.__version__,
        "config": args.config,
        "set": args.set,
        "brax": own,
    }
    print(f"{result['device']}, JAX {result['jax']}, {args.config} {' '.join(args.set)}")
    args.out.parent.mkdir(parents=True, exist_ok=True)
    if args.only != "train":
        result["update"] = measure_update(config.copy_and_resolve_references(), args.rounds)
        show_update(result["update"])
        args.out.write_text(json.dumps(result, indent=1))
    if args.only != "update":
        result["train"] = measure_train(config, own, args.seconds)
        show_train(result["train"], args.goal)
        args.out.write_text(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
