"""19_collapse: each control does what its line says, and nothing else."""

import csv
import functools
import importlib
import json
import lzma
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import toy_env

from dynappo import algorithm, config, fast
from dynappo.config import splitting
from dynappo.description import robot as robot_lib
from dynappo.learner import networks
from dynappo.model import dynamics, examples
from dynappo.tasks.velocity import env as env_lib
from dynappo.tasks.velocity import observe
from experiments import paper, pictures, stats

controls = importlib.import_module("experiments.19_collapse.controls")
table = importlib.import_module("experiments.19_collapse.table")
HERE = Path(__file__).parents[2] / "experiments/19_collapse"
REAL = 5  # rows of 8


@pytest.fixture(scope="module")
def toy():
    """`(env, static, hyper, state, rows)`: eight rows of physics, in some of which an episode ends."""
    env = toy_env.make()
    _, static, hyper = toy_env.settings(toy_env.TAIL)
    state = jax.jit(partial(algorithm.init, env, static=static))(hyper, jax.random.key(0))
    collect = jax.jit(partial(algorithm.collect, env, static=static))
    rows, _, _ = collect(hyper, state, n_real=jnp.int32(8), key=jax.random.key(1))
    return env, static, hyper, state, rows


def test_a_cold_fit_does_not_depend_on_the_weights_before_it(toy):
    env, static, hyper, state, rows = toy
    new = examples.examples(static, hyper, env, rows=rows, n_real=jnp.int32(REAL))
    given = dict(rows=new, epochs=jnp.int32(2), key=jax.random.key(2))
    once = state.model.replace(params=jax.tree.map(lambda x: x + 1.0, state.model.params))

    def fitted(fit, model):
        return jax.jit(partial(fit, static))(hyper, model, **given)[0]

    one, other = (fitted(controls.cold, model) for model in (state.model, once))
    jax.tree.map(np.testing.assert_array_equal, one.params, other.params)
    one, other = (fitted(fast.fit, model) for model in (state.model, once))
    assert any(
        abs(a - b).max() > 0.1
        for a, b in zip(*map(jax.tree.leaves, (one.params, other.params)), strict=True)
    )
    np.testing.assert_array_equal(one.inputs.mean, fitted(controls.cold, once).inputs.mean)


def test_without_a_mask_the_model_learns_the_way_into_the_next_episode(toy):
    env, static, hyper, _, rows = toy
    rows = rows.replace(discount=rows.discount.at[1, 0].set(0.0), obs=rows.obs.at[2, 0].set(9.0))
    rows = rows.replace(prop=rows.prop.at[2, 0].set(9.0))
    # behind the last real row is a tail, from which nothing is learned
    rows = rows.replace(obs=rows.obs.at[REAL].set(7.0), prop=rows.prop.at[REAL].set(7.0))
    masked, all_rows = (
        f(static, hyper, env, rows=rows, n_real=jnp.int32(REAL))
        for f in (examples.examples, controls.unmasked)
    )
    assert (all_rows.weight[:REAL] == 1).all() and (all_rows.weight[REAL:] == 0).all()
    before, _ = examples.before_and_after(static, env, rows)
    now, then = before[1, 0, : env.prop_size], before[2, 0, : env.prop_size]
    expected = then - now if static.model.predict_change else then
    np.testing.assert_allclose(all_rows.y[1, 0, : env.prop_size], expected, rtol=1e-5)
    assert static.model.falls or masked.weight[1, 0] == 0
    # where no episode ends, and in the last real row, they are the same
    lives = np.array((rows.discount == 1) & (rows.truncation == 0))[:REAL]
    lives[1, 0] = False
    np.testing.assert_allclose(
        all_rows.y[:REAL][lives][:, :-1], masked.y[:REAL][lives][:, :-1], rtol=1e-4, atol=1e-4
    )


def test_the_last_value_is_that_of_where_the_tail_began(toy):
    """The simulator's own observation: of a new episode, where the last real row ended one."""
    env, static, hyper, state, rows = toy
    real = (jnp.arange(8) < REAL)[:, None]
    whole = rows.replace(discount=jnp.ones_like(rows.discount), truncation=0 * rows.truncation)
    whole = whole.replace(obs=whole.obs.at[REAL, 0].set(2.0), prop=whole.prop.at[REAL, 0].set(2.0))
    params = state.learner.params
    one, shipped = (
        jax.jit(partial(f, static, hyper, env))
        for f in (controls.bootstrap_real, algorithm.estimate)
    )
    found = one(rows=whole, real=real, params=params)
    _, seen = networks.inputs(static, env, whole.obs[REAL], whole.prop[REAL])
    with jax.default_matmul_precision("highest"):
        behind = networks.value(static, params, seen)
    np.testing.assert_allclose(
        found.returns[-1], whole.reward[-1] + hyper.ppo.gamma * behind, rtol=1e-4, atol=1e-5
    )
    every = dict(rows=whole, real=real | True, params=params)
    np.testing.assert_allclose(one(**every).returns, shipped(**every).returns, rtol=1e-4, atol=1e-6)


def test_a_tail_begins_some_steps_of_the_model_behind_the_real_state(toy):
    """`burn4`: the first imagined row begins where four steps of the model lead; real rows stay, and learn
    nothing from behind the last of them."""
    env, static, hyper, state, rows = toy
    key, n_real = jax.random.key(3), jnp.int32(REAL)
    start = dynamics.tail(static, env, state.env_state)
    given = dict(rows=rows, n_real=n_real, start=start, key=key)
    burnt = jax.jit(partial(controls.burnt, 4, env, static=static))(hyper, state, **given)
    _, after = controls.model_rows(static, hyper, env, state, start=start, begin=0, end=4, key=key)
    np.testing.assert_allclose(burnt.obs[REAL], after.obs, atol=1e-5)
    assert abs(burnt.obs[REAL] - start.obs).max() > 1e-2
    np.testing.assert_array_equal(burnt.obs[:REAL], rows.obs[:REAL])
    # `branch`: in a real row of its own robot, which are not all the same; real rows stay
    branch = jax.jit(partial(controls.branched, env, static=static))(hyper, state, **given)
    apart = abs(np.array(rows.obs[:REAL]) - np.array(branch.obs[REAL])).max(-1)  # [REAL, R]
    assert (apart.min(0) < 1e-6).all() and len({*apart.argmin(0)}) > 1
    np.testing.assert_array_equal(branch.obs[:REAL], rows.obs[:REAL])
    other_key = given | {"key": jax.random.key(4)}
    again = jax.jit(partial(controls.branched, env, static=static))(hyper, state, **other_key)
    assert (again.obs[REAL] != branch.obs[REAL]).any()
    cut, branching = (dict((f, g) for _, f, g in controls.CONTROLS[x]) for x in ("cut", "branch"))
    assert cut == {"estimate": controls.cut_behind_real}
    assert branching == cut | {"imagine": controls.branched}
    real, live = (jnp.arange(8) < REAL)[:, None], dict(discount=jnp.ones_like(rows.discount))
    calm = rows.replace(truncation=0 * rows.truncation, **live)
    params = state.learner.params
    cut = jax.jit(partial(controls.cut_behind_real, static, hyper, env))
    loud = calm.replace(reward=jnp.where(real, calm.reward, 1e3))
    one, other = (cut(rows=x, real=real, params=params) for x in (calm, loud))
    np.testing.assert_array_equal(one.advantages[:REAL], other.advantages[:REAL])
    assert (other.advantages[REAL:] > 100).all()


@pytest.fixture(scope="module")
def go1():
    """`(env, hyper, body, states)` of the velocity task; no physics is compiled."""
    settings = config.validate(config.load("configs/go1.py:dyna4_noschedule"))
    _, hyper = splitting.split(settings)
    env = env_lib.make(robot_lib.load("go1"), settings.task, settings.physics)
    body = env.randomize(hyper, jax.random.key(0))
    return env, hyper, body, [env.reset(hyper, body, jax.random.key(k)) for k in (1, 2)]


def test_a_robot_arrives_where_the_model_left_it(go1):
    """A pose with tilt and all speeds, told by its numbers alone: the robot senses just these, looks where
    it looked, and its lowest foot is as high as it was."""
    env, hyper, body, (start, end) = go1
    quat = jnp.array([0.8, 0.2, -0.3, 0.4]) / jnp.linalg.norm(jnp.array([0.8, 0.2, -0.3, 0.4]))
    rng = np.random.default_rng(0)
    qpos = end.qpos.at[3:7].set(quat).at[7:].add(0.3 * rng.normal(size=12))
    end = end.replace(qpos=qpos, qvel=jnp.asarray(rng.normal(size=18), jnp.float32))
    (const,) = env.step.args
    exact = controls.view.exact(const.view, const.robot, hyper, body, end)
    prop = exact[: env.prop_size]
    there = controls.arrived(
        env, hyper, body, start, exact + 0.01, prop, jnp.ones(12), jnp.zeros(12)
    )
    again = controls.view.exact(const.view, const.robot, hyper, body, there)
    np.testing.assert_allclose(again[: env.prop_size], prop, atol=2e-5)
    np.testing.assert_allclose(there.prop, prop, atol=2e-5)
    np.testing.assert_array_equal(there.obs, exact + 0.01)
    np.testing.assert_array_equal(there.qpos[:2], start.qpos[:2])
    np.testing.assert_allclose(
        observe.heading(there.qpos[3:7]), observe.heading(start.qpos[3:7]), atol=1e-5
    )
    model, heights = const.robot.mj_model, []
    for state in (start, there):
        data = mujoco.MjData(model)
        data.qpos[:] = state.qpos
        mujoco.mj_kinematics(model, data)
        feet = const.robot.feet
        heights.append(min(data.geom_xpos[feet, 2] - model.geom_size[feet, 0]))
    assert heights[0] == pytest.approx(heights[1], abs=1e-5)
    assert (there.last_action == 1).all() and (there.older_action == 0).all()


def test_a_robot_that_is_made_anew_where_it_is_is_the_same(go1):
    """`rebuilt` of a robot in motion; one whose numbers are not finite stays as it was."""
    env, hyper, body, (start, end) = go1
    rng = np.random.default_rng(1)
    quat = jnp.array([0.9, 0.1, -0.2, 0.3]) / jnp.linalg.norm(jnp.array([0.9, 0.1, -0.2, 0.3]))
    moving = end.replace(
        qpos=end.qpos.at[3:7].set(quat).at[7:].add(0.2 * rng.normal(size=12)),
        qvel=jnp.asarray(rng.normal(size=18), jnp.float32),
    )
    (const,) = env.step.args
    exact = controls.view.exact(const.view, const.robot, hyper, body, moving)
    moving = moving.replace(prop=exact[: env.prop_size], obs=exact)
    again = controls.arrived(
        *(env, hyper, body, moving, moving.obs, moving.prop),
        *(moving.last_action, moving.older_action),
    )
    np.testing.assert_allclose(again.qpos, moving.qpos, atol=1e-5)
    np.testing.assert_allclose(again.qvel, moving.qvel, atol=1e-5)
    both = jax.tree.map(lambda *x: jnp.stack(x), moving, start)
    broken = both.replace(qvel=both.qvel.at[1, 3].set(jnp.nan))
    assert list(controls.finite(broken)) == [True, False]
    chosen = controls.choose(controls.finite(broken), broken, both)
    np.testing.assert_array_equal(chosen.qvel, both.qvel)


def test_the_jobs_are_valid_and_on_the_page():
    """Each with a control that there is, and seeds that the page names; no two jobs are the same."""
    everything = importlib.import_module("experiments.21_less.controls").CONTROLS
    page, seen = (HERE / "README.md").read_text(), set()
    for line in (HERE / "jobs.txt").read_text().splitlines():
        name, job, *fields = line.split()
        values = dict(field.split("=", 1) for field in fields)
        assert values.pop("control", "last") in everything
        robot, _, variant = job.partition(":")
        settings = config.load(f"configs/{robot}.py:{variant}")
        for field, value in values.items():
            config.override(settings, field, value)
        settings = config.validate(settings)
        assert settings.run.seed == 700 and settings.run.num_seeds in (3, 5)
        kind = name.rpartition("-")[0].replace("-dyna4", "").replace("-noschedule", "")
        shown = (kind, kind.split("-")[0], f"-{kind.partition('-')[2]}")
        assert any(f"`{x}" in page for x in shown) or kind == "ppo16", name
        assert (job, *sorted(fields)) not in seen
        seen.add((job, *sorted(fields)))


def test_eight_fresh_seeds_ran_what_three_others_did():
    ran, later = (paper.jobs(HERE / f"{name}.txt") for name in ("jobs", "eight"))
    assert {*later} == {
        f"eight-{x}-{robot}" for x in ("tail", "cold", "cold-ramp") for robot in "gc"
    }
    for name, job in later.items():
        same = ran[name.removeprefix("eight-")]
        assert job == same.replace("seed=700 run.num_seeds=3", "seed=710 run.num_seeds=8") != same
    assert (
        "eight fresh seeds each (710 to 717), Go1 and ANYmal-C" in (HERE / "README.md").read_text()
    )


def test_anchors_on_other_robots_are_what_ran_on_a_go1_and_branching_is_its_control():
    """`anchors.txt`: the jobs of Go1 on two robots more, of ANYmal-C on seeds that nothing ran on; tails that
    branch differ from `tail` by their control alone."""
    ran, later = (paper.jobs(HERE / f"{name}.txt") for name in ("jobs", "anchors"))
    robots = {"h": "go2", "d": "anymal_d"}
    for name, job in later.items():
        what, _, robot = name.removeprefix("five-").rpartition("-")
        if what in ("cut", "branch"):
            same = ran[f"tail-{robot}"].split()
            assert sorted(job.split()) == sorted([*same, f"control={what}"])
        elif name.startswith("five-"):
            same = ran[f"{what}-c"]
            assert job == same.replace("seed=700 run.num_seeds=3", "seed=720 run.num_seeds=5")
        else:
            assert job == ran[f"{what}-g"].replace("go1:", f"{robots[robot]}:")
        fields = dict(field.split("=", 1) for field in job.split()[1:])
        assert fields.get("control", "cut") in controls.CONTROLS
    assert len(later) == 12 and not any("seed=720" in job for job in ran.values())
    again = paper.jobs(HERE / "anchors_again.txt")
    assert again == {
        f"five-{x}-d": later[f"{x}-d"].replace(
            "seed=700 run.num_seeds=3", "seed=720 run.num_seeds=5"
        )
        for x in ("rebuilt", "unanchored")
    }
    words = " ".join((HERE / "README.md").read_text().split())
    assert "five more seeds of an ANYmal-C (720 to 724)" in words
    assert "five fresh seeds of an ANYmal-D (720 to 724)" in words
    assert "**The rule, of 2026-11-29**: `branch` beside `cut`, and `cut` beside `tail`" in words


@pytest.fixture(scope="module")
def gpu():
    """Runs of the GPU by job and iteration."""
    return table.read(HERE / "results/gpu.csv.xz")


@pytest.mark.parametrize("title", table.TABLES)
def test_the_page_has_the_tables_as_they_are_printed(gpu, title):
    shown = table.shown(gpu, table.TABLES[title])
    assert shown in (HERE / "README.md").read_text()
    assert len(shown.splitlines()) > 4


def test_a_verdict_is_by_the_rules_of_the_page():
    """Five seeds each of a better, a worse, an equal and an unclear job; one that has not run counts."""
    rng = np.random.default_rng(0)
    means = dict(tail=(40, 0.1), ppo16=(40, 0.1), raw=(44, 0.1), cold=(10, 0.1), unscaled=(40, 0.2))
    means["unmasked"] = (39, 9.0)
    seeds = {name: rng.normal(*some, size=5) for name, some in means.items()}
    seeds["cold"][0] = np.nan  # counts as 0, and as a fall

    def run(returns):
        rows = [{"return": str(x), "fall_rate": "0.5"} for x in returns]
        return {100: rows, 300: rows}

    runs = {f"{name}-g": run(returns) for name, returns in seeds.items()}
    pairs = table.pairs("g", ("raw", "cold", "unscaled", "unmasked", "bootstrap-real"), "tail")
    found = {pair.job: one for pair, one in table.found(runs, pairs).items()}
    assert {job: one.verdict for job, one in found.items()} == {
        "raw": "better",
        "cold": "worse, **collapsed**",
        "unscaled": "no difference",
        "unmasked": "open",
    }
    seeds["cold"][0] = 0.0
    assert found["cold"].share == pytest.approx(seeds["cold"].mean() / seeds["ppo16"].mean())
    assert table.values({"a": {9: run([np.nan])[300]}}, "a", 9) == [0.0]
    rows = [{"fall_rate": "nan"}, {"fall_rate": "0.25"}]
    assert table.values({"a": {9: rows}}, "a", 9, "fall_rate") == [1.0, 0.25]
    del runs["unmasked-g"][300]  # cut off before its end
    assert table.Pair("g", "unmasked", "tail", "ppo16", 300) not in table.found(runs, pairs)
    plain = [stats.welch_of(seeds[pair.job], seeds["tail"]) for pair in pairs[:-1]]
    expected = stats.holm([*plain, 1.0])
    np.testing.assert_allclose([one.p for one in found.values()], expected[:-1])


def test_the_page_says_what_the_tables_do_not(gpu):
    """Errors of the model, seeds one by one, and differences that were looked for afterwards."""
    words = " ".join((HERE / "README.md").read_text().split())

    def mean(job, column, iteration=300):
        return np.mean(table.values(gpu, job, iteration, column))

    jobs = [f"{x}-{robot}" for x in (*table.ONE, "tail") for robot in "gc"]
    error = {job: mean(job, "model_error_4") for job in jobs}
    text = "its error is {:.2f} (Go1) and {:.2f} (ANYmal-C), with `tail` {:.2f} and {:.2f}"
    assert text.format(*(error[f"{x}-{r}"] for x in ("cold", "tail") for r in "gc")) in words
    assert (
        "with `unscaled` {:.2f} and {:.2f}".format(error["unscaled-g"], error["unscaled-c"])
        in words
    )
    for robot in "gc":
        one = {x: error[f"{x}-{robot}"] for x in ("tail", "raw", "unscaled", "raw-unscaled")}
        assert max(one, key=one.__getitem__) == "unscaled"
        assert max(error, key=lambda x: error[x] * x.endswith(f"-{robot}")) == f"cold-{robot}"
    seeds = table.values(gpu, "cold-g", 300)
    assert "Go1 have {:.1f}, {:.1f} and {:.1f} after 300 iterations".format(*seeds) in words
    seeds = table.values(gpu, "best-unanchored-g", 300)
    assert "nor at 300 ({:.1f}, the others {:.1f} and {:.1f});".format(*seeds) in words
    first = [table.values(gpu, "best-unanchored-g", k)[0] for k in (160, 500)]
    text = "learned nothing when the tails end ({:.1f} at iteration 160)"
    assert text.format(first[0]) in words and f"at 500 it has {first[1]:.1f}" in words
    assert min(table.values(gpu, "best-anchored-g", 300)) > 38
    at = [mean(f"best-{x}anchored-{r}", "return", 100) for r in "gc" for x in ("un", "")]
    text = "It is {:.1f} instead of {:.1f} on a Go1, {:.1f} instead of {:.1f} on an ANYmal-C"
    assert text.format(*at) in words
    falls = [
        100 * np.array(table.values(gpu, f"{x}-c", 300, "fall_rate"))
        for x in ("unanchored", "rebuilt")
    ]
    more = stats.difference(*falls)
    assert "{:.1f} points more of the episodes ({:.1f} to {:.1f},".format(*more) in words
    less = stats.difference(*(table.values(gpu, x, 500) for x in ("rows24-g", "dose16-falls-g")))
    assert "{:.1f} less than 24 real ones ({:.1f} to {:.1f}".format(*less) in words
    ends = table.values(gpu, "dose16-falls-g", 500)
    assert sum(x >= 38 for x in ends) == 2 and f"comes to {np.mean(ends):.1f} of 45, two" in words
    # PPO-16 with 1024 robots, of 17_regimes: other seeds, and these
    folder, name = HERE.parent / "17_regimes/results", "go1_ppo16_rollout.num_envs_1024_rollout"
    batches = [
        json.loads((folder / f"{more}{name}.horizon_16.json").read_text())["evaluation"]["return"]
        for more in ("", "more/")
    ]
    every = np.concatenate(batches)
    text = (
        "over {} seeds it has {:.1f} ([17_regimes](../17_regimes/README.md)), where 700 to 702 had"
    )
    assert text.format(len(every), every.mean()) in words
    assert "{:.1f}, {:.1f} and {:.1f}, too".format(*batches[0][:3]) in words
    gain = stats.difference(table.values(gpu, "dose8-g", 500), every)
    assert "{:.1f} more ({:.1f} to {:.1f}; looked for afterwards)".format(*gain) in words
    others = [
        one.share
        for title in list(table.TABLES)[:1]
        for pair, one in table.found(gpu, table.TABLES[title]).items()
        if pair.job in table.ONE and pair.job != "cold"
    ]
    assert f"The lowest is {min(others):.2f} of PPO-16" in words


def test_other_pages_say_that_real_rows_alone_fail_too(gpu):
    """What 8 real rows have without a tail, and with one of 16; no difference is shown."""
    pairs = table.TABLES["How long a tail may be, beside its real rows alone"]
    found = [one for pair, one in table.found(gpu, pairs).items() if pair.job == "dose16"]
    assert len(found) == 2 and all(one.p > 0.05 for one in found)
    means = [np.mean(table.values(gpu, f"{x}-{r}", 500)) for x in ("rows8", "dose16") for r in "gc"]
    text = "8 real rows alone fail, too ({:.1f} on a Go1, {:.1f} on an ANYmal-C, with such tails "
    text += "{:.1f} and {:.1f}): worse is not shown"
    assert text.format(*means) in other_page("paper")


def test_pages_say_on_which_robots_new_weights_are_shown_to_collapse(gpu):
    """On three seeds lower than `tail` on the ANYmal-C alone; on eight on both, with a ramp, too."""
    title, *_ = table.TABLES
    tests = table.found(gpu, table.TABLES[title])
    found = {pair.robot: one for pair, one in tests.items() if pair.job == "cold"}
    assert found["g"].verdict == "open, **collapsed**"
    assert found["c"].verdict == "worse, **collapsed**"
    assert {pair.job for pair, one in tests.items() if "collapsed" in one.verdict} == {"cold"}
    words = other_page("19_collapse")
    assert "with these seeds, shown on ANYmal-C alone" in words
    assert "Three seeds each had shown that on an ANYmal-C alone." in words
    eight = table.found(gpu, table.TABLES["New weights in each fit, on eight fresh seeds"])
    assert [(pair.job, pair.beside, pair.robot) for pair in eight] == [
        (f"eight-{x}", f"eight-{y}", robot)
        for x, y in (("cold", "tail"), ("cold-ramp", "tail"), ("cold-ramp", "cold"))
        for robot in "gc"
    ]
    by = {}
    for pair, one in eight.items():
        by.setdefault((pair.job, pair.beside), []).append(one)
    cold, ramp, gain = by.values()
    assert {one.verdict for one in cold + ramp} == {"worse, **collapsed**"}
    assert {one.verdict for one in gain} == {"open, **collapsed**"}
    shares = [f"{one.share:.2f}" for one in cold]
    text = (
        "a Go1 then has {} and an ANYmal-C {} of PPO-16's return, less than with weights that go on"
    )
    text += " (Holm {:.2g} and {:.0e})"
    assert text.format(*shares, *(one.p for one in cold)).replace("e-0", "e-") in words
    ramped = [f"{one.share:.2f}" for one in ramp]
    assert "the eight Go1 have {} and the ANYmal-C {} of PPO-16's".format(*ramped) in words
    means = [np.mean(table.values(gpu, f"{x}tail-{y}", 300)) for x in ("eight-", "") for y in "gc"]
    text = "`tail` has {:.1f} and {:.1f}, as on the three seeds ({:.1f} and {:.1f})."
    assert text.format(*means) in words
    text = "a Go1 has {:.1f} more than `cold`, where we expected a gain, an ANYmal-C {:.1f}, open"
    assert text.format(*(one.difference.value for one in gain)) in words
    below = [
        stats.difference(
            *(table.values(gpu, f"{x}-{robot}", 300) for x in ("ppo16", "eight-cold-ramp"))
        )
        for robot in "gc"
    ]
    text = "here they are {:.1f} ({:.1f} to {:.1f}) and {:.1f} ({:.1f} to {:.1f}) below it"
    assert text.format(*below[0], *below[1]) in words
    grown = [
        [np.mean(table.values(gpu, f"eight-cold-ramp-{x}", n)) for n in (200, 300)] for x in "gc"
    ]
    text = "a Go1 with the ramp rises from {:.1f} to {:.1f} in the mean, and two of its eight seeds are above"
    assert (
        text.format(*grown[0])
        + " 0.65 of PPO-16; an ANYmal-C rises from {:.1f} to {:.1f}.".format(*grown[1])
        in words
    )
    least = 0.65 * np.mean(table.values(gpu, "ppo16-g", 300))
    assert sum(x > least for x in table.values(gpu, "eight-cold-ramp-g", 300)) == 2
    ends = sorted(table.values(gpu, "eight-cold-g", 300))
    text = "four of eight Go1 end at {:.0f} to {:.0f} with few falls, four at {:.0f} to {:.0f}."
    assert text.format(ends[0], ends[3], ends[4], ends[7]) in words
    most = f"{max(one.p for one in cold):.2g}"
    short = "on eight fresh seeds a Go1 has {} and an ANYmal-C {} of PPO-16's return".format(
        *shares
    )
    for folder, *texts in (
        (
            "12_platforms",
            f"{short}, lower than with weights that go on (Holm {most} at most).",
            "they collapse, too ({} and {}), which".format(*ramped),
        ),
        ("14_efficiency", f"makes it collapse: {short} (Holm {most} at most)"),
        ("17_regimes", f"makes it collapse: {short} (Holm {most} at most)"),
        (
            "paper",
            f"{short} (Holm {most} at most;",
            "With the paper's ramp as well they have {} and {}".format(*ramped),
        ),
        (
            ".",
            "eight fresh seeds: Go1 {} and ANYmal-C {} of PPO-16".format(*shares),
            "with the ramp, too ({}, {})".format(*ramped),
        ),
    ):
        assert all(text in other_page(folder) for text in texts), folder


def test_the_page_says_what_new_weights_do(gpu):
    """Shares, seeds and errors of `cold` with a ramp or many epochs; the paper's shares are of its Table."""
    words = " ".join((HERE / "README.md").read_text().split())
    with (HERE.parent / "paper/platforms.csv").open() as file:
        best = {
            (x["robot"], x["variant"]): float(x["max_reward_mean"]) for x in csv.DictReader(file)
        }

    def each(job, column="return", iteration=300):
        return table.values(gpu, job, iteration, column)

    def mean(*job):
        return np.mean(each(*job))

    share = {
        (x, robot): mean(f"{x}-{robot}") / mean(f"ppo16-{robot}")
        for x in ("cold", *table.COLD)
        for robot in "gc"
    }
    theirs = {
        (x, robot[0] if robot == "go1" else robot[-1]): best[robot, x] / best[robot, "ppo16"]
        for x in ("dyna4", "dyna4_noschedule")
        for robot in ("go1", "anymal_c")
    }
    told = [theirs["dyna4", robot] for robot in "gc"]
    assert "both collapse. In the paper it is {:.2f} and {:.2f}.".format(*told) in words
    assert "the ramp leads to {:.2f} and {:.2f} of PPO-16".format(*told) in words
    assert "{} and {} in the paper".format(*(f"{x:.2f}" for x in told)) in other_page("paper")
    told = "In the paper a Go1 has {:.2f} and an ANYmal-C {:.2f}."
    assert told.format(*(theirs["dyna4_noschedule", robot] for robot in "gc")) in words
    title = "New weights in each fit, beside `tail` and `cold`"
    many = table.found(gpu, table.TABLES[title])[
        table.Pair("c", "cold-epochs", "tail", "ppo16", 300)
    ]
    text = "a Go1 does not collapse ({:.2f}), an ANYmal-C does in the mean ({:.2f}, not shown to be lower, "
    text += f"Holm {many.p:.2f})"
    assert many.difference.high > 0 and many.p > table.ALPHA
    assert text.format(*(share["cold-epochs", robot] for robot in "gc")) in words
    text = (
        "the ramp brings a Go1 from {:.2f} to {:.2f} of PPO-16, and an ANYmal-C from {:.2f} to {:.2f};"
        " in the paper from {:.2f} to {:.2f}, and from {:.2f} to {:.2f}"
    )
    ours = [share[x, robot] for robot in "gc" for x in ("cold", "cold-ramp")]
    there = [theirs[x, robot] for robot in "gc" for x in ("dyna4_noschedule", "dyna4")]
    assert text.format(*ours, *there) in words
    fallen = {pair for pair, x in share.items() if x < table.COLLAPSED}
    assert fallen == {("cold", "g"), *((x, "c") for x in ("cold", *table.COLD))}
    three = "({:.1f}, {:.1f}, {:.1f})"
    text = (
        f"`cold-ramp` collapses on ANYmal-C {three.replace('(', '(seeds: ')}, not on Go1 {three}."
    )
    assert text.format(*each("cold-ramp-c"), *each("cold-ramp-g")) in words
    text = f"`cold-epochs` does not collapse on Go1 {three}, but on ANYmal-C {three}."
    assert text.format(*each("cold-epochs-g"), *each("cold-epochs-c")) in words
    assert min(each("cold-epochs-g")) > 38  # its level: all three learn
    found = table.found(gpu, table.TABLES["New weights in each fit, beside `tail` and `cold`"])
    assert len(found) == 8 and all(one.verdict.startswith("open") for one in found.values())
    gains = [one.difference.value for pair, one in found.items() if pair.beside == "cold"]
    text = "All four means are above `cold`'s, by {:.1f} to {:.1f},"
    assert len(gains) == 4 and text.format(min(gains), max(gains)) in words

    def pair(job, steps, iteration=300):
        column = f"model_error_{steps}"
        return [f"{mean(f'{job}-{robot}', column, iteration):.2f}" for robot in "gc"]

    text = (
        "over four steps is {} (Go1) and {} (ANYmal-C), with `cold` {} and {};"
        " over one step it is {} and {}, with `cold` {} and {}"
    )
    jobs = [pair(job, steps) for steps in (4, 1) for job in ("cold-epochs", "cold")]
    assert text.format(*sum(jobs, [])) in words
    text = "`cold` has {} and {} over four steps, `unscaled` {} and {}, `raw-unscaled` {} and {}, and both"
    jobs = [pair(job, 4, 100) for job in ("cold", "unscaled", "raw-unscaled")]
    assert "After 100 iterations " + text.format(*sum(jobs, [])) in words
    at = [
        (pair(job, 4, 200)[1], f"{mean(f'{job}-c', 'return', 200):.1f}")
        for job in ("cold-epochs", "unscaled")
    ]
    more = stats.difference(*(each(f"{x}-c", "return", 200) for x in ("unscaled", "cold-epochs")))
    text = (
        "After 200 an ANYmal-C of `cold-epochs` has {} and returns {}, of `unscaled` {} and {}"
        " ({:.1f} more, {:.1f} to {:.1f}, uncorrected)"
    )
    assert text.format(*at[0], *at[1], *more) in words


def test_the_page_says_what_anymals_below_the_cliff_have(gpu):
    """Means, a tail's part of what four real rows gain, and how far below PPO-16 it is."""
    words = " ".join((HERE / "README.md").read_text().split())
    kinds = "ppo12", *table.TAILS, "ppo16"

    def each(place, kind, robot, end=500):
        return table.values(gpu, f"{place}-{kind}-{robot}", end)

    def means(place, robot):
        return {kind: np.mean(each(place, kind, robot)) for kind in kinds}

    for robot, text in (
        ("c", "PPO-12 has {:.1f}, the tails {:.1f} and {:.1f}, PPO-16 {:.1f}. In the mean that is"),
        ("d", "PPO-12 has {:.1f}, the tails {:.1f} and {:.1f}, PPO-16 {:.1f}, so"),
    ):
        some = means("robots1024", robot)
        gains = [
            100 * (some[x] - some["ppo12"]) / (some["ppo16"] - some["ppo12"]) for x in table.TAILS
        ]
        text += " {:.0f} and {:.0f} % of what four real rows gain"
        assert text.format(*some.values(), *gains) in words
    seeds = each("robots1024", "ppo12", "d")
    assert f"PPO-12 lie between {min(seeds):.1f} and {max(seeds):.1f}." in words
    found = table.found(gpu, table.TABLES["ANYmals below the cliff, beside PPO-12"])
    (one,) = (
        one for pair, one in found.items() if (pair.job, pair.robot) == ("robots1024-dyna4", "d")
    )
    text = "is {:.1f} ({:.1f} to {:.1f}), p {:.2f} by Holm"
    assert text.format(*one.difference, one.p) in words
    more = [one for pair, one in found.items() if pair.job.startswith("robots2048")]
    gains = [one.difference.value for one in more]
    assert f"The tails have {min(gains):.1f} to {max(gains):.1f} more than PPO-12" in words
    assert len(more) == 4 and {one.verdict for one in more} == {"open"}
    many = {robot: means("robots2048", robot) for robot in "cd"}
    text = "PPO-12 has {:.1f} and {:.1f} (C, D), PPO-16 {:.1f} and {:.1f}"
    assert text.format(*(many[x][kind] for kind in ("ppo12", "ppo16") for x in "cd")) in words
    whole = {
        (place, tail, robot): (each(place, tail, robot), each(place, "ppo16", robot))
        for place in ("robots1024", "robots2048")
        for tail in table.TAILS
        for robot in "cd"
    }
    p = dict(zip(whole, stats.holm([stats.welch_of(*x) for x in whole.values()]), strict=True))
    less = {name: np.mean(x[1]) - np.mean(x[0]) for name, x in whole.items()}
    worse = [name for name in whole if p[name] < table.ALPHA]
    lone, *_ = (name for name in worse if name[2] == "c")
    assert len(worse) == 5 and lone == ("robots2048", "dyna4-noschedule", "c")
    assert "five of eight are worse" in words
    of_d = [name for name in worse if name[2] == "d"]
    text = "on ANYmal-D all four, by {:.1f} to {:.1f} ({:.3f} at most);"
    shown = [less[name] for name in of_d]
    assert text.format(min(shown), max(shown), max(p[name] for name in of_d)) in words
    assert f"with 2048 robots, by {less[lone]:.1f} ({p[lone]:.3f})" in words
    others = [name for name in whole if name not in worse]
    text = "The other three are {:.1f} to {:.1f} lower ({:.3f} to {:.2f})"
    ends = [f([x[name] for name in others]) for x in (less, p) for f in (min, max)]
    assert len(others) == 3 and text.format(*ends) in words
    # the paper's own exploration
    own = {
        (kind, robot): each("own", kind, robot, 300)
        for kind in kinds
        for robot in "cd"
        if f"own-{kind}-{robot}" in gpu
    }
    back = {name: np.mean(x) for name, x in own.items()}
    text = "PPO-16 has {:.1f} (C) and {:.1f} (D) of 30, below 15, as expected; PPO-12 {:.1f} and {:.1f}"
    assert text.format(*(back[x, r] for x in ("ppo16", "ppo12") for r in "cd")) in words
    tails = [back[x, robot] for x in table.TAILS for robot in "cd"]
    assert f"the tails {min(tails):.1f} to {max(tails):.1f}." in words
    assert "{} to {}: no gain over PPO-12 is shown".format(
        *(f"{f(tails):.1f}" for f in (min, max))
    ) in other_page("paper")
    taught = {name: x for name, x in own.items() if name[0] != "ppo12"}
    assert len(taught) == 6 and all(gpu[f"own-{x}-{r}"][300][3]["seed"] == "703" for x, r in taught)
    lucky = [x[3] for x in taught.values()]
    text = (
        "One seed of five (703) has {:.1f} to {:.1f} with PPO-16 and with both tails, on both robots;"
        " of PPO-12 no seed has more than {:.1f}"
    )
    low = max(max(x) for (kind, _), x in own.items() if kind == "ppo12")
    assert text.format(min(lucky), max(lucky), low) in words
    rest = sorted((x, kind) for (kind, _), s in taught.items() for i, x in enumerate(s) if i != 3)
    assert len(rest) == 24 and {kind for _, kind in rest[-3:]} == {"dyna4-noschedule"}
    text = (
        "Of the other 24 runs three have {:.1f} to {:.1f}, all with the tail without a ramp, and none else"
        " more than {:.1f}."
    )
    assert text.format(*(rest[k][0] for k in (-3, -1, -4))) in words
    ours = {pair: one for pair, one in found.items() if pair.job.startswith("own")}
    gains = [one.difference for one in ours.values()]
    assert len(gains) == 4 and all(x.low < 0 < x.high for x in gains)
    more = [x.value for x in gains]
    assert f"({min(more):.1f} to {max(more):.1f} more, all four intervals include 0)" in words
    least = min(stats.welch_of(own[x, r], own["ppo16", r]) for x in table.TAILS for r in "cd")
    assert f"nor a difference to PPO-16 (p {least:.2f} at least, uncorrected)" in words
    shares = [one.share for one in ours.values()]
    assert f"{min(shares):.2f} to {max(shares):.2f} in the table are shares" in words
    p = {f"{one.p:.2f}" for one in ours.values()}
    assert len(p) == 1 and f"no gain over PPO-12 is shown (Holm {p.pop()})" in other_page("paper")
    of_d = [
        found[table.Pair("d", f"robots1024-{x}", "robots1024-ppo12", "robots1024-ppo16", 500)]
        for x in table.TAILS
    ]
    text = "an ANYmal-D {:.1f} and {:.1f} ({:.2f}, {:.2f}: open)"
    numbers = [one.difference.value for one in of_d] + [one.p for one in of_d]
    assert text.format(*numbers) in other_page("paper")


def other_page(folder: str) -> str:
    return " ".join((HERE.parent / folder / "README.md").read_text().split())


def test_the_page_says_what_the_exact_task_has(gpu):
    """Its tail beside its own PPO-16 alone: shares, intervals, falls, and the late seed."""
    words = " ".join((HERE / "README.md").read_text().split())
    title, *_ = table.TABLES
    found = {
        pair.robot: one
        for pair, one in table.found(gpu, table.TABLES[title]).items()
        if pair.job == "exact-tail" and pair.beside == pair.whole == "exact-ppo16"
    }
    assert {one.verdict for one in found.values()} == {"open"}
    shares = [f"{found[robot].share:.2f}" for robot in "gc"]
    assert (
        "The tail has {} (Go1) and {} (ANYmal-C) of PPO-16's return there".format(*shares) in words
    )
    first = (
        "a Go1 has {} and an ANYmal-C {} of what PPO-16 has there. That there is no difference is"
    )
    assert first.format(*shares) in words
    theirs = "In Isaac Lab's exact task it has {} and {} of PPO-16 there: no collapse, either"
    assert theirs.format(*shares) in other_page("paper")
    assert "in Isaac Lab's exact task {} and {} of PPO-16.".format(*shares) in other_page(".")
    assert "nor does it collapse in Isaac Lab's exact task" in other_page("17_regimes")
    assert all(table.NEAR[robot] < -one.difference.low for robot, one in found.items())
    assert "{:.0f} and {}".format(*(table.NEAR[r] for r in "gc")) == "2 and 1.3"
    assert "is open: its intervals reach beyond 2 and 1.3." in words

    def falls(job):
        return [table.values(gpu, f"exact-{job}-{robot}", 300, "fall_rate") for robot in "gc"]

    text = (
        "With the tail {:.1f} and {:.1f} % of the episodes have a fall at the end,"
        " with PPO-16 {:.1f} and {:.1f} %;"
    )
    both = falls("tail"), falls("ppo16")
    assert text.format(*(100 * np.mean(x) for some in both for x in some)) in words
    assert all(stats.welch_of(*x) > table.ALPHA for x in zip(*both, strict=True))
    late = [table.values(gpu, "exact-tail-c", k)[1] for k in (200, 300)]
    assert late[0] == min(table.values(gpu, "exact-tail-c", 200))
    text = "One ANYmal-C with the tail is late: {:.1f} at iteration 200, {:.1f} at 300."
    assert text.format(*late) in words


def test_the_pages_say_what_anchors_do_on_other_robots(gpu):
    """By the rule over three robots; robots made anew, too."""
    words = " ".join((HERE / "README.md").read_text().split())
    rule = table.TABLES["Anchors on other robots, beside robots made anew"]
    asked = [("h", "unanchored"), ("d", "unanchored"), ("c", "five-unanchored")]
    assert [(pair.robot, pair.job) for pair in rule] == asked
    found = {pair.robot: one for pair, one in table.found(gpu, rule).items()}
    assert {x: one.verdict for x, one in found.items()} == {"h": "open", "d": "worse", "c": "open"}

    def mean(job):
        return np.mean(table.values(gpu, job, 300))

    def lower(robot):
        one = found[robot].difference
        return f"{-one.low:.1f} less to {one.high:.1f} more"

    go2, anymal = (found[x].difference for x in "hd")
    means = [mean(f"{x}-h") for x in ("unanchored", "rebuilt")]
    text = "has {:.1f} without anchors and {:.1f} with robots made anew ({});"
    assert text.format(*means, lower("h")) in words and abs(go2.value) < 0.05
    near = table.NEAR["h"]
    assert near == table.NEAR["g"] == 2 and "after the runs we took Go1's, 2 of 45" in words
    text = f"the interval reaches {-go2.low - near:.2f} and {go2.high - near:.2f} beyond 2"
    assert text in words
    assert {f"{x:.1f}" for x in means} == {
        "38.4"
    } and "a Go2 has 38.4 of 45 with and without" in words
    means = [mean(f"{x}-d") for x in ("unanchored", "rebuilt")]
    less = -anymal.value, -anymal.high, -anymal.low
    holm = f"Holm {found['d'].p:.3f}"
    text = "**Three seeds of an ANYmal-D are worse without anchors**, as expected: {:.1f} of 30,"
    text += " with robots made anew {:.1f}. That is {:.1f} less ({:.1f} to {:.1f}), {}"
    assert text.format(*means, *less, holm) in words
    four = [
        stats.welch_of(*(table.values(gpu, f"{x}-{robot}", 300) for x in pair))
        for robot, *pair in (
            *((x, "unanchored", "rebuilt") for x in "hdg"),
            ("c", "five-unanchored", "five-rebuilt"),
        )
    ]
    with_go1 = f"{stats.holm(four)[1]:.3f}"
    assert f"as a fourth it is {with_go1}. Falls" in words
    assert "The two sides ran on two hosts, the fresh ones on one." in words
    assert f"is over three robots, with Go1 as a fourth {with_go1} |" in other_page(".")
    assert f"over three robots; with Go1 as a fourth {with_go1}; its two sides" in other_page(
        "paper"
    )
    shares = [
        mean(f"{x}unanchored-{robot}") / mean(f"{x}rebuilt-{robot}")
        for x, robot in (("", "h"), ("", "d"), ("", "g"), ("five-", "c"), ("five-", "d"))
    ]
    assert f"each has {min(shares):.2f} or more of what robots made anew have" in words
    every = [
        mean(f"{x}-{robot}")
        for robot, *both in (
            ("d", "unanchored", "rebuilt"),
            *((y, "five-unanchored", "five-rebuilt") for y in "cd"),
        )
        for x in both
    ]
    text = "no ANYmal's mean is at its level of 24, without anchors or with robots made anew"
    assert max(every) < 24 and text in words
    text = f"Three seeds had shown [{less[0]:.1f} less](#anchors-on-other-robots) by another rule set before "
    assert f"{text}({holm})" in words
    text = "[an ANYmal-D](#anchors-on-other-robots) lost {:.1f} of 30 on three seeds; on five fresh"
    assert text.format(less[0]) in words
    falls = (table.values(gpu, f"{x}-d", 300, "fall_rate") for x in ("unanchored", "rebuilt"))
    more = stats.difference(*(100 * np.array(x) for x in falls))
    text = "Falls are in {:.1f} points more of the episodes ({:.1f} to {:.1f}), and without anchors the"
    text += " five fresh seeds have {:.1f} more than these ({:.1f} to {:.1f}), both looked for afterwards"
    fresh = (table.values(gpu, f"{x}unanchored-d", 300) for x in ("five-", ""))
    assert text.format(*more, *stats.difference(*fresh)) in words
    five = f"{-found['c'].difference.value:.1f} less"
    assert f"**On five new seeds of an ANYmal-C it is open**: {five} ({lower('c')})" in words
    assert f"An ANYmal-C has {five} on five fresh seeds ({lower('c')})" in words
    told = f"Go2 {go2.value:.1f} higher ({-go2.low:.1f} lower to {go2.high:.1f} higher)"
    one = found["c"].difference
    told_c = f"{-one.value:.1f} lower on five fresh seeds ({-one.low:.1f} lower to {one.high:.1f} higher)"
    told_d = "on three before {:.1f} lower ({:.1f} to {:.1f}; {})".format(*less, holm)
    go1 = table.found(gpu, table.TABLES["Anchoring"])[
        table.Pair("g", "unanchored", "rebuilt", "ppo16", 300)
    ]
    assert (go1.verdict, found["h"].verdict) == ("no difference", "open")
    assert "a Go1 is no different, a Go2 is open; no collapse" in other_page(".")
    assert told in other_page("paper")
    assert all(x in other_page(y) for x in (told_c, told_d) for y in (".", "paper"))
    more, fewer = (
        stats.difference(*(table.values(gpu, f"{x}-{robot}", 300) for x in ("rebuilt", "tail")))
        for robot in "hd"
    )
    text = (
        "a Go2 has {:.1f} more with `rebuilt` than with `tail` ({:.1f} less to {:.1f} more),"
        " an ANYmal-D {:.1f} less ({:.1f} less to {:.1f} more)"
    )
    numbers = [more.value, -more.low, more.high, -fewer.value, -fewer.low, fewer.high]
    assert text.format(*numbers) in words


def test_the_pages_say_that_five_fresh_seeds_of_an_anymal_d_do_not_show_that_anchors_matter(gpu):
    """By a rule of its own, alone; and what was looked for afterwards, at iteration 100."""
    words = other_page("19_collapse")
    ((pair, one),) = table.found(
        gpu, table.TABLES["Anchors on an ANYmal-D, once more, on five fresh seeds"]
    ).items()
    assert pair == table.Pair("d", "five-unanchored", "five-rebuilt", "", 300)

    def each(column, at):
        return [table.values(gpu, f"{x}-d", at, column) for x in (pair.job, pair.beside)]

    both = each("return", 300)
    assert one.p == stats.welch_of(*both) > table.ALPHA and one.verdict == "open"
    less = one.difference
    gap = f"({-less.low:.1f} less to {less.high:.1f} more, p {one.p:.2f})"
    without, anew = (f"{np.mean(x):.1f}" for x in both)
    text = f"{without} of 30, with robots made anew {anew}, {-less.value:.1f} less {gap}."
    assert f"needs anchors is not shown**: without it has {text} We expected otherwise." in words
    beyond = -less.low - table.NEAR["d"]
    assert 0 < beyond and less.high < table.NEAR["d"]
    assert f"is open: the interval reaches {beyond:.2f} beyond {table.NEAR['d']}." in words
    text = f"an ANYmal-D has {without} of 30 on five fresh seeds, with robots made anew {anew}:"
    assert f"{text} {-less.value:.1f} less {gap}, so open." in words
    back, falls = stats.difference(*each("return", 100)), each("fall_rate", 100)
    text = "at iteration 100 it has {:.1f} less ({:.1f} less to {:.1f} more),"
    text += " and falls are in {:.0f} instead of {:.0f} % of the episodes"
    text += " ({:.1f} points more, {:.1f} to {:.1f}). Go1 and Go2 return more then."
    falls = [100 * np.array(x) for x in falls]
    numbers = [-back.value, -back.low, back.high, *map(np.mean, falls), *stats.difference(*falls)]
    assert text.format(*numbers) in words
    for robot in "gh":
        then = [np.mean(table.values(gpu, f"{x}-{robot}", 100)) for x in ("unanchored", "rebuilt")]
        assert then[0] > then[1]
    # by the rules of the page, of every robot: the fresh seeds of this one count, not the three before
    others = table.found(gpu, table.TABLES["Anchors on other robots, beside robots made anew"])
    assert {pair.robot for pair, x in others.items() if x.verdict == "worse"} == {"d"}
    first = table.found(gpu, table.TABLES["Anchoring"])
    assert not any(x.verdict == "worse" for pair, x in first.items() if "unanchored" in pair.job)
    assert "four rows is not shown on fresh seeds** at iteration 300" in words
    assert "We go by the fresh ones, which we decided after they ran." in words
    told = f"ANYmal-D {-less.value:.1f} lower on five fresh seeds ({-less.low:.1f} lower to"
    told += f" {less.high:.1f} higher; p {one.p:.2f}), on three before"
    verdict = "that anchors matter with 4 rows: **not shown** on fresh seeds; three seeds of an ANYmal-D had"
    assert all(x in other_page(y) for x in (told, verdict) for y in (".", "paper"))


def test_the_pages_say_what_tails_that_branch_do_on_a_gpu(gpu):
    """By the rule, which leaves all four open; and both changes together, looked for afterwards."""
    words = " ".join((HERE / "README.md").read_text().split())
    found = table.found(gpu, table.TABLES["Branching, and its advantages alone"])
    assert [(pair.job, pair.beside, pair.robot) for pair in found] == [
        (x, y, robot) for x, y in (("branch", "cut"), ("cut", "tail")) for robot in "gc"
    ]
    assert {one.verdict for one in found.values()} == {"open"}
    more, less = (
        [one.difference.value for p, one in found.items() if p.job == x] for x in ("branch", "cut")
    )
    text = "in the mean they have {:.1f} (Go1) and {:.1f} (ANYmal-C) more than the last"
    assert text.format(*more) in words
    assert (
        "**`cut` has {:.1f} and {:.1f} less than `tail` in the mean.**".format(*(-x for x in less))
        in words
    )
    one, other = (
        stats.difference(*(table.values(gpu, f"{x}-{robot}", 300) for x in ("branch", "tail")))
        for robot in "gc"
    )
    text = "a Go1 has {:.1f} less ({:.1f} less to {:.1f} more), an ANYmal-C {:.1f} less ({:.1f} to {:.1f})."
    assert (
        text.format(-one.value, -one.low, one.high, -other.value, -other.high, -other.low) in words
    )
    whole = (-one.value, -one.low, one.high, -other.value, -other.high, -other.low)
    one, other = (found[table.Pair(x, "branch", "cut", "ppo16", 300)] for x in "gc")
    text = "drawn rows have {:.1f} more on a Go1 ({:.1f} to {:.1f}) and {:.1f} more on an ANYmal-C"
    told = text.format(*one.difference, other.difference.value)
    _, low, high = other.difference
    least = f"{min(one.p, other.p):.2g}"
    told += f" ({-low:.1f} less to {high:.1f} more; three seeds, Holm {least} at least); beside the paper's"
    text = (
        " tail itself {:.1f} less ({:.1f} less to {:.1f} more) and {:.1f} less ({:.1f} to {:.1f};"
    )
    told += text.format(*whole)
    told += " uncorrected, another host): open"
    assert told in other_page("paper")
    assert f"the paper's tails three seeds, Holm {least} at least" in other_page(".")


def test_each_batch_has_the_jobs_that_the_page_says(gpu):
    """All jobs have run. Those that were cut off, in `cut.csv.xz`, are other runs than those that count."""
    words = " ".join((HERE / "README.md").read_text().split())
    names = {line.split()[0] for line in (HERE / "jobs.txt").read_text().splitlines()}
    anchors = paper.jobs(HERE / "anchors.txt")
    fifth = {"tail-h", "rebuilt-h", "unanchored-h", "tail-d", "rebuilt-d"}
    seventh = paper.jobs(HERE / "anchors_again.txt")
    new = {**anchors, **paper.jobs(HERE / "eight.txt"), **seventh}
    assert names | {*new} == set(gpu) and len(anchors) == 12 and len(seventh) == 2
    assert len(new) == 20
    for name, job in new.items():
        first, many = {"five": (720, 5), "eight": (710, 8)}.get(name.split("-")[0], (700, 3))
        assert [*gpu[name]] == [100, 200, 300]
        for rows in gpu[name].values():
            assert [int(row["seed"]) for row in rows] == [*range(first, first + many)]
            commit = "2a51cc3d" if name in seventh else "05f6d8fb"
            told = job, "32eca169" if name in fifth else commit, "NVIDIA H200"
            assert {(row["job"], row["commit"][:8], row["device"]) for row in rows} == {told}
    told = (
        "five of the twelve jobs of [`anchors.txt`](#anchors-on-other-robots) on one of two H200 of"
    )
    told += " one more host, 2026-11-29, at 32eca169, four at once (batch `fifth`); its other seven"
    told += " and the six of `eight.txt` on four H200 of one host, 2026-11-29, at 05f6d8fb (batch `sixth`);"
    told += " both of `anchors_again.txt` at once on one of two H200 of one host, 2026-11-30, at 2a51cc3d"
    assert f"{told} (batch `seventh`)" in words
    assert "`five-`: 720 to 724; `eight-`: 710 to 717" in words
    batches = {
        name: {row["batch"] for rows in x.values() for row in rows} for name, x in gpu.items()
    }
    fourth = {name for name, batch in batches.items() if batch == {"fourth"}}
    tails = {f"own-{x}-d" for x in table.TAILS}
    assert fourth == tails | {name for name in names if name.startswith("exact-")}
    own = {name for name in names if name.startswith("own-")} - tails
    of_2048 = {f"robots2048-{x}-{robot}" for x in table.TAILS for robot in "cd"}
    later = {f"{x}-{robot}" for x in table.COLD for robot in "gc"} | own | of_2048
    later |= {f"robots1024-{x}-d" for x in table.TAILS}
    assert {name for name, batch in batches.items() if batch == {"third"}} == later
    assert {name for name, batch in batches.items() if batch == {"fifth"}} == fifth
    assert {name for name, batch in batches.items() if batch == {"seventh"}} == {*seventh}
    assert {name for name, batch in batches.items() if batch == {"sixth"}} == (
        {*new} - fifth - {*seventh}
    )
    assert all(len(batch) == 1 for batch in batches.values())
    cut = table.read(HERE / "results/cut.csv.xz")
    eight = {name: cut.pop(name) for name in [*cut] if name.startswith("eight-")}
    means = [
        np.mean(table.values(eight, f"eight-{x}-{y}", 100)) for x in ("tail", "cold") for y in "gc"
    ]
    told = "({:.1f} on Go1, {:.1f} on ANYmal-C; `cold` {:.1f} and {:.1f}; batch `eight` of `cut.csv.xz`)"
    assert told.format(*means) in words and {*map(tuple, eight.values())} == {(100,)}
    assert len(cut) == 8 and all(name.startswith(("robots", "own")) for name in cut)
    assert "Eight jobs of `robots` and `own` were cut off at first." in words
    for name, by_iteration in cut.items():
        whole = table.values(gpu, name, 500 if name.startswith("robots") else 300)
        assert len(whole) == 5 and max(by_iteration) < max(gpu[name])
        assert table.values(cut, name, 100) != table.values(gpu, name, 100)


@functools.cache
def on_two_cores():
    """Rows of the runs on two CPU cores by what is otherwise."""
    runs = {}
    with lzma.open(HERE / "results/laptop.csv.xz", "rt", newline="") as file:
        for row in csv.DictReader(file):
            runs.setdefault(row["name"].removeprefix("laptop-"), []).append(row)
    return runs


def means_of(name, column="return"):
    """Of each seed, its mean from iteration 200 to 350."""
    each = {}
    for row in on_two_cores()[name]:
        if 200 <= int(row["iteration"]) <= 350:
            each.setdefault(row["seed"], []).append(float(row[column]))
    return [np.mean(x) for x in each.values()]


def test_the_page_has_what_the_runs_without_anchors_had():
    """Each cell; and the means from iteration 200 to 350, with Welch's interval."""
    page, runs, means = (HERE / "README.md").read_text(), on_two_cores(), means_of
    part = page.split("### On two CPU cores")[1]
    for name, rows in runs.items():
        (line,) = (x for x in part.splitlines() if x.replace("`", "").startswith(f"| {name} |"))
        cells = [cell.strip() for cell in line.split("|")[2:-1]]
        for at, cell in zip(range(50, 401, 50), cells, strict=True):
            some = [row for row in rows if int(row["iteration"]) == at]
            if name == "cold-epochs" and at > 250:  # where it ends
                assert not some and not cell
                continue
            assert len(some) == (5 if name.startswith("five-") else 3)
            back, falls = (np.mean([float(r[x]) for r in some]) for x in ("return", "fall_rate"))
            assert cell == f"{back:.1f}, {100 * falls:.0f} %", (name, at)

    words = " ".join(part.split())
    one, other = means("unanchored", "return"), means("rebuilt", "return")
    less, low, high = stats.difference(one, other)
    low_one, middle, high_one = (f"{x:.1f}" for x in sorted(one))
    every = other + means("anchored", "return")
    told = (
        f"their seeds have {low_one}, {middle} and {high_one}, those with anchors or made anew"
        f" {min(every):.1f} to {max(every):.1f}: {-less:.1f} less than `rebuilt` ({-low:.1f} less to"
        f" {high:.1f} more, p {stats.welch_of(one, other):.2f})"
    )
    assert told in words
    falls = [100 * np.mean(means(x, "fall_rate")) for x in ("unanchored", "rebuilt")]
    assert "{:.0f} % instead of {:.0f} %".format(*falls) in words
    at_200 = [
        np.mean([float(r["return"]) for r in runs[x] if r["iteration"] == "200"])
        for x in ("cold", "anchored")
    ]
    share = f"{at_200[0] / at_200[1]:.2f}"
    assert f"the return is {at_200[0]:.1f}, {share} of the anchored one" in words
    assert f"a Go1 has {share} of what it has" in " ".join(page.split())
    less = stats.difference(means("anchored", "return"), means("cold", "return"))
    assert "1.51 M {:.1f} less ({:.1f} to {:.1f})".format(*less) in words
    last = [r for r in runs["cold-epochs"] if r["iteration"] == "200"]
    back, error = (np.mean([float(r[x]) for r in last]) for x in ("return", "model_error_4"))
    text = f"at iteration 200 it has {back:.1f}, {back / at_200[1]:.2f} of the anchored return"
    assert text in words and f"and its error is {error:.2f}" in words
    error = [np.mean(means(x, "model_error_4")) for x in ("cold", "anchored")]
    assert "four steps is {:.2f}, with weights that go on {:.2f}".format(*error) in words


def test_the_pages_say_what_tails_that_branch_did_on_two_cores():
    """By the rule: two Welch tests, by Holm, and intervals within 2 of 45."""
    asked, runs = paper.jobs(HERE / "laptop.txt"), on_two_cores()
    names = [f"five-{x}" for x in ("anchored", "cut", "branch")]
    for name in names:
        rows = runs[name]
        assert {(r["job"], r["commit"][:8]) for r in rows} == {
            (asked[f"laptop-{name}"], "c7ed6819")
        }
        assert sorted({int(r["seed"]) for r in rows}) == [*range(720, 725)] and len(rows) == 40
    shipped, cut, branch = map(means_of, names)
    two = [stats.difference(branch, cut), stats.difference(cut, shipped)]
    p = stats.holm([stats.welch_of(branch, cut), stats.welch_of(cut, shipped)])
    assert all(max(-x.low, x.high) < table.NEAR["g"] for x in two) and min(p) > 0.05
    more, less = two
    words = " ".join(
        (HERE / "README.md").read_text().split("#### Branching, on two cores")[1].split()
    )
    told = f"{more.value:.1f} more than `cut` ({-more.low:.1f} less to {more.high:.1f} more), `cut`"
    told += f" {-less.value:.1f} less than the tail as shipped ({-less.low:.1f} less to {less.high:.1f} more;"
    assert f"{told} by Holm p {p[0]:.2f})" in words and p[0] == p[1]
    at = {
        k: {
            (x, r["seed"]): float(r["return"])
            for x in names
            for r in runs[x]
            if r["iteration"] == k
        }
        for k in ("250", "350")
    }
    late = min(at["250"], key=at["250"].get)
    value, last = at["250"].pop(late), at["350"][late]
    least = min(at["250"].values())
    told = f"{value:.1f} of 45 at iteration 250, where the other fourteen runs have {least:.1f}"
    assert late[0] == "five-cut" and f"{told} or more. At 350 it has {last:.1f}." in words
    gap, verdict = f"({-more.low:.1f} less to {more.high:.1f} more", other_page(".")
    told = f"{more.value:.1f} more than those behind the last {gap}): no difference"
    assert f"{told} |" in verdict and f"five seeds, Holm {p[0]:.2f}" in verdict
    told = f"from drawn rows {more.value:.1f} more than behind the last {gap}, five seeds, Holm"
    assert f"{told} {p[0]:.2f};" in other_page("paper")


def test_the_picture_is_of_these_runs(monkeypatch):
    """Each dose and each curve is a line through the means that the tables have."""
    plt = pytest.importorskip("matplotlib.pyplot")
    plot, pages = importlib.import_module("experiments.19_collapse.plot"), []
    monkeypatch.setattr(pictures, "save", lambda page, path, **_: pages.append((page, path.name)))
    monkeypatch.setattr("sys.argv", ["plot.py"])
    plot.main()
    ((page, name),) = pages
    assert name == "collapse" and (HERE / "collapse.png").exists()
    runs = table.read(HERE / "results/gpu.csv.xz")
    lines = {line.get_label(): line.get_ydata() for line in page.axes[0].lines}
    jobs = ["rows24-g", *(f"dose{rows}-g" for rows in table.DOSES)]
    means = [np.mean(table.values(runs, job, 500)) for job in jobs]
    np.testing.assert_allclose(lines["with the tail"], means)
    lines = {line.get_label(): line.get_ydata() for line in page.axes[6].lines}
    falls = [
        100 * np.mean(table.values(runs, "eight-cold-g", k, "fall_rate")) for k in (100, 200, 300)
    ]
    np.testing.assert_allclose(lines["new weights in each fit"], falls)
    words = " ".join((HERE / "README.md").read_text().split())
    text = (
        "three seeds (700 to 702), of the tail and of new weights with and without the ramp eight "
    )
    assert f"{text}(710 to 717)" in words
    eight = {job.split("-", 1)[1][:-2] for job in runs if job.startswith("eight-")}
    assert eight == {"tail", "cold", "cold-ramp"} <= plot.CURVES.keys()
    lines = {line.get_label(): line.get_ydata() for line in page.axes[3].lines}
    means = [np.mean(table.values(runs, "cold-epochs-c", k)) for k in (100, 200, 300)]
    np.testing.assert_allclose(lines["new weights, and 100 epochs"], means)
    plt.close("all")
