"""Notifications to the service manager: real datagrams on a real socket."""

import logging
import os
import re
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fakes.service_manager import SOON_S, Manager

from rig.clock import Instant
from rig.daemon.heartbeat import Heartbeats, watchdog
from rig.daemon.notify import Notifier, notifier_of
from rig.daemon.state import Event, Subscription
from rig.errors import RigError


@pytest.fixture(params=["path", "abstract"])
def manager(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Manager]:
    abstract = f"@skyfix-test-{secrets.token_hex(8)}"
    opened = Manager(str(tmp_path / "notify") if request.param == "path" else abstract)
    yield opened
    opened.socket.close()


def test_each_state_is_one_datagram(manager: Manager) -> None:
    notifier = Notifier(manager.address)
    notifier.ready("no fix yet")
    notifier.status("fix 46.19900 N")
    before_us = time.monotonic_ns() // 1000
    notifier.reloading()
    notifier.progress()
    notifier.stopping("parking the head")
    assert manager.heard() == "READY=1\nSTATUS=no fix yet"
    assert manager.heard() == "STATUS=fix 46.19900 N"
    first, second, third = manager.heard().split("\n")
    assert (first, third) == ("RELOADING=1", "STATUS=reading the configuration again")
    assert before_us <= int(second.removeprefix("MONOTONIC_USEC=")) <= time.monotonic_ns() // 1000
    assert manager.heard() == "WATCHDOG=1"
    assert manager.heard() == "STOPPING=1\nSTATUS=parking the head"


def test_a_status_of_several_lines_sets_no_other_key(manager: Manager) -> None:
    Notifier(manager.address).status("compass: gone\nSTOPPING=1\r\n in °")
    assert manager.heard() == "STATUS=compass: gone STOPPING=1 in °"


def test_without_a_manager_nothing_happens() -> None:
    for environment in ({}, {"NOTIFY_SOCKET": ""}):
        notifier = notifier_of(environment)
        assert notifier.watchdog_s is None
        notifier.ready("")
        notifier.progress()


def test_a_missing_manager_is_logged_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    notifier = Notifier(str(tmp_path / "absent"))
    notifier.progress()
    notifier.progress()
    assert [record.getMessage() for record in caplog.records] == [
        "the service manager cannot be told WATCHDOG=1: [Errno 2] No such file or directory"
    ]
    manager = Manager(str(tmp_path / "absent"))
    notifier.progress()
    assert manager.heard() == "WATCHDOG=1"
    manager.socket.close()
    notifier.progress()
    assert len(caplog.records) == 2


def test_a_manager_that_reads_nothing_does_not_hold_the_daemon_up(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rig.daemon.notify.SEND_TIMEOUT_S", 0.05)
    manager = Manager(str(tmp_path / "busy"))
    notifier = Notifier(manager.address)
    while not caplog.records:
        notifier.status("x" * 1000)
    assert "timed out" in caplog.text
    manager.socket.close()


@pytest.mark.parametrize(
    ("variables", "watchdog_s"),
    [
        ({"WATCHDOG_USEC": "30000000"}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getpid())}, 30.0),
        ({"WATCHDOG_USEC": "30000000", "WATCHDOG_PID": str(os.getppid())}, None),
        ({"WATCHDOG_PID": str(os.getpid())}, None),
    ],
)
def test_the_watchdog_of_the_environment(variables: dict[str, str], watchdog_s: float | None) -> None:
    assert notifier_of(variables).watchdog_s == watchdog_s


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"NOTIFY_SOCKET": "vsock:2:1234"}, "NOTIFY_SOCKET: 'vsock:2:1234' is no address of a socket"),
        ({"WATCHDOG_USEC": "30s"}, "WATCHDOG_USEC: '30s' is no time; give microseconds"),
        ({"WATCHDOG_USEC": "0"}, "WATCHDOG_USEC: '0' is no time"),
    ],
)
def test_variables_that_make_no_sense(variables: dict[str, str], said: str) -> None:
    with pytest.raises(RigError, match=said):
        notifier_of(variables)


def test_the_watchdog_is_kicked_while_every_loop_gets_on(manager: Manager) -> None:
    heartbeats = Heartbeats()
    with heartbeats.watched("capture", 600.0), heartbeats.watched("search", 600.0):
        begun = time.monotonic()
        with watchdog(heartbeats, Notifier(manager.address, watchdog_s=0.3)):
            assert [manager.heard() for _ in range(4)] == ["WATCHDOG=1"] * 4
        assert time.monotonic() - begun >= 0.3


def loop_that_waits(heartbeats: Heartbeats, wait: Subscription, done: threading.Event) -> None:
    """A loop that does not get on until there is an event."""
    with heartbeats.watched("capture", 0.05):
        wait.get(SOON_S)
        heartbeats.beat("capture", within_s=SOON_S)
        done.wait(SOON_S)


@pytest.fixture
def in_thread() -> Iterator[Callable[..., None]]:
    threads: list[threading.Thread] = []

    def start(function: Callable[..., None], *arguments: object) -> None:
        threads.append(threading.Thread(target=function, args=arguments))
        threads[-1].start()

    yield start
    for thread in threads:
        thread.join()


def test_a_loop_that_hangs_is_named_and_the_watchdog_left_alone(
    manager: Manager, caplog: pytest.LogCaptureFixture, in_thread: Callable[..., None]
) -> None:
    caplog.set_level(logging.WARNING)
    heartbeats, notifier = Heartbeats(), Notifier(manager.address, watchdog_s=0.15)
    wait, done = Subscription(), threading.Event()
    notifier.ready("fix 46.2 N")
    with heartbeats.watched("publish", 600.0):
        in_thread(loop_that_waits, heartbeats, wait, done)
        while not heartbeats.stalled():
            time.sleep(0.01)
        manager.read_all()
        with watchdog(heartbeats, notifier):
            heard = [manager.heard() for _ in range(3)]
            wait.put(Event(1, "log", Instant.now(), {}))
            manager.hears("STATUS=fix 46.2 N")
            manager.hears("WATCHDOG=1")
            done.set()
    for each in heard:
        assert re.fullmatch(
            r"STATUS=capture hangs: nothing for \d+ s, at rig\.daemon\.state line \d+, in get", each
        )
    hangs, gets_on = (record.getMessage() for record in caplog.records)
    assert hangs.startswith("capture hangs: nothing for ")
    assert gets_on == "capture gets on again"


def test_a_step_may_take_longer_than_the_loop() -> None:
    heartbeats = Heartbeats()
    with heartbeats.watched("capture", 0.01):
        heartbeats.beat("capture", within_s=600.0)
        time.sleep(0.02)
        assert not heartbeats.stalled()
        heartbeats.beat("capture")
        time.sleep(0.02)
        assert [each.name for each in heartbeats.stalled()] == ["capture"]


def test_a_loop_that_ends_in_order_is_not_missed() -> None:
    heartbeats = Heartbeats()
    with heartbeats.watched("capture", 0.001):
        pass
    time.sleep(0.005)
    assert not heartbeats.stalled()


def test_a_loop_ended_by_an_error_is_stalled_until_restarted() -> None:
    heartbeats = Heartbeats()
    with pytest.raises(ZeroDivisionError), heartbeats.watched("search", 600.0):
        _ = 1 // 0
    assert [str(each) for each in heartbeats.stalled()] == [
        "search ended by ZeroDivisionError: integer division or modulo by zero"
    ]
    with heartbeats.watched("search", 600.0):
        assert not heartbeats.stalled()


def test_two_loops_of_one_name() -> None:
    heartbeats = Heartbeats()
    with (
        heartbeats.watched("search", 600.0),
        pytest.raises(ValueError, match="two loops are called 'search'"),
        heartbeats.watched("search", 600.0),
    ):
        pass
    assert not heartbeats.stalled()


def test_after_stopping_the_watchdog_is_not_kicked(manager: Manager) -> None:
    heartbeats, notifier = Heartbeats(), Notifier(manager.address, watchdog_s=0.06)
    with watchdog(heartbeats, notifier):
        manager.hears("WATCHDOG=1")
        notifier.stopping("")
        manager.hears("STOPPING=1\nSTATUS=")
        time.sleep(0.2)
    assert manager.read_all() == []
