"""What a run writes: rows in order, numbers that come back, files that are whole or not there."""

import errno
import re
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from dynappo import config as config_lib
from dynappo.run import log


def metrics(iterations=4, seeds=0, first=1):
    """Metrics as the trainer makes them; before the third iteration no episode has ended."""
    rng = np.random.default_rng(first)
    shape = (iterations, seeds) if seeds else (iterations,)
    index = np.arange(first, first + iterations, dtype=np.int32)
    out = {
        "value_loss": rng.random(shape).astype(np.float32),
        "episode_return": rng.normal(size=shape).astype(np.float32),
        "reward_action_rate": -rng.random(shape).astype(np.float32),
        "n_synthetic": index % 3,
        "n_real": 16 - index % 3,
        "iteration": index,
        "seconds": 0.25 * index,
        "sim_steps": np.int64(4_000_000_000) * index,  # more than 32 bits hold
    }
    out["episode_return"][:2] = np.nan
    return out


def test_there_is_one_row_an_iteration_and_its_columns_are_ordered():
    """First what one looks for, then all other metrics by name."""
    table = log.rows(metrics())
    assert len(table) == 4
    assert list(table[0]) == [
        "iteration",
        "sim_steps",
        "seconds",
        "episode_return",
        "n_real",
        "n_synthetic",
        "reward_action_rate",
        "value_loss",
    ]
    assert [row["iteration"] for row in table] == [1, 2, 3, 4]


def test_with_seeds_there_is_one_row_an_iteration_and_seed():
    """Seeds of an iteration follow each other; what they share is repeated."""
    data = metrics(seeds=3)
    table = log.rows(data)
    assert [(row["iteration"], row["seed"]) for row in table] == [
        (i, s) for i in (1, 2, 3, 4) for s in (0, 1, 2)
    ]
    for row in table:
        i, s = row["iteration"] - 1, row["seed"]
        assert row["value_loss"] == data["value_loss"][i, s]
        assert row["sim_steps"] == data["sim_steps"][i]


@pytest.mark.parametrize("seeds", [0, 3])
def test_a_file_appended_in_two_chunks_reads_back_as_one(tmp_path, seeds):
    """Six digits of every number, all digits of counts, NaN as NaN, and seeds as columns."""
    path = tmp_path / "metrics.csv"
    chunks = [metrics(2, seeds), metrics(2, seeds, first=3)]
    for chunk in chunks:
        log.append_csv(path, log.rows(chunk))
    back = log.read_csv(path, max(seeds, 1))
    assert set(back) == set(chunks[0])
    for name, column in back.items():
        expected = np.concatenate([chunk[name] for chunk in chunks])
        assert column.shape == expected.shape, name
        np.testing.assert_allclose(column, expected, 1e-5, err_msg=name)
    np.testing.assert_array_equal(back["sim_steps"], np.arange(1, 5) * 4_000_000_000)


def test_the_header_is_written_once_and_undefined_numbers_are_empty(tmp_path):
    """Plain text that any tool reads: counts without a point, no "nan"."""
    path = tmp_path / "metrics.csv"
    log.append_csv(path, log.rows(metrics(2)))
    log.append_csv(path, log.rows(metrics(2, first=3)))
    lines = path.read_text().splitlines()
    assert len(lines) == 5
    assert lines[0].startswith("iteration,sim_steps,seconds,episode_return")
    assert lines[1].startswith("1,4000000000,0.25,,15,1,")
    assert "nan" not in path.read_text()
    assert sum(line.startswith("iteration") for line in lines) == 1


def scheduled(iterations):
    """What the schedule says of `metrics(iterations)`."""
    found = metrics(iterations)
    return {name: found[name] for name in ("iteration", "sim_steps")}


def test_rows_after_the_checkpoint_are_cut(tmp_path):
    """Rows up to the iteration keep every byte, header included, and come back."""
    path = tmp_path / "metrics.csv"
    log.append_csv(path, log.rows(metrics(12, seeds=2)))
    before = path.read_bytes().splitlines(keepends=True)
    for iteration, kept in ((10, 20), (3, 6), (3, 6)):
        back = log.resume_csv(path, scheduled(iteration), 2, pytest.fail)
        assert path.read_bytes() == b"".join(before[: 1 + kept])
        np.testing.assert_array_equal(back["iteration"], np.arange(1, iteration + 1))
        np.testing.assert_allclose(
            back["value_loss"], metrics(12, seeds=2)["value_loss"][:iteration], 1e-5
        )
    assert [p.name for p in tmp_path.iterdir()] == ["metrics.csv"]


def test_a_line_that_was_cut_off_while_writing_is_dropped(tmp_path):
    """A run killed in the middle of a line resumes without half a row: "1" is no iteration 12."""
    path = tmp_path / "metrics.csv"
    log.append_csv(path, log.rows(metrics(12)))
    whole = path.read_text()
    begin = whole.index("12,480")
    for written in ("12,480", "12", "1"):
        path.write_text(whole[:begin] + written)
        back = log.resume_csv(path, scheduled(10), 1, pytest.fail)
        np.testing.assert_array_equal(back["iteration"], np.arange(1, 11))


DAMAGE = {  # what happened to the text of 12 rows -> iterations that are lost of the first 10
    "the end is missing": (lambda text: text[: text.index("\n8,") + 1], [8, 9, 10]),
    "the middle is missing": (
        lambda text: text.replace(text[text.index("\n3,") : text.index("\n6,")], ""),
        [3, 4, 5],
    ),
    "a cell is no number": (lambda text: text.replace("\n4,", "\n4,x", 1), [4]),
    "a cell is infinite": (lambda text: re.sub("(?m)^4,[^,]*,[^,]*", "4,160,inf", text), [4]),
    "a row is longer": (lambda text: text.replace("\n7,", "\n7,7,", 1), [7]),
    "NUL": (lambda text: text.replace("\n2,", "\n\0", 1), [2]),
    "not text": (lambda text: text.replace("\n9,", "\n\udcff,", 1), [9]),
    "only the header": (lambda text: text[: text.index("\n") + 1], list(range(1, 11))),
    "empty": (lambda text: "", list(range(1, 11))),
    "something else": (lambda text: "to be or not to be\n" * 3, list(range(1, 11))),
    "gone": (None, list(range(1, 11))),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_rows_that_are_lost_are_said_to_be_and_what_follows_from_the_schedule_is_right(
    tmp_path, damage
):
    """The steps are those that were taken; what was there is kept; the rows that are whole stay."""
    path, said = tmp_path / "metrics.csv", []
    log.append_csv(path, log.rows(metrics(12)))
    rows = path.read_text().splitlines()
    change, lost = DAMAGE[damage]
    path.unlink() if change is None else path.write_bytes(
        change(path.read_text()).encode(errors="surrogateescape")
    )
    before = path.read_bytes() if path.exists() else None
    back = log.resume_csv(path, scheduled(10), 1, said.append)
    np.testing.assert_array_equal(back["sim_steps"], metrics(10)["sim_steps"])
    np.testing.assert_array_equal(back["iteration"], np.arange(1, 11))
    expected = metrics(10)["value_loss"].copy()
    expected[np.array(lost) - 1] = np.nan
    if "value_loss" in back:  # not where even its name is lost
        np.testing.assert_allclose(back["value_loss"], expected, 1e-5)
        now = path.read_text().splitlines()
        assert all(now[i] == rows[i] for i in range(1, 11) if i not in lost)
    (line,) = said
    assert f"rows of {len(lost)} iterations, from {lost[0]} to {lost[-1]}, are lost" in line
    if before is not None:
        assert (tmp_path / "metrics.csv.damaged").read_bytes() == before
        assert "kept as" in line
    log.resume_csv(path, scheduled(10), 1, pytest.fail)  # it is whole now


def test_a_full_disk_while_damaged_rows_are_mended_costs_none(tmp_path, monkeypatch):
    """The file is as it was, and the same call then mends it."""
    path = tmp_path / "metrics.csv"
    log.append_csv(path, log.rows(metrics(12)))
    path.write_text(path.read_text().replace("\n4,", "\n4,x", 1))
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as disk, pytest.raises(OSError, match="No space"):
        disk.setattr("os.replace", full)
        log.resume_csv(path, scheduled(10), 1, str)
    assert path.read_bytes() == before and not list(tmp_path.glob("*.part"))
    back = log.resume_csv(path, scheduled(10), 1, str)
    assert np.flatnonzero(np.isnan(back["value_loss"])).tolist() == [3]


# ---- more columns, full disks, other logs


def test_a_new_column_is_added_to_the_rows_that_are_there(tmp_path):
    """Evaluation began later, or was asked for when the run went on."""
    path = tmp_path / "metrics.csv"
    log.append_csv(path, log.rows(metrics(2)))
    evaluated = metrics(2, first=3) | {"eval_return": np.array([np.nan, 7.5])}
    log.append_csv(path, log.rows(evaluated))
    log.append_csv(path, log.rows(metrics(1, first=5)))
    back = log.read_csv(path)
    np.testing.assert_array_equal(back["iteration"], [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(back["eval_return"], [np.nan] * 3 + [7.5, np.nan])
    np.testing.assert_allclose(back["value_loss"][:2], metrics(2)["value_loss"], 1e-5)
    assert not list(tmp_path.glob("*.part"))


def test_rows_that_could_not_be_written_are_written_with_the_next_and_whole(tmp_path, monkeypatch):
    """The disk is full in the middle of a row; nothing of it stays in the file."""
    path = tmp_path / "metrics.csv"
    sink = log.csv_sink(path)
    sink.write(log.rows(metrics(1)))
    before = path.read_bytes()
    number = log._number

    def full(value):
        if value == 3:  # in the second of the two rows
            raise OSError(errno.ENOSPC, "No space left on device")
        return number(value)

    monkeypatch.setattr(log, "_number", full)
    with pytest.raises(OSError, match="No space"):
        sink.write(log.rows(metrics(2, first=2)))
    assert path.read_bytes() == before
    monkeypatch.setattr(log, "_number", number)
    sink.write(log.rows(metrics(1, first=4)))
    np.testing.assert_array_equal(log.read_csv(path)["iteration"], [1, 2, 3, 4])


def test_chunks_are_joined_with_nan_where_one_lacks_a_column():
    chunks = [metrics(2), metrics(2, first=3) | {"eval_return": np.array([np.nan, 1.0])}]
    joined = log.join(chunks)
    np.testing.assert_array_equal(joined["iteration"], [1, 2, 3, 4])
    np.testing.assert_array_equal(joined["eval_return"], [np.nan, np.nan, np.nan, 1.0])


def events(folder):
    """`{(tag, step): value}` of TensorBoard's files, in the order of their making."""
    from tensorboardX.proto.event_pb2 import Event

    out, restarts = {}, []
    for path in sorted(folder.glob("events.*"), key=lambda p: p.stat().st_mtime_ns):
        data, at = path.read_bytes(), 0
        while at < len(data):  # a record: length, its checksum, the event, its checksum
            size = int.from_bytes(data[at : at + 8], "little")
            event = Event.FromString(data[at + 12 : at + 12 + size])
            at += size + 16
            if event.HasField("session_log"):
                restarts.append(event.step)
            for value in event.summary.value:
                out[value.tag, event.step] = value.simple_value
    return out, restarts


def test_tensorboard_gets_every_finite_number_of_every_row(tmp_path):
    sink = log.tensorboard_sink(tmp_path, 0)
    sink.write(log.rows(metrics()))
    sink.close()
    found, restarts = events(tmp_path)
    data = metrics()
    assert restarts == []
    assert found["reward/action_rate", 4] == pytest.approx(data["reward_action_rate"][3])
    assert found["train/value_loss", 1] == pytest.approx(data["value_loss"][0])
    assert ("train/episode_return", 2) not in found and ("train/episode_return", 3) in found
    assert {step for _, step in found} == {1, 2, 3, 4}


def test_a_run_that_goes_on_takes_back_the_events_after_its_checkpoint(tmp_path):
    sink = log.tensorboard_sink(tmp_path, 2)
    sink.write(log.rows(metrics(2, first=3, seeds=2)))
    sink.close()
    found, restarts = events(tmp_path)
    assert restarts == [3]
    assert ("train/value_loss/seed0", 3) in found and ("train/value_loss/seed1", 4) in found


def test_weights_and_biases_gets_the_rows_and_the_same_run_when_it_goes_on(tmp_path, monkeypatch):
    """A stand-in for the library, which needs an account; the id stays that of the workdir."""
    calls = []

    class Run:
        def log(self, row, step):
            calls.append((step, row))

        def finish(self):
            calls.append("finished")

    def init(**options):
        calls.append(options)
        return Run()

    monkeypatch.setitem(sys.modules, "wandb", SimpleNamespace(init=init, __spec__=object()))
    config = config_lib.load("configs/go1.py")
    config.run.wandb = "walking"
    ids = []
    for _ in range(2):
        calls.clear()
        sink = log.wandb_sink(config_lib.validate(config), tmp_path)
        sink.write(log.rows(metrics(2)))
        sink.close()
        ids.append(calls[0]["id"])
        assert calls[0]["project"] == "walking" and calls[0]["resume"] == "allow"
        assert calls[0]["config"]["robot"] == "go1"
        assert [c[0] for c in calls[1:3]] == [1, 2] and calls[3] == "finished"
        assert calls[2][1]["train/value_loss"] == pytest.approx(metrics(2)["value_loss"][1])
    assert ids[0] == ids[1]


def test_asking_for_weights_and_biases_without_it_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "wandb", None)
    config = config_lib.load("configs/go1.py")
    config.run.wandb = "walking"
    with pytest.raises(config_lib.ConfigError, match="run.wandb is 'walking', but .*not installed"):
        log.check_wandb(config)


# ---- evaluations, and what fails


@pytest.mark.parametrize(
    ("returns", "last"),
    [
        (None, None),
        ([np.nan, np.nan], None),
        ([np.nan, 3.5, np.nan, 4.5, np.nan], 4.5),
        ([[1.0, 2.0], [np.nan, np.nan]], [1.0, 2.0]),
        ([[1.0, 2.0], [np.nan, 5.0]], [np.nan, 5.0]),  # nobody of the first seed lived
    ],
)
def test_the_last_evaluation_is_that_of_the_last_row_that_has_one(returns, last):
    """And of other numbers of it those that say which policy is the best."""
    columns = {} if returns is None else {"eval_return": np.array(returns)}
    crossed = {"eval_crossed": np.array(returns) / 10} if returns else {}
    for more, names in (({}, {"return"}), (crossed, {"return", "crossed"})):
        found = log.last_evaluation(columns | more | {"eval_fall_rate": np.ones(9)})
        assert found.keys() == (set() if last is None else names)
        for name, value in found.items():
            expected = np.array(last) / (10 if name == "crossed" else 1)
            np.testing.assert_array_equal(value, expected)


def test_what_fails_is_told_in_one_line_and_training_goes_on():
    def fail(error):
        raise error

    said = []
    for error in (OSError(28, "No space left on device"), ValueError("first line\nsecond"), None):
        log.attempt("metrics.csv", lambda e=error: fail(e) if e else None, said.append)
    assert said == [
        "metrics.csv could not be written (No space left on device); training goes on",
        "metrics.csv could not be written (first line); training goes on",
    ]


@pytest.mark.parametrize("tensorboard", [False, True])
def test_what_was_asked_for_is_opened_and_closed(tmp_path, tensorboard):
    """Also where the run is interrupted."""
    config = config_lib.load("configs/go1.py")
    config.run.tensorboard = tensorboard
    names = ["metrics.csv"] + ["TensorBoard's events"] * tensorboard
    with pytest.raises(KeyboardInterrupt), log.opened(config, tmp_path, 0, pytest.fail) as sinks:
        assert [sink.name for sink in sinks] == names
        for sink in sinks:
            sink.write(log.rows(metrics(2)))
        raise KeyboardInterrupt
    assert len(log.read_csv(tmp_path / "metrics.csv")["iteration"]) == 2
    assert len(list(tmp_path.glob("events.*"))) == tensorboard


def test_the_return_at_the_end_is_of_the_iterations_in_which_an_episode_ended():
    """Of the last ten; a seed in which none has ended has none."""
    returns = np.full((12, 3), np.nan)
    returns[0], returns[[4, 11], 0], returns[2:, 1] = 99.0, (0.5, 1.5), np.arange(10.0)
    np.testing.assert_array_equal(log.at_the_end(returns), [1.0, 4.5, np.nan])
    assert log.at_the_end(np.array([np.nan, 0.01, np.nan])) == 0.01
