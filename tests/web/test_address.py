"""What --serve means, and every mistake in it: of play and of train."""

import socket

import pytest
from answers import mistake, refused

from dynappo.play import command as play_command
from dynappo.train import command as train_command
from dynappo.web import address


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ("127.0.0.1", 8080, False)),
        ("9000", ("127.0.0.1", 9000, True)),
        ("0.0.0.0:80", ("0.0.0.0", 80, True)),
        ("[::]:8080", ("::", 8080, True)),
        ("robot.lab:1234", ("robot.lab", 1234, True)),
    ],
)
def test_an_address_is_of_this_machine_alone_unless_it_names_a_host(text, expected):
    assert address.read(text) == expected


@pytest.mark.parametrize("text", ["0", "65536", "8080x", "127.0.0.1", "localhost:", "-1", "٣"])
def test_what_is_no_port_is_one_line(text):
    assert f"--serve={text!r}: expected a port" in refused(lambda: address.read(text))


def test_without_viser_it_says_what_to_install(monkeypatch):
    monkeypatch.setattr(address, "NEEDED", ("viser", "no_such_package"))
    assert "--serve needs no_such_package: " in (line := refused(address.check, address.read("")))
    assert "[web]" in line


def test_a_named_port_that_is_taken_is_refused_and_none_else(capsys):
    """Before a policy is loaded or a run begins. Else the page of whoever holds it would be steered."""
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        flag = f"--serve={port}"
        for main, argv in (
            (play_command.main, ["go1", flag]),
            (train_command.main, ["--config=go1:laptop", flag]),
        ):
            line = mistake(main, argv, capsys)
            assert (
                f"--serve: port {port} is taken" in line
                and "--serve alone takes a free one" in line
            )
        found = address.free(address.Address("127.0.0.1", port))
        assert found == ({"127.0.0.1"}, found[1]) and found[1] > port


def test_the_flag_may_stand_before_the_name():
    for argv in (["--serve", "go1"], ["go1", "--serve"]):
        flags = play_command.parse(argv)
        assert (flags.what, flags.serve) == ("go1", "")
    assert play_command.parse(["go1", "--serve", "9000"]).serve == "9000"
    assert play_command.parse(["go1"]).serve is None


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["go1", "--serve", "--out=walk.html"], "--serve and --out: expected one of them"),
        (["go1", "--serve=fast"], "--serve='fast': expected a port"),
        (["nothing_here", "--serve"], "no such file or folder"),
    ],
)
def test_a_mistake_of_play_is_one_line_and_status_2(argv, expected, capsys):
    assert expected in mistake(play_command.main, argv, capsys)


def test_training_with_a_page_saves_more_often_unless_told():
    often = train_command.parse(["--config=go1:laptop", "--serve"])
    assert often.serve == "" and often.config.run.checkpoint_every == 20
    told = train_command.parse(
        ["--config=go1:laptop", "--serve", "--config.run.checkpoint_every=50"]
    )
    assert told.config.run.checkpoint_every == 50
    off = train_command.parse(["--config=go1:laptop"])
    assert off.serve is None and off.config.run.checkpoint_every == 100


@pytest.mark.parametrize(
    ("argv", "expected"),
    [
        (["--config=go1:laptop", "--serve=x"], "--serve='x': expected a port"),
        (
            ["--config=go1:laptop", "--serve", "--sweep=ppo.clip_epsilon=0.1,0.2"],
            "--serve shows one run",
        ),
    ],
)
def test_a_mistake_of_train_is_one_line(argv, expected):
    assert expected in refused(lambda: train_command.parse(argv))
