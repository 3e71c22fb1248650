"""Where the time of one control step goes, piece by piece, on the states of the task.

    python experiments/03_speed/rows.py OUT.json [--worlds 4096] [--cases RE,RE] [--trace RE,RE]

Every case does 16 control steps of Go1 from the same states (after 48 rows of an untrained policy)
on MJX-Warp, and the cases take turns; printed is the median, ms a control step. They are

    raw_*    mjx.step x 4 in a scan that carries its data; `const`: torques stay, `pd`: PD in each step,
             `fixed`: the solver does all its iterations instead of asking after each
    sim_*    engine.simulate (dynappo/physics)
    step_*   env.step, `pstep_*` with the autoreset
    fill_*   the whole row: policy, random numbers, buffer; `dyn` with a bound that is an argument, as
             in training, `static` with one that the compiler knows

each with the engine as it is (`own`: MuJoCo Warp called with ten arrays), and as it was before: by
mjx.step on data that are filled once a control step (`carry`) or in every physics step (`template`).
Traces say which kernels run and how long the device waits; with command buffers off
(XLA_FLAGS=--xla_gpu_enable_command_buffer=) each has its place in the program.
"""

import gzip
import json
import re
import tempfile
import time
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from mujoco import mjx

from dynappo import algorithm, fast, rollout
from dynappo import config as config_lib
from dynappo.learner import ppo
from dynappo.physics import contacts
from dynappo.physics import engine as engine_lib
from dynappo.physics import robot as robot_lib
from dynappo.tasks.velocity import env as env_lib
from experiments import paper

ROWS = 16
HOST = {"calls": 0, "seconds": 0.0, "captures": 0}


def watch_host():
    """Count seconds in Warp's Python callbacks, and graphs captured."""
    from warp._src.jax import ffi

    inner = ffi.FfiCallable.ffi_callback

    def callback(self, *args):
        began, before = time.perf_counter(), len(self.captures)
        try:
            return inner(self, *args)
        finally:
            HOST["captures"] += len(self.captures) - before
            HOST["calls"] += 1
            HOST["seconds"] += time.perf_counter() - began

    ffi.FfiCallable.ffi_callback = callback


class Bench:
    def __init__(self, worlds, impl):
        config = config_lib.validate(config_lib.load("configs/go1.py:ppo16"))
        self.static, hyper = config_lib.split(config)
        self.hyper, self.impl, self.worlds = hyper, impl, worlds
        robot = robot_lib.load(config.robot)
        env = env_lib.make(robot, config.task, config.physics, impl=impl)
        engine = env.step.args[0].engine
        model = robot_lib.physics_model(robot, config.physics)
        self.template = template(model, impl, worlds)
        self.model = mjx.put_model(model, impl=impl)
        if impl == "warp":  # or mjx.step prints
            self.model = self.model.tree_replace({"opt._impl.warn_overflow": 0})
        self.engine = engine
        of_mjx = dict(impl="jax", model=self.model, data=self.template, step=engine_lib._mjx_step)
        engines = {"own": engine, "carry": engine._replace(**of_mjx)}
        self.envs = {name: on_engine(env, engine) for name, engine in engines.items()}
        key = jax.random.key(0)
        self.robots = jnp.arange(worlds)
        keys = rollout.row_keys(key, self.robots)(0)
        self.body = jax.jit(jax.vmap(env.randomize, (None, 0)))(self.hyper, keys)
        state = jax.jit(jax.vmap(env.reset, (None, 0, 0)))(self.hyper, self.body, keys)
        learner = ppo.init(self.static, hyper, env.obs_size, env.action_size, key)
        self.params = learner.params
        # where the cases start
        run = jax.jit(partial(self.fill, "own", True))
        for _ in range(3):
            _, state, _ = run(self.params, self.body, state, key, jnp.int32(ROWS))
        self.state, self.key = jax.block_until_ready(state), key
        self.action = jax.random.normal(key, (worlds, env.action_size)) * 0.5

    # --- cases: functions of (params, body, state, key, n) ---

    def raw(self, control, change, params, body, state, key, n):
        """mjx.step x 4, data carried."""
        engine, task = self.engine, self.hyper.task
        default = jnp.asarray(engine.robot.default_pose, jnp.float32)
        target = default + 0.25 * self.action
        model = self.model.tree_replace(change) if change else self.model

        def torque(data):
            return task.kp * (target - data.qpos[:, 7:]) - task.kd * data.qvel[:, 6:]

        data = jax.vmap(lambda _: self.template)(self.robots)
        data = data.replace(qpos=state.qpos, qvel=state.qvel, qacc_warmstart=state.qacc_warmstart)
        data = data.replace(ctrl=torque(data))

        def step(data, _):
            if control == "pd":
                data = data.replace(ctrl=torque(data))
            return jax.vmap(mjx.step, (None, 0))(model, data), None

        with jax.default_matmul_precision("highest"):
            data = jax.lax.scan(step, data, None, length=ROWS * engine.substeps)[0]
        return data.qpos, data.qvel

    def sim(self, how, params, body, state, key, n):
        """engine.simulate alone."""
        engine = self.envs[how].step.args[0].engine

        def row(_, state):
            after = jax.vmap(engine_lib.simulate, (None, None, 0, 0, 0))(
                engine, self.hyper, body, state, self.action
            )
            names = "qpos qvel qacc_warmstart air_steps contact_steps last_air_steps".split()
            used = after.torque + after.qd_before + after.lowest.sum(-1)[:, None]
            return state.replace(
                last_action=state.last_action + used, **{k: getattr(after, k) for k in names}
            )

        return jax.lax.fori_loop(0, ROWS, row, state)

    def steps(self, how, reset, params, body, state, key, n):
        """env.step, or algorithm.physics_step with its autoreset."""
        env = self.envs[how]
        step = partial(jax.vmap(env.step, (None, 0, 0, 0, 0)), self.hyper, body)
        if reset:
            step = algorithm.physics_step(env, self.hyper, body)

        def row(t, carry):
            state, total = carry
            keys = rollout.row_keys(key, self.robots)(t)
            state, outcome = step(state, self.action, keys)
            return state, total + outcome.reward + sum(outcome.metrics.values())

        return jax.lax.fori_loop(0, ROWS, row, (state, jnp.zeros(self.worlds)))

    def fill(self, how, dynamic, params, body, state, key, n):
        """fast.fill with the policy: what `algorithm.iterate` does first."""
        env = self.envs[how]
        env = env._replace(step=scoped("task", env.step), autoreset=scoped("reset", env.autoreset))
        lo, hi = (jnp.int32(0), n) if dynamic else (0, ROWS)
        return fast.fill(
            rollout.allocate(env, ROWS, self.worlds),
            lo,
            hi,
            state,
            rollout.row_keys(key, self.robots),
            act=scoped("policy", algorithm.policy(self.static, env, params)),
            step=algorithm.physics_step(env, self.hyper, body),
            metrics=env.metrics,
        )

    def cases(self):
        out = {
            "raw_const": partial(self.raw, "const", None),
            "raw_pd": partial(self.raw, "pd", None),
        }
        if self.impl == "warp":
            fixed = {"opt._impl.graph_conditional": False}
            out["raw_pd_fixed"] = partial(self.raw, "pd", fixed)
        for how in self.envs:
            out[f"sim_{how}"] = partial(self.sim, how)
            out[f"step_{how}"] = partial(self.steps, how, False)
            out[f"pstep_{how}"] = partial(self.steps, how, True)
            out[f"fill_{how}_dyn"] = partial(self.fill, how, True)
            out[f"fill_{how}_static"] = partial(self.fill, how, False)
        return out


def template(model, impl, worlds):
    """mjx.Data of one robot, with contact buffers for all."""
    buffers = {}
    if impl == "warp":
        touching, rows = contacts.most(model)
        buffers = dict(naconmax=worlds * touching, njmax=rows)
    return mjx.make_data(model, impl=impl, **buffers)


def on_engine(env, engine):
    """`env` with another engine."""
    engine = engine._replace(step=scoped("simulate", engine.step))
    return env._replace(step=partial(env_lib.step, env.step.args[0]._replace(engine=engine)))


def scoped(name, function):
    def call(*args):
        with jax.named_scope(name):
            return function(*args)

    return call


def summarise(folder, hlo, calls):
    """Device events of a trace: by stage and by kernel, with the idle time between them."""
    stages = {}
    for match in re.finditer(r"^\s*(?:ROOT )?%?([\w.\-]+) = .*?op_name=\"([^\"]*)\"", hlo, re.M):
        stages[match[1]] = match[2]
    path = sorted(Path(folder).rglob("*.xplane.pb"))[-1]
    data = jax.profiler.ProfileData.from_file(str(path))
    events = []
    for plane in data.planes:
        if "GPU" not in plane.name:
            continue
        for line in plane.lines:
            if not line.name.startswith("Stream"):
                continue
            for event in line.events:
                stats = {k: v for k, v in event.stats if k in ("hlo_op", "name", "graph_id")}
                events.append(
                    (
                        event.start_ns,
                        event.duration_ns,
                        event.name,
                        str(stats.get("hlo_op", "")),
                        line.name,
                    )
                )
    events.sort()
    out = {"events": len(events), "calls": calls}
    if not events:
        return out | {"planes": [(p.name, [ln.name for ln in p.lines]) for p in data.planes]}
    by_stage, by_kernel, gaps, end = {}, {}, {}, events[0][0]
    idle = 0.0
    for start, duration, name, op, _ in events:
        place = stages.get(op, stages.get(op.split("__")[0], ""))
        names = ("simulate", "task", "reset", "policy")  # simulate lies in task
        stage = next((s for s in names if f"{s}/" in place or f"({s})" in place), "other")
        key = f"{stage}: {re.sub(r'[.0-9]+$', '', name)}"
        for table, k in ((by_stage, stage), (by_kernel, key)):
            row = table.setdefault(k, [0, 0.0])
            row[0] += 1
            row[1] += duration / 1e3
        if start > end:
            idle += (start - end) / 1e3
            gap = gaps.setdefault(f"before {key}", [0, 0.0])
            gap[0] += 1
            gap[1] += (start - end) / 1e3
        end = max(end, start + duration)
    out["span_us"] = (end - events[0][0]) / 1e3
    out["idle_us"] = idle

    def top(table, n):
        rows = sorted(table.items(), key=lambda kv: -kv[1][1])[:n]
        return [{"name": k[:110], "count": c, "us": round(us, 1)} for k, (c, us) in rows]

    out["stages"], out["kernels"], out["gaps"] = top(by_stage, 9), top(by_kernel, 80), top(gaps, 25)
    out["first"] = [
        [
            round((s - events[0][0]) / 1e3, 1),
            round(d / 1e3, 1),
            n[:60],
            op,
            stages.get(op, "")[-80:],
            ln[:12],
        ]
        for s, d, n, op, ln in events[:1500]
    ]
    return out


def main():
    parser = paper.parser(__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--worlds", type=int, default=4096)
    parser.add_argument("--cases", default="")
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--trace", default="")
    parser.add_argument("--impl", default="warp")
    args = parser.parse_args()
    clock = time.perf_counter()
    if args.impl == "warp":
        watch_host()
    bench = Bench(args.worlds, args.impl)
    names = ("qpos", "qvel", "qacc_warmstart")
    states = args.out.with_name("states.npz")  # for raw.py --states
    np.savez(states, **{k: np.asarray(getattr(bench.state, k)) for k in names})
    print(f"set up {time.perf_counter() - clock:.0f} s", flush=True)
    wanted = re.compile(args.cases.replace(",", "|") or ".")
    traced = re.compile(args.trace.replace(",", "|") or "^$")
    cases = {k: v for k, v in bench.cases().items() if wanted.search(k)}
    result = {
        "device": jax.devices()[0].device_kind,
        "jax": jax.__version__,
        "worlds": args.worlds,
        "rows": ROWS,
        "cases": {},
        "traces": {},
    }
    inputs = (bench.params, bench.body, bench.state, bench.key, jnp.int32(ROWS))
    compiled, hlo = {}, {}
    for name, function in cases.items():
        began = time.perf_counter()
        try:
            compiled[name] = jax.jit(function).lower(*inputs).compile()
            hlo[name] = compiled[name].as_text()
            before = dict(HOST)
            jax.block_until_ready(compiled[name](*inputs))
        except Exception as error:
            print(name, "failed:", repr(error)[:300], flush=True)
            compiled.pop(name, None)
            continue
        result["cases"][name] = {
            "setup_s": time.perf_counter() - began,
            "captures_first": HOST["captures"] - before["captures"],
            "ms": [],
        }
    print(f"compiled {time.perf_counter() - clock:.0f} s", flush=True)
    for turn in range(args.rounds + 1):
        for name, function in compiled.items():
            before, began = dict(HOST), time.perf_counter()
            for _ in range(2):
                jax.block_until_ready(function(*inputs))
            ms = (time.perf_counter() - began) / 2 / ROWS * 1e3
            case = result["cases"][name]
            if turn:
                case["ms"].append(ms)
                calls = max(1, HOST["calls"] - before["calls"])
                case["host_us_a_call"] = (HOST["seconds"] - before["seconds"]) / calls * 1e6
                case["host_calls_a_row"] = (HOST["calls"] - before["calls"]) / 2 / ROWS
                case["captures"] = case.get("captures", 0) + HOST["captures"] - before["captures"]
    zero = (*inputs[:-1], jnp.int32(0))
    for name, function in compiled.items():
        case = result["cases"][name]
        case["median_ms"] = float(np.median(case["ms"]))
        if name.endswith("_dyn"):
            times = []
            for _ in range(5):
                began = time.perf_counter()
                jax.block_until_ready(function(*zero))
                times.append(time.perf_counter() - began)
            case["empty_call_ms"] = float(np.median(times)) * 1e3
    args.out.parent.mkdir(parents=True, exist_ok=True)

    def write():
        args.out.write_text(json.dumps(result, indent=1))

    write()
    for name, case in result["cases"].items():
        print(
            f"{name:24s} {case['median_ms']:7.3f} ms  {min(case['ms']):7.3f}  "
            f"host {case['host_us_a_call']:6.0f} us x {case['host_calls_a_row']:.0f}, "
            f"captures {case['captures_first']}+{case['captures']}, "
            f"set-up {case['setup_s']:.0f} s",
            flush=True,
        )
    for name, function in compiled.items():
        if not traced.search(name):
            continue
        try:
            with tempfile.TemporaryDirectory() as folder:
                with jax.profiler.trace(folder):
                    jax.block_until_ready(function(*inputs))
                summary = summarise(folder, hlo[name], 1)
        except Exception as error:
            summary = {"error": repr(error)[:500]}
        result["traces"][name] = summary
        (args.out.parent / f"{name}.hlo.gz").write_bytes(gzip.compress(hlo[name].encode()))
        write()
        brief = ("span_us", "idle_us", "stages", "events", "error", "planes")
        print(name, json.dumps({k: summary.get(k) for k in brief})[:1200], flush=True)


if __name__ == "__main__":
    main()
