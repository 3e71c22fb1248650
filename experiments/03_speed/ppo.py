"""What one PPO update, one fit of the model and one row of a tail cost, and what ideas make of it.

    python experiments/03_speed/ppo.py OUT_DIR [--only WORD ...] [--profile NAME ...] [--errors]

Synthetic rollouts of Go1's shapes: no physics; JAX and ml_collections are enough. All programs take
turns in one process; a time is the median over `--rounds` calls of four updates in a scan, as they run
in training. Writes OUT_DIR/times.json, the compiled programs, and profiles of those in `--profile`.
`--only` picks programs by their names, or by words in them, in this order.
"""

import contextlib
import functools
import gzip
import json
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import ideas
import jax
import jax.numpy as jnp
import numpy as np
from ideas import Idea

from dynappo import algorithm, fast, rollout
from dynappo import config as config_lib
from dynappo.learner import networks, ppo
from dynappo.model import dynamics, examples
from dynappo.types import Transition
from experiments import paper

PRESET = jax.lax.DotAlgorithmPreset
UPDATES = 4  # in one call
SCAN = jax.lax.scan
GRAPH = "FUSION,CUBLAS,CUBLASLT,CUSTOM_CALL,CUDNN,DYNAMIC_SLICE_FUSION"
LOOPS = {"xla_gpu_enable_command_buffer": GRAPH + ",WHILE,CONDITIONAL"}
UNROLLED = LOOPS | {"xla_gpu_command_buffer_unroll_loops": True}
CONCURRENT = {"xla_gpu_command_buffer_scheduling_mode": "CONCURRENT"}
EMULATED = {
    "tf32": "tensorfloat32",
    "bf16x3": PRESET.BF16_BF16_F32_X3,
    "bf16x6": PRESET.BF16_BF16_F32_X6,
    "bf16x9": PRESET.BF16_BF16_F32_X9,
    "tf32x3": PRESET.TF32_TF32_F32_X3,
}


def updates():
    """Name -> (idea, compiler options) of PPO updates."""
    new = Idea(flat=True, packed="mean", once=True)  # in ppo.py since 4d4e006, with pair="kb2"
    out = {
        "before": (Idea(), {}),
        "flat": (Idea(flat=True), {}),
        "packed": (Idea(packed="mean"), {}),
        "once": (Idea(once=True), {}),
        "unroll": (Idea(unroll=4), {}),
        "new": (new, {}),
        "new cublaslt": (new, {"xla_gpu_enable_cublaslt": True}),
        "new slope of output": (new._replace(elu="out"), {}),
    }
    for name, how in {"highest": "highest", **EMULATED}.items():
        out[f"before {name}"] = (Idea(precision=how), {})
        out[f"new {name}"] = (new._replace(precision=how), {})
        for pair in ("bk", "kb", "kb2", "wide"):
            all_of_them = new._replace(pair=pair, packed="all", precision=how)
            out[f"all {pair} {name}"] = (all_of_them, {})
    for pair in ("", "bk", "kb2", "wide"):
        name = f"all {pair} bfloat16" if pair else "before bfloat16"
        idea = new._replace(pair=pair, packed="all", half=True) if pair else Idea(half=True)
        out[name] = (idea, {})
        out[f"{name} slope of output"] = (idea._replace(elu="out"), {})
    for name, options in {
        "loops": LOOPS,
        "unrolled loops": UNROLLED,
        "concurrent": UNROLLED | CONCURRENT,
    }.items():
        out[f"before {name}"] = (Idea(), options)
        out[f"all bk {name}"] = (new._replace(pair="bk", packed="all"), options)
    return out


@contextlib.contextmanager
def precision(setting):
    """Networks of precision "highest" compute in `setting`."""
    old = networks.PRECISION["highest"]
    networks.PRECISION["highest"] = setting
    try:
        yield
    finally:
        networks.PRECISION["highest"] = old


def env():
    """What the model and the buffer need of Go1's task."""

    def advance(hyper, context, prop, action, next_prop):
        return jnp.concatenate([context[:3], action])

    sizes = dict(obs_size=48, action_size=12, prop_size=33, dt=0.02)
    return SimpleNamespace(**sizes, advance=advance, views=None)


def rollout_of(static, params, robots, horizon):
    """A buffer [N, R] of a policy in noise, with rewards and ends."""
    rng = np.random.default_rng(1)
    shape = (horizon, robots)

    @jax.jit
    def make(obs, noise, discount, reward, change):
        mean, value = networks.policy(static, params, obs), networks.value(static, params, obs)
        action = mean + params["std"] * noise
        return Transition(
            obs=obs,
            action=action,
            action_mean=mean,
            log_prob=networks.log_prob(mean, params["std"], action),
            value=value,
            reward=reward,
            discount=discount,
            truncation=jnp.zeros(shape),
            next_obs=jnp.roll(obs, -1, 0) + change,
            prop=obs[..., :33],
            next_prop=jnp.roll(obs, -1, 0)[..., :33],
            valid=jnp.ones(shape),
            episode_return=jnp.zeros(shape),
            episode_length=jnp.zeros(shape),
        )

    normal = partial(rng.standard_normal, dtype=np.float32)
    discount = (rng.random(shape) > 0.01).astype(np.float32)
    obs, change = normal((*shape, 48)), 0.1 * normal((*shape, 48))
    return make(obs, normal((*shape, 12)), discount, 0.05 * normal(shape), change)


def programs(args):
    """Name -> `(function, arguments, compiler options, precision of "highest" or "", divisor of ms)`;
    and what they work on."""
    static, hyper = config_lib.split(config_lib.load("configs/go1.py:ppo16"))  # model as dyna4's
    of_fast, _ = config_lib.split(config_lib.load("configs/go1.py:fast"))
    task = env()
    make = jax.jit(lambda key: ppo.init(static, hyper, 48, 12, key))
    learner = make(jax.random.key(0))
    buffer = rollout_of(static, learner.params, args.robots, 16)
    estimate = jax.jit(partial(algorithm.estimate, static, hyper, task, real=jnp.bool_(True)))
    batch = estimate(learner.params, buffer)
    out = {}

    def repeated(update):
        def run(learner, batch, key):
            def one(learner, i):
                return update(learner, batch, jax.random.fold_in(key, i))

            return jax.lax.scan(one, learner, jnp.arange(UPDATES))

        return run

    key = jax.random.key(2)
    for name, (idea, options) in updates().items():
        run = repeated(partial(ideas.update, idea, static, hyper))
        out[f"update: {name}"] = (run, (learner, batch, key), options, "", UPDATES)
    run = repeated(partial(fast.update, static, hyper))
    out["update: dynappo.ppo"] = (run, (learner, batch, key), {}, "", UPDATES)

    def shuffles(learner, batch, key):
        rows = ppo.minibatches(static, batch, key)
        rows = jax.tree.map(lambda x: x.swapaxes(0, 1), rows)
        like = jax.tree.map(lambda x, b: x.reshape(b.shape), rows, batch)
        return learner, like

    def shuffle(learner, batch, key):
        def one(batch, i):
            return shuffles(learner, batch, jax.random.fold_in(key, i))[1], None

        return jax.lax.scan(one, batch, jnp.arange(UPDATES))[0]

    out["part: minibatches"] = (shuffle, (learner, batch, key), {}, "", UPDATES)

    def estimates(params, buffer):
        def one(value, _):
            rows = buffer.replace(value=value)
            new = algorithm.estimate(static, hyper, task, params, rows, jnp.bool_(True))
            return new.returns, None

        return jax.lax.scan(one, buffer.value, jnp.arange(UPDATES))[0]

    out["part: estimate"] = (estimates, (learner.params, buffer), {}, "", UPDATES)

    def rolled(*arguments):
        def scan(*a, unroll=1, **k):
            return SCAN(*a, **k)

        with mock.patch.object(jax.lax, "scan", scan):
            return estimates(*arguments)

    out["part: estimate, gae not unrolled"] = (rolled, (learner.params, buffer), {}, "", UPDATES)

    def fit(static, epochs):
        def run(model, buffer, n_real, epochs, key):
            learned = examples.examples(static, hyper, task, buffer, n_real)
            return fast.fit(static, hyper, model, learned, epochs, key)

        model = jax.jit(lambda key: dynamics.init(static, task, key))(jax.random.key(3))
        return run, (model, buffer, jnp.int32(12), jnp.int32(epochs), key)

    for name, how in (("highest", "highest"), *EMULATED.items()):
        out[f"fit: dyna4 {name}"] = (*fit(static, 25), {}, how, 1)
    out["fit: fast"] = (*fit(of_fast, 5), {}, "", 1)
    out["fit: fast none"] = (*fit(of_fast, 0), {}, "", 1)
    out["fit: fast loops"] = (*fit(of_fast, 5), LOOPS, "", 1)

    def tail(static, rows=16):
        def run(params, model, obs, key, n):
            state = dynamics.TailState(obs=obs, prop=obs[:, :33])
            keys = rollout.row_keys(key, jnp.arange(args.robots))
            empty = rollout.allocate(task, rows, args.robots)
            act = algorithm.policy(static, task, params)
            step = fast.step(static, hyper, task, model)
            return fast.fill(empty, jnp.int32(0), n, state, keys, act=act, step=step)[:2]

        model = jax.jit(lambda key: dynamics.init(static, task, key))(jax.random.key(3))
        return run, (learner.params, model, buffer.obs[0], key, jnp.int32(rows))

    for name in ("highest", "tf32x3", "tf32"):
        how = EMULATED.get(name, name)
        out[f"tail: dyna4 {name}"] = (*tail(static), {}, how, 16)
    out["tail: fast"] = (*tail(of_fast), {}, "", 16)
    out["tail: dyna4 loops"] = (*tail(static), LOOPS, "", 16)
    return out, (static, hyper, learner, batch)


def lower(run, arguments, how):
    """The program before compilation."""
    with precision(how) if how else contextlib.nullcontext():
        return jax.jit(lambda *a: run(*a)).lower(*arguments)  # a fresh function: no cached trace


def gradient_errors(static, hyper, learner, batch):
    """Relative error of one gradient of the loss in each precision, against float64."""
    rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:])[: 4 * 4096], batch)
    rows = rows._replace(advantages=ppo.normalize(rows.advantages))
    old_std = learner.params["std"]

    def gradient(idea, params, rows, old_std):
        of = partial(ideas.loss, idea, static, hyper)
        return jax.grad(of, has_aux=True)(params, rows, old_std)[0]

    with jax.enable_x64(True):
        double = jax.tree.map(
            lambda x: jnp.asarray(np.asarray(x), jnp.float64), (learner.params, rows, old_std)
        )
        exact = jax.device_get(jax.jit(partial(gradient, Idea()))(*double))
    out = {}
    for pair in ("", "bk"):
        for name, how in {"highest": "highest", **EMULATED}.items():
            try:
                idea = Idea(pair=pair, precision=how)
                found = jax.jit(partial(gradient, idea))(learner.params, rows, old_std)
            except Exception as error:  # noqa: BLE001 (a precision the device lacks)
                out[f"{pair} {name}"] = str(error)[:200]
                continue
            parts = [
                float(np.linalg.norm(a - b) / np.linalg.norm(b))
                for a, b in zip(jax.tree.leaves(found), jax.tree.leaves(exact), strict=True)
            ]
            out[f"{pair} {name}"] = {"worst": max(parts), "median": float(np.median(parts))}
    return out


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--only", nargs="*", default=[""], help="names that contain one of these")
    parser.add_argument("--robots", type=int, default=4096)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--seconds", type=float, default=200, help="no program is begun after this")
    parser.add_argument("--profile", nargs="*", default=[], help="names to profile")
    parser.add_argument("--errors", action="store_true", help="gradients against float64")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    began = time.perf_counter()
    todo, (static, hyper, learner, batch) = programs(args)
    chosen = [[word] if word in todo else [k for k in todo if word in k] for word in args.only]
    todo = {name: todo[name] for names in chosen for name in names}
    ready, results = {}, {"device": jax.devices()[0].device_kind, "jax": jax.__version__}
    results["times"] = times = {}
    worker = ThreadPoolExecutor(1)  # traces while the others compile
    traced = {k: worker.submit(lower, v[0], v[1], v[3]) for k, v in todo.items()}
    for name, (_, arguments, options, _, divisor) in todo.items():
        if time.perf_counter() - began > args.seconds:
            print(f"left out: {name}", flush=True)
            continue
        try:
            started = time.perf_counter()
            compiled = traced[name].result().compile(compiler_options=options)
            seconds = time.perf_counter() - started
            call = functools.partial(compiled, *arguments)
            answer = jax.block_until_ready(call())
            jax.block_until_ready(call())
        except Exception as error:  # noqa: BLE001 (an option or precision that the device lacks)
            print(f"{name}: {str(error)[:200]}", flush=True)
            times[name] = {"error": str(error)[:1000]}
            continue
        ready[name] = (call, divisor, [], answer)
        times[name] = {"compile_seconds": seconds}
        text = compiled.as_text()
        with gzip.open(args.out / "programs.txt.gz", "at") as file:
            file.write(f"##### {name}\n{text}\n")
        print(f"{time.perf_counter() - began:6.1f} s  {name} ({seconds:.1f} s)", flush=True)
    worker.shutdown(cancel_futures=True)
    for _ in range(args.rounds):
        for call, divisor, ms, _ in ready.values():
            start = time.perf_counter()
            jax.block_until_ready(call())
            ms.append((time.perf_counter() - start) * 1e3 / divisor)
    first = ready.get("update: before")
    for name, (_, _, ms, answer) in ready.items():
        times[name] |= {"ms": float(np.median(ms)), "all": ms}
        if first and name.startswith("update"):
            pairs = zip(
                jax.tree.leaves(answer[0].params), jax.tree.leaves(first[3][0].params), strict=True
            )
            times[name]["difference"] = max(float(jnp.abs(a - b).max()) for a, b in pairs)
            times[name]["rate"] = np.asarray(answer[1]["learning_rate"]).tolist()
    (args.out / "times.json").write_text(json.dumps(results))
    for name in args.profile:
        if name in ready:
            plain = name.replace(": ", "-").replace(" ", "-")
            with tempfile.TemporaryDirectory() as folder:
                with jax.profiler.trace(folder):
                    jax.block_until_ready(ready[name][0]())
                for file in Path(folder).rglob("*.xplane.pb"):
                    packed = gzip.compress(file.read_bytes())
                    (args.out / f"{plain}.xplane.pb.gz").write_bytes(packed)
    if args.errors:
        results["errors"] = gradient_errors(static, hyper, learner, batch)
        for name, error in results["errors"].items():
            print(f"{name:20s} {error}")
    (args.out / "times.json").write_text(json.dumps(results))
    print(results["device"])
    for name, row in times.items():
        if "ms" in row:
            print(f"{name:32s} {row['ms']:8.3f} ms  {row.get('difference', 0):.1e}")


if __name__ == "__main__":
    main()
