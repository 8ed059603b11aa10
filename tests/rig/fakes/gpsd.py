"""gpsd and gpspipe as processes on loopback, and what they report."""

import json
import queue
import socket
import subprocess
import threading
import time
from contextlib import contextmanager
from datetime import datetime

import pytest

SOON_S = 60.0
"""A wait that only a failing test lasts out."""


class Reports:
    """What gpspipe prints, one JSON object a line. ``all`` has what came so far, with the monotonic times of arrival."""

    def __init__(self, process):
        self.all = []
        self._news = queue.Queue()
        threading.Thread(target=self._take, args=(process.stdout,), daemon=True).start()

    def _take(self, lines):
        for line in lines:
            try:
                report = json.loads(line)
            except ValueError:
                # gpsd 3.22 forgets a comma in each ATT; anything else has to be seen
                report = {"class": "ATT" if '"class":"ATT"' in line else f"broken: {line}"}
            self.all.append((time.monotonic(), report))
            self._news.put(report)

    def until(self, wanted, seen=None):
        """The next report for which ``wanted`` holds; those before it are added to ``seen``."""
        deadline_s = time.monotonic() + SOON_S
        while (left_s := deadline_s - time.monotonic()) > 0.0:
            try:
                report = self._news.get(timeout=left_s)
            except queue.Empty:
                break
            assert not report["class"].startswith("broken"), report
            if wanted(report):
                return report
            if seen is not None:
                seen.append(report)
        return pytest.fail("gpsd did not report it")


@contextmanager
def running(*command, **options):
    process = subprocess.Popen(command, **options)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(SOON_S)


@contextmanager
def reports_of(program, source):
    """gpsd on this source, on a free port, without a control socket; and gpspipe on gpsd."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    gpsd = running(str(program("gpsd")), "-N", "-n", "-S", str(port), source, stderr=subprocess.DEVNULL)
    with gpsd:
        deadline_s = time.monotonic() + SOON_S
        while time.monotonic() < deadline_s:
            with socket.socket() as knocking:
                if knocking.connect_ex(("127.0.0.1", port)) == 0:
                    break
            time.sleep(0.05)
        pipe = running(str(program("gpspipe")), "-w", f"127.0.0.1:{port}", stdout=subprocess.PIPE, text=True)
        with pipe as process:
            yield Reports(process)


def position(report):
    return report["class"] == "TPV" and report["mode"] >= 2


def no_position(report):
    return report["class"] == "TPV" and report["mode"] == 1


def ellipse(report):
    return report["class"] == "GST" and "major" in report


def time_of(report):
    return datetime.fromisoformat(report["time"])
