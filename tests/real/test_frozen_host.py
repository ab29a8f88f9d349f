"""SIGSTOP like a frozen virtual machine: afterwards every waiting command has expired, and none is sent."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from real.conftest import Start
from real.recorded_bench import PROCESS_TIMEOUT_S, RecordedPlant, c320, wait_until
from verification.reference.effects import RequestEffect

Plants = Callable[..., RecordedPlant]
FREEZE_S = float(os.environ.get("DRIVEBUS_REAL_FREEZE", "3"))
"""Duration of the freeze: longer than a start command is valid (2 s)."""
DRIVES, LINES = 4, 3


def issued_commands(process: Any) -> list[dict[str, Any]]:
    out, errors = process.communicate(timeout=PROCESS_TIMEOUT_S)
    printed = [json.loads(line) for line in out.splitlines()]
    assert process.returncode == 0, errors
    return [each for each in printed if each["event"] == "ended"]


def test_commands_that_waited_during_a_freeze_expire_and_are_never_sent(plants: Plants, started: Start) -> None:
    """Starts of four drives on a slow line are frozen at three moments and thawed after they have expired."""
    chance = random.Random(1)
    addresses = list(range(1, DRIVES + 1))
    plant = plants(*(c320(4800, addresses=addresses, keypad={}) for _ in range(LINES)))
    hosts = [started("host_process.py", "start", "c320", plant.url(line), DRIVES) for line in range(LINES)]
    for host in hosts:
        assert host.stdout is not None
        assert json.loads(host.stdout.readline())["event"] == "queued"
        time.sleep(chance.uniform(0.0, 0.2))
        host.send_signal(signal.SIGSTOP)
    time.sleep(FREEZE_S)
    plant.settle()
    thawed = time.monotonic()
    for host in hosts:
        host.send_signal(signal.SIGCONT)
    results = [issued_commands(host) for host in hosts]
    plant.settle()
    for line in range(LINES):
        assert [
            request for request in plant.requests(line, since=thawed) if request.effect is not RequestEffect.READ
        ] == []
        moved = {request.address for request in plant.requests(line) if request.effect is RequestEffect.MOTION}
        for each in results[line]:
            assert each["address"] in moved or each.get("error") == "Expired", each
    assert sum(each.get("error") == "Expired" for line in results for each in line) >= LINES, "the freeze came too late"


def test_starts_permitted_and_queued_before_a_freeze_are_never_sent(plants: Plants, started: Start) -> None:
    """Each start has its permit and waits for the line, which a read occupies when the host stops."""
    plant = plants(c320(1200, addresses=list(range(1, DRIVES + 1)), keypad={}))
    host = started("host_process.py", "queue", "c320", plant.url(), DRIVES)
    assert host.stdout is not None
    assert json.loads(host.stdout.readline())["event"] == "queued"
    wait_until(lambda: stopped(host.pid), "the freeze")
    time.sleep(FREEZE_S)
    host.send_signal(signal.SIGCONT)
    results = issued_commands(host)
    plant.settle()
    assert [each["error"] for each in results] == ["bus.permit_expired"] * DRIVES
    assert {each["sent"] for each in results} == {""}
    assert {request.effect for request in plant.requests()} == {RequestEffect.READ} and plant.motor_changes() == []


def stopped(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "T"
