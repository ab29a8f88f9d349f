"""``drivebus demo`` for a new user: an address that logs in once, twelve drives, and eight hours of history."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import pytest

from drivebus.cli.demo.history import HISTORY_HOURS
from drivebus.cli.demo.layout import BUSES

DRIVES = {part.key for bus in BUSES for part in bus.drives}
ONLINE_TIMEOUT_S = 60.0
Demo = tuple[subprocess.Popen[str], dict[str, str]]


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Demo]:
    """Yield a running demo with the address, user and password that it prints."""
    with _running_demo(tmp_path_factory.mktemp("demo") / "log") as running:
        yield running


@contextmanager
def _running_demo(log: Path) -> Iterator[Demo]:
    (log.parent / "tmp").mkdir()
    with log.open("w") as errors:
        own = os.environ | {"TMPDIR": str(log.parent / "tmp")}
        command = [sys.executable, "-m", "drivebus", "demo", "--json", "--lang", "en"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=own)
        try:
            yield process, _printed(process, log) | {"tmp": own["TMPDIR"]}
        finally:
            process.kill()
            process.wait()


def _printed(process: subprocess.Popen[str], log: Path) -> dict[str, str]:
    """Return the printed line of JSON; an address before it would require a password."""
    assert process.stdout is not None
    line = process.stdout.readline()
    assert line.startswith("{"), (line, log.read_text())
    found: dict[str, str] = json.loads(line)
    return found


@pytest.fixture(scope="module")
def browser(demo: Demo) -> Iterator[httpx.Client]:
    """Yield a client that is logged in by the printed address."""
    base, _, code = demo[1]["url"].partition("#login=")
    with httpx.Client(base_url=base, headers={"Origin": base.rstrip("/")}) as client:
        done = client.post("api/v1/login/code", json={"code": code})
        assert done.status_code == 200, done.text
        yield client


def test_the_address_logs_in_once(demo: Demo, browser: httpx.Client) -> None:
    base, _, code = demo[1]["url"].partition("#login=")
    again = httpx.post(f"{base}api/v1/login/code", json={"code": code}, headers={"Origin": base.rstrip("/")})
    assert again.status_code == 401


def test_a_later_login_needs_the_password_and_the_configuration_is_a_file(demo: Demo, browser: httpx.Client) -> None:
    """The page requires the password after an idle time, and the address logs in only once."""
    base, printed = str(browser.base_url).rstrip("/"), demo[1]
    credentials = {"name": printed["user"], "password": printed["password"]}
    again = httpx.post(f"{base}/api/v1/login", json=credentials, headers={"Origin": base})
    assert again.status_code == 200, again.text
    file = browser.get("api/v1/configuration").json()
    assert "[drive.fan-1]" in file["text"]


def test_twelve_drives_of_four_families_on_four_buses_reply(browser: httpx.Client) -> None:
    deadline = time.monotonic() + ONLINE_TIMEOUT_S
    found: dict[str, dict[str, object]] = {}
    while time.monotonic() < deadline and {drive["presence"] for drive in found.values()} != {"online"}:
        found = {drive["id"]: drive for drive in browser.get("api/v1/drives").json()["drives"]}
        time.sleep(0.5)
    assert set(found) == DRIVES and len(DRIVES) == 12
    assert {drive["presence"] for drive in found.values()} == {"online"}
    assert len({drive["model"] for drive in found.values()}) == len({drive["bus"] for drive in found.values()}) == 4


def test_the_demo_starts_with_eight_hours_of_history(browser: httpx.Client) -> None:
    now_ms = int(time.time() * 1000)
    span = {"from_ms": now_ms - int(HISTORY_HOURS * 3_600_000), "to_ms": now_ms}
    found = browser.get("api/v1/history/trend", params={"tags": "spindle-1.output_frequency", **span}).json()
    points = found["series"]["spindle-1.output_frequency"]
    known = [time_ms for time_ms, value in zip(points["t"], points["mean"], strict=True) if value is not None]
    assert known[-1] - known[0] > 0.95 * HISTORY_HOURS * 3_600_000
    assert max(value for value in points["max"] if value is not None) > 10.0
    markers = browser.get("api/v1/history/events", params={**span, "drive": "spindle-1"}).json()["items"]
    assert {"command"} <= {marker["kind"] for marker in markers}


def test_ctrl_c_ends_the_demo_and_leaves_no_process_or_file(demo: Demo) -> None:
    process, printed = demo
    process.send_signal(signal.SIGINT)
    assert process.wait(30) == 0
    assert list(Path(printed["tmp"]).iterdir()) == []


def test_a_closed_terminal_that_is_not_the_standard_input_ends_the_demo_too(tmp_path: Path) -> None:
    """The signal was taken for that of a reload, and the demo went on and held its port."""
    with _running_demo(tmp_path / "log") as (process, printed):
        process.send_signal(signal.SIGHUP)
        assert process.wait(30) == 0
        assert list(Path(printed["tmp"]).iterdir()) == []
