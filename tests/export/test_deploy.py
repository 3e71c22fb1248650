"""A policy on a robot, as robots/DEPLOY.md says it: its tables, its loop, ten seconds of walking."""

import json
import re
import sys
import time
import types

import mujoco
import numpy as np
import onnxruntime
import pytest
from answers import ROOT
from toy_onnx import MOTORS, infer, onnx_file

from dynappo import config as config_lib
from dynappo.description import motors
from dynappo.description import robot as robot_lib
from dynappo.export import command as export_command
from dynappo.export import joint_order
from dynappo.physics import actuators
from dynappo.policy import episode, policy_file, policy_source
from dynappo.tasks.velocity import log_file, logged, observe
from dynappo.terrain import scan

PAGE = (ROOT / "robots" / "DEPLOY.md").read_text()
WALK, SCAN, LOG = re.findall(r"```python\n(.*?)```", PAGE, re.S)
AHEAD = np.array([0.6, 0.0, 0.0])  # m/s, m/s, rad/s


@pytest.fixture(scope="module")
def bundled():
    """The policy for hardware that comes with the Go1."""
    return policy_source.load("go1_deploy")[0]


def body_of(policy, field=None):
    """The policy's robot in its own file."""
    return episode.load(robot_lib.load(policy.robot).xml, policy, policy.timestep, field=field)


def at_motors(policy):
    """The policy with its joints as `--joint-order=unitree` has them; a G1's file has that order."""
    return policy if policy.robot == "g1" else joint_order.permute(policy, MOTORS)


def test_its_tables_are_those_of_the_code(bundled):
    """Indices, units, noise; gains, limits and scales of the bundled policies."""
    rows = [line.split(" | ") for line in PAGE.splitlines() if re.match(r"\| \d+-\d+ \|", line)]
    for cells, row in zip(rows, onnx_file.observation_table(bundled), strict=True):
        assert cells[0] == f"| {row['start']}-{row['stop'] - 1}" and cells[2] == row["unit"]
        assert cells[4] == (f"+-{row['noise']:g}" if row["noise"] else "none")
    numbers = ("| `kp`", "| `effort", "| `velocity", "| `action_scale`")
    lines = [line for line in PAGE.splitlines() if line.startswith(numbers)]
    for column, robots in ((1, ["go1"]), (2, ["go2"]), (3, ["anymal_c", "anymal_d"])):
        for name in robots:
            policy = policy_source.load(f"{name}_deploy")[0]
            gains, effort, speed, scale = (line.strip("| ").split(" | ")[column] for line in lines)
            assert gains.split(", and")[0] == f"{policy.kp:g}, {policy.kd:g}"
            for said, limits in ((effort, policy.effort_limit), (speed, policy.velocity_limit)):
                legs = np.broadcast_to(limits, 12).reshape(4, 3)  # hip, thigh, calf
                assert (legs == legs[0]).all() and legs[0, 0] == legs[0, 1]
                assert said == "; ".join(dict.fromkeys(f"{limit:g}" for limit in legs[0, 1:]))
            assert scale == f"{policy.action_scale:g}"


@pytest.mark.parametrize("order", ["mjcf", "isaaclab"])
@pytest.mark.parametrize("name", ["go1", "go1_deploy"])
def test_the_onnx_file_walks_for_ten_seconds_in_c_mujoco(name, order, tmp_path):
    """0.6 m/s ahead: no fall, the distance that was asked for, close to the command."""
    out, bundled = tmp_path / "policy.onnx", policy_source.load(name)[0]
    export_command.main([name, f"--out={out}", f"--joint-order={order}"])
    net = onnxruntime.InferenceSession(out)
    facts = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    # the body is read and driven in the order that the file says
    body = body_of(joint_order.permute(bundled, tuple(facts["joint_names"])))
    columns = onnx_file.order(bundled)

    def act(obs):
        return infer(net, obs[None, columns])[0]

    walked = episode.play(body, act, lambda t: AHEAD, 10.0)
    m = episode.measures(body, walked)
    assert m["fall"] is None and m["seconds"] == 10.0
    assert walked["qpos"][-1, 0] > 5.0  # m ahead, of 6
    assert m["tracking_error"] is not None and m["tracking_error"] < 0.15  # m/s


@pytest.fixture(params=["go1_deploy", "g1_deploy"])
def loop(request, tmp_path, monkeypatch):
    """`loop(steps, broken)`: the code of the page as it stands, with its lines for a log; see `drive`."""
    before, inside, after = re.split(r"\n\n+", LOG)
    (acts,) = re.findall(r"\n *action = net.run.*\n", WALK)
    code = WALK.replace("try:\n", f"{before}\ntry:\n").replace(acts, f"{acts}{inside}\n") + after
    export_command.main([request.param, f"--out={tmp_path}/policy.onnx", "--joint-order=unitree"])
    monkeypatch.chdir(tmp_path)
    body = body_of(at_motors(policy_source.load(request.param)[0]))
    return lambda steps, broken=lambda step: None: drive(monkeypatch, code, body, steps, broken)


def drive(monkeypatch, code, body, steps, broken, data=None, command=AHEAD, **more):
    """`code` drives `body` in C MuJoCo, in `data`; `more` are functions of `my_robot` beside the usual.

    The button is pressed after `steps`; before, `broken(step)` is called. Returns where the base was
    [steps, 3], whether the robot fell, and how often it was told to damp.
    """
    policy = body.policy
    data = mujoco.MjData(body.model) if data is None else data
    episode.reset(body, data)
    path, fell, damped, held = [], [], [], data.qpos[:7].copy()

    def read():
        qpos, qvel = episode.coordinates(body, data)
        com = body.model.body_ipos[body.base_body]
        _, velocity, gyro = observe.base_motion(qpos, qvel, com)
        joints = dict(q=qpos[7:], qd=qvel[6:])
        return types.SimpleNamespace(**joints, quat=qpos[3:7], gyro=gyro, velocity=velocity)

    def send(target, kp, kd):
        assert (kp == policy.kp).all() and (kd == policy.kd).all() and not damped
        torque = actuators.pd(target, data.qpos[body.joint_q], data.qvel[body.joint_v], kp, kd)
        assert (np.abs(torque) <= policy.effort_limit + 1e-9).all()
        broken(len(path))
        action = (target - policy.default_pose) / policy.action_scale
        fell.append(episode.step(body, data, action)[1])
        if len(path) < 150 and len(body.foot_names) == 2:
            # a biped does not stand by itself: a rope
            data.qpos[:7], data.qvel[:6] = held, 0
        path.append(data.qpos[:3].copy())

    robot = types.ModuleType("my_robot")
    robot.__dict__.update(
        read=read,
        send=send,
        stick=lambda: command,
        stop=lambda: len(path) >= steps,
        damp=lambda: damped.append(True),
        **more,
    )
    monkeypatch.setitem(sys.modules, "my_robot", robot)
    monkeypatch.setattr(time, "sleep", lambda seconds: None)
    try:
        exec(code, {})
    except InterruptedError:
        damped.append(False)
    return np.array(path), any(fell), damped


def test_the_loop_walks_in_c_mujoco(loop):
    """It ramps in for 3 s, walks ahead for 10 s, and damps when the button is pressed."""
    path, fell, damped = loop(650)
    assert len(path) == 650 and not fell and damped == [True]
    assert np.abs(path[149][:2]).max() < 0.05  # m: it stands where it was
    assert path[-1][0] > 5.0


def test_what_the_loop_logs_is_a_log_of_that_robot(loop, tmp_path, bundled):
    """With the lines for that: 10 s of walking, in the motors' order; the entries are the policy's."""
    config = config_lib.validate(config_lib.load("go1:logs_deploy"))
    config, robot = motors.fitted(config, robot_lib.load("go1"))
    loop(700)
    about = json.loads(str(np.load(tmp_path / "walked.npz")["about"]))
    if about["robot"] != "go1":
        pytest.skip("a biped's policy sees a gait clock, which no log tells")
    log = log_file.load(str(tmp_path / "walked.npz"), robot, config)
    assert len(log.goes_on) == 550 and log.goes_on[:-1].all() and not log.fell.any()
    readings = log.readings
    assert np.linalg.norm(readings["linear_velocity"][100:, :2] - AHEAD[:2], axis=1).mean() < 0.15
    layout = logged.view.make("onboard", 5, 12)
    views = logged.view.views(layout)
    assert views is not None
    seen = logged.of_log(log, layout).obs[:, views.actor]
    act = policy_file.actor(bundled.params, bundled.activation)
    np.testing.assert_allclose(act(seen), readings["action"], atol=1e-3)


def test_the_loop_damps_whatever_happens(loop):
    """An error of the SDK in the middle of a step: damped, then raised."""

    def broken(step):
        if step == 20:
            raise InterruptedError("no answer")

    path, _, damped = loop(30, broken)
    assert len(path) == 20 and damped == [True, False]


def test_the_yaml_is_what_the_onnx_file_needs_beside_it(tmp_path):
    """Read by a YAML reader: joints by their motors, and terms that fill `obs` in order."""
    yaml = pytest.importorskip("yaml")
    for suffix in ("onnx", "yaml"):
        out = tmp_path / f"policy.{suffix}"
        export_command.main(["go2_deploy", f"--out={out}", "--joint-order=isaaclab"])
    told = yaml.safe_load((tmp_path / "policy.yaml").read_text())
    net = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    facts = {k: json.loads(v) for k, v in net.get_modelmeta().custom_metadata_map.items()}
    # as unitree_rl_lab writes it for a Go2
    assert told["joint_ids_map"] == [3, 0, 9, 6, 4, 1, 10, 7, 5, 2, 11, 8]
    assert [facts["joint_names"].index(MOTORS[m]) for m in told["joint_ids_map"]] == list(range(12))
    assert (
        told["step_dt"] == facts["control_dt"]
        and told["default_joint_pos"] == facts["default_pose"]
    )
    widths = [len(term["scale"]) * term["history_length"] for term in told["observations"].values()]
    rows = facts["observation_table"]
    assert widths == [row["stop"] - row["start"] for row in rows]
    assert sum(widths) == net.get_inputs()[0].shape[1] == 225


def test_a_policy_that_sees_its_velocity_has_no_yaml(tmp_path, capsys):
    with pytest.raises(SystemExit):
        export_command.main(["go1", f"--out={tmp_path}/a.yaml"])
    said = capsys.readouterr().err
    assert "a deploy.yaml has no linear_velocity" in said and "go1_deploy" in said
    assert not list(tmp_path.iterdir())


# ---- a height scan


@pytest.fixture(scope="module")
def rough():
    """The bundled Go2 of rough ground, its joints in the order of its motors."""
    return at_motors(policy_source.load("go2_rough")[0])


@pytest.fixture(scope="module")
def page_scan():
    """What the page's code for a scan defines."""
    defined = {}
    exec(SCAN, defined)
    return types.SimpleNamespace(**defined)


def test_on_stairs_the_loop_sees_and_does_what_play_would(rough, page_scan, tmp_path, monkeypatch):
    """Up the stairs of a pit, in a curve: at each step the observation and the action of
    `episode`, of the same state."""
    export_command.main(["go2_rough", f"--out={tmp_path}/policy.onnx", "--joint-order=unitree"])
    monkeypatch.chdir(tmp_path)
    calls, expected = [], []

    class Recorded(onnxruntime.InferenceSession):
        def run(self, output_names, input_feed, run_options=None):
            out = super().run(output_names, input_feed, run_options)
            calls.append((input_feed["obs"][0], np.asarray(out[0])[0]))
            return out

    monkeypatch.setattr(onnxruntime, "InferenceSession", Recorded)
    field = policy_source.ground(rough, "pit_stairs:0.4")
    body, command = body_of(rough, field), np.array([0.8, 0.1, 0.15])
    data, act = mujoco.MjData(body.model), policy_file.actor(rough.params, rough.activation)

    def look(step):
        last = calls[step - 151][1] if step > 150 else np.zeros(12)
        see = observe.memory(rough.observation, rough.history)
        whole = see(episode.look(body, data, command, last)), episode.seen(body, data)
        expected.append(np.concatenate(whole))

    def scan():
        place = field.heights, field.corner, field.cell, data.qpos[:3], data.qpos[3:7]
        return page_scan.height_scan(*place)

    path, fell, damped = drive(monkeypatch, WALK, body, 450, look, data, command, scan=scan)
    assert not fell and damped == [True] and len(calls) == 300
    assert path[-1, 2] - path[149, 2] > 0.3 and np.ptp(path[150:, 1]) > 0.5  # m: up, and in a curve
    found, wanted = np.array([obs for obs, _ in calls]), np.array(expected[150:])
    assert found.shape[1] == 235 and (np.ptp(found[:, 48:], axis=1) > 0.2).mean() > 0.5
    np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-6)
    actions = np.array([action for _, action in calls])
    np.testing.assert_allclose(actions, act(wanted.astype(np.float32)), atol=1e-4)


def test_a_scan_that_the_robot_lacks_is_refused_in_one_line(rough, tmp_path, monkeypatch):
    """Before anything is read or sent."""
    export_command.main(["go2_rough", f"--out={tmp_path}/policy.onnx", "--joint-order=unitree"])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as no:
        drive(monkeypatch, WALK, body_of(rough), 5, lambda step: pytest.fail("sent"))
    assert "\n" not in str(no.value) and '"A height scan"' in str(no.value)
    assert "\n## A height scan\n" in PAGE


def test_a_scan_of_nan_is_a_dead_sensor(rough, tmp_path, monkeypatch):
    export_command.main(["go2_rough", f"--out={tmp_path}/policy.onnx", "--joint-order=unitree"])
    monkeypatch.chdir(tmp_path)
    scan = lambda: np.full(187, np.nan)  # noqa: E731
    path, _, damped = drive(monkeypatch, WALK, body_of(rough), 5, lambda step: None, scan=scan)
    assert len(path) == 0 and damped == [True]


def test_the_pages_scan_is_that_of_training(rough, page_scan):
    """At any pose, tilted and turned, on boxes; the points in that order, and where the page's table says."""
    np.testing.assert_allclose(page_scan.GRID, scan.points(), atol=1e-12)
    text = PAGE.split("## A height scan")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (\d+) \| (\S+) \| (\S+) \|$", text, re.M)
    assert len(rows) == 6
    for number, x, y in rows:
        np.testing.assert_allclose(scan.points()[int(number)], [float(x), float(y)], atol=1e-12)
        assert int(number) == round(11 * (10 * float(x) + 8) + 10 * float(y) + 5)
    field, rng = policy_source.ground(rough, "boxes:1"), np.random.default_rng(0)
    body = body_of(rough, field)
    data = mujoco.MjData(body.model)
    for _ in range(50):
        quat = rng.normal(size=4) * [1, 0.1, 0.1, 1]
        data.qpos[:3], data.qpos[3:7] = rng.uniform(-3, 3, 3), quat / np.linalg.norm(quat)
        place = field.heights, field.corner, field.cell, data.qpos[:3], data.qpos[3:7]
        np.testing.assert_allclose(
            page_scan.height_scan(*place), episode.seen(body, data), atol=1e-6
        )


def test_where_the_map_has_nothing_a_point_reads_as_the_nearest_that_is_known(page_scan):
    """In an unknown cell, and beyond a map that ends between two points; NaN where nothing is known."""
    corner, cell, level = (
        (-1.0, -1.0),
        0.05,
        np.array([1.0, 0.0, 0.0, 0.0]),
    )  # 2 m around the origin
    slope = np.tile(0.1 * np.linspace(-1, 1, 41)[:, None], (1, 41))
    x = page_scan.GRID[:, 0]
    place, found = np.zeros(3), np.zeros(187)
    for away, seen in ((0.55, np.minimum(x, 0.4)), (-0.55, np.maximum(x, -0.4)), (0.0, x)):
        place = np.array([away, 0.0, 0.3])
        found = page_scan.height_scan(slope, corner, cell, place, level)
        np.testing.assert_allclose(found, -0.2 - 0.1 * (seen + away), atol=1e-9)
    slope[20, 20] = np.nan
    holed = page_scan.height_scan(slope, corner, cell, place, level)
    np.testing.assert_allclose(np.delete(holed, 93), np.delete(found, 93), atol=1e-9)
    assert min(abs(holed[93] - found[[82, 92, 94, 104]])) < 1e-9
    assert np.isnan(page_scan.height_scan(slope * np.nan, corner, cell, place, level)).all()


def test_what_a_flat_floor_and_a_box_must_read(page_scan):
    """The page's numbers, of each bundled robot in its default pose; and where the box is seen."""
    table = PAGE[PAGE.index("| all numbers (m)") :].splitlines()[:4]
    names, _, placed, held = (line.strip("| ").split(" | ") for line in table)
    for column, name in enumerate(names[1:], 1):
        policy = policy_source.load(f"{name.lower().replace('-', '_')}_rough")[0]
        body = body_of(policy)
        data = mujoco.MjData(body.model)
        episode.reset(body, data)
        data.qpos[body.joint_q] = policy.default_pose
        mujoco.mj_forward(body.model, data)
        data.qpos[2] -= episode.foot_heights(body, data).min()
        np.testing.assert_allclose(episode.seen(body, data), float(placed[column]), atol=0.006)
        for _ in range(150):
            episode.step(body, data, np.zeros(12))
        np.testing.assert_allclose(episode.seen(body, data), float(held[column]), atol=0.006)
    floor = np.zeros((81, 81))  # 4 m around the origin
    floor[49:52, 45:48] = 0.1
    for degrees, number in ((0, 151), (31, 159)):
        assert f"number {number}" in " ".join(PAGE.split())
        half = np.deg2rad(degrees) / 2
        quat = np.array([np.cos(half), 0, 0, np.sin(half)])
        found = page_scan.height_scan(floor, (-2.0, -2.0), 0.05, np.array([0, 0, 0.33]), quat)
        assert found.argmin() == number and found.min() == pytest.approx(-0.27)
