"""A plant in another process and its record, from which tests judge the wire and the motors."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from verification.reference.effects import RequestEffect
from verification.reference.request_effects import classify_request

PROCESS_TIMEOUT_S = 60.0
"""Longest wait for another process on a loaded machine; no test asserts how long it takes."""
COMM_LOSS_TIMER_S = 2.0
C320_TIMER_PARAMETERS = {0x903: 2, 0x904: round(COMM_LOSS_TIMER_S * 10)}
"""F9.3 = 2: trip on communication loss; F9.4: tenths of a second without a frame."""
STEP_S = 0.01
"""Interval at which the plant samples its motors."""


@dataclass(frozen=True, kw_only=True)
class RecordedRequest:
    """A request on the wire: seconds of its first and last bit, and its effect by the manual alone."""

    t: float
    end: float
    address: int
    effect: RequestEffect
    data: bytes
    host: int


@dataclass(frozen=True)
class MotorChange:
    """Change of a motor: switched on or off, or tripped."""

    t: float
    address: int
    on: bool
    trip: str | None


def split(model: str, data: bytes) -> list[bytes]:
    """Requests that a busy machine read in one piece: RTU requests have 8 bytes, C320's end with 0DH."""
    if model == "vc660":
        return [data[at : at + 8] for at in range(0, len(data), 8)]
    return [part + b"\r" for part in data.split(b"\r") if part] if data[:1] == b"*" else [data]


class RecordedPlant:
    """Plant in its own process; ``lines`` are specifications of ``bench_process`` without the links."""

    def __init__(self, folder: Path, *lines: dict[str, Any], adapters: int = 1) -> None:
        self.record = folder / "record"
        self.lines = [
            {**each, "links": [str(folder / f"line{number}.{adapter}") for adapter in range(adapters)]}
            for number, each in enumerate(lines)
        ]
        self._orders = 0
        specification = json.dumps({"record": str(self.record), "lines": self.lines})
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("bench_process.py")), specification],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self.process.stdout is not None and self.process.stdout.readline() == "ready\n"

    def url(self, line: int = 0, adapter: int = 0) -> str:
        given = self.lines[line]
        return f"serial://{given['links'][adapter]}?baud={given['baud']}&format={given.get('format', '8N1')}"

    def path(self, line: int = 0, adapter: int = 0) -> str:
        return str(self.lines[line]["links"][adapter])

    def order(self, **order: Any) -> None:
        """Execute an order in the plant; on return it and everything before it is in the record."""
        assert self.process.stdin is not None
        self._orders += 1
        self.process.stdin.write(json.dumps({**order, "number": self._orders}) + "\n")
        self.process.stdin.flush()
        wait_until(lambda: any(each.get("number") == self._orders for each in self.read()), "the plant's answer")

    def settle(self) -> None:
        """Wait until everything written to its ptys is in the record; the second order reads the ptys again."""
        self.order()
        self.order()

    def read(self) -> list[dict[str, Any]]:
        if not self.record.exists():
            return []
        return [json.loads(each) for each in self.record.read_text().splitlines(keepends=True) if each.endswith("\n")]

    def requests(self, line: int = 0, since: float = 0.0) -> list[RecordedRequest]:
        """Return every request whose first bit came after ``since``, of all adapters."""
        given, found = self.lines[line], []
        for each in self.read():
            if each["what"] == "request" and each["line"] == line and each["t"] > since:
                for data in split(given["model"], bytes.fromhex(each["data"])):
                    address, effect = classify_request(given["model"], given.get("encoding", "ascii"), data)
                    found.append(
                        RecordedRequest(
                            t=each["t"], end=each["end"], address=address, effect=effect, data=data, host=each["host"]
                        )
                    )
        return found

    def motor_changes(self, line: int = 0, since: float = 0.0) -> list[MotorChange]:
        return [
            MotorChange(each["t"], each["address"], each["on"], each["trip"])
            for each in self.read()
            if each["what"] == "motor" and each["line"] == line and each["t"] > since
        ]

    def last_frame_received(self, line: int, before: float) -> float:
        """Return when, on its own clock, the drive received its last frame before ``before``."""
        received = [each["t"] for each in self.read() if each["what"] == "received" and each["line"] == line]
        return max(t for t in received if t < before)

    def on(self, line: int = 0) -> bool:
        changes = self.motor_changes(line)
        return bool(changes) and changes[-1].on

    def close(self) -> None:
        self.process.kill()
        self.process.communicate()


@contextmanager
def recorded_plant(folder: Path, *lines: dict[str, Any], adapters: int = 1) -> Iterator[RecordedPlant]:
    made = RecordedPlant(folder, *lines, adapters=adapters)
    try:
        yield made
    finally:
        made.close()


def c320(baud: int = 19200, **more: Any) -> dict[str, Any]:
    """Return one C320 whose own timer trips it 2 s after the last frame."""
    return {"model": "c320", "addresses": [1], "baud": baud, "format": "8E1", "keypad": C320_TIMER_PARAMETERS} | more


def vc660(baud: int = 19200, **more: Any) -> dict[str, Any]:
    return {"model": "vc660", "encoding": "rtu", "addresses": [1], "baud": baud} | more


def bus_specification(model: str, encoding: str, **more: Any) -> dict[str, Any]:
    """Return one drive of any family at address 1."""
    settings = {"encoding": encoding} if model == "df800" else {}
    parity = {"format": "8E1"} if model == "c320" else {}
    return {"model": model, "encoding": encoding, "addresses": [1], "baud": 19200, "settings": settings} | parity | more


def wait_until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition outside this process; ``what`` names it in the failure."""
    ends_at = time.monotonic() + PROCESS_TIMEOUT_S
    while not condition():
        assert time.monotonic() < ends_at, f"{what} did not come in {PROCESS_TIMEOUT_S} s"
        time.sleep(0.02)
