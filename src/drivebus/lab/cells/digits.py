"""Rows of the table: two swapped digits, and what single reads may decide where no check tells them from true ones."""

from __future__ import annotations

from typing import Any

from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line, Say
from drivebus.lab.kinds import C320, C320_HEX, DF800, DF800_ASCII, DZB100, VC660
from drivebus.reading import Quality

WAITS_S = 6.0
"""Longer than any answer can be late: garbage is told from a late answer only where none may come (5 s)."""
ECHOED = {"c320": (1, 10), "dzb100": (3, 7)}
"""Where an answer repeats what was asked: C320 address … item, DZB100 address and item."""


def swap(data: bytes, index: int) -> bytes:
    return data[:index] + data[index + 1 : index + 2] + data[index : index + 1] + data[index + 2 :]


def swapped(at: Case, first: int, last: int) -> Any:
    """Two neighbours that differ change places, somewhere in these bytes."""

    def act(say: Say, data: bytes, when: float) -> Any:
        places = [index for index in range(first, min(last, len(data)) - 1) if data[index] != data[index + 1]]
        return say(swap(data, at.rng.choice(places)), when)

    return act


@case("digit_swap", VC660, DF800, DF800_ASCII)
def swapped_digits_meet_a_check(at: Case) -> None:
    """CRC and LRC see every swap of neighbours."""
    line = at.line()
    line.station(1).press_run(at.hz())
    for _ in range(4):
        line.run(WAITS_S)
        size = len(line.said[0].data)
        first, last = (1, size - 2) if at.kind.encoding == "ascii" else (0, size)
        failed = line.failures(1)
        line.trick(1, swapped(at, first, last), 1)
        answer = line.read(1)
        line.expect(answer.error is None and answer.attempts == 2, f"a swap was believed: {answer}")
        line.expect(line.failures(1) == failed + 1, f"not counted: {line.figures(1).errors}")


@case("digit_swap", C320, C320_HEX, DZB100)
def swapped_digits_pass_the_check(at: Case) -> None:
    """In what is echoed: void. In a value: out of range it is uncertain; one read alone decides nothing."""
    line = at.line(12, 13)
    first, last = ECHOED[at.kind.model]
    for _ in range(3):
        line.run(WAITS_S)
        attempts = _swap_once(at, line, first, last)
        line.expect(attempts == 2, "an answer with another address or item was believed")
    single_reads_decide_nothing(at)
    if at.kind.model == "c320":
        _beyond_its_range(at)


def _swap_once(at: Case, line: Line, first: int, last: int) -> int:
    line.trick(12, swapped(at, first, last), 1)
    answer = line.read(12)
    line.expect(answer.error is None and answer.received == line.said[-1].data, f"{answer}")
    return answer.attempts


def single_reads_decide_nothing(at: Case) -> None:
    """A stop is not called confirmed, a stopped drive not called running, on the strength of one wrong answer."""
    line = at.line(1)
    monitor = line.monitored(1)
    states = []
    for _ in range(4):
        line.trick(1, lying(at, stands=False), 1)
        for _ in range(12):
            line.run(0.1)
            states.append(str(monitor.status().state))
    line.expect(
        {"stopped"} <= set(states) <= {"stopped", "unknown"}, f"a standing drive is called {sorted(set(states))}"
    )
    monitor.close()
    line.monitors.clear()
    line.running_at(1, at.hz(15, 20))
    line.station(1).faults.stuck = False
    for _ in range(3):
        line.trick(1, lying(at, stands=True), 1)
        status = line.loop.run(line.drives[1].status())
        line.expect(str(status.state) == "running", f"a running drive is called {status.state}")


def lying(at: Case, stands: bool) -> Any:
    """One answer in which as many digits are wrong as it takes to say the other thing, with a check that fits."""

    def act(say: Say, data: bytes, when: float) -> Any:
        return say(lie(at, data, stands), when)

    return act


def lie(at: Case, data: bytes, stands: bool) -> bytes:
    """DZB100: Q01 says 0 or not. C320: the state says 03 or 01, its sum is made to fit."""
    if at.kind.model == "dzb100":
        return data[:7] + (b"0000" if stands else b"0064") + data[11:] if data[5:7] == b"01" else data
    if len(data) != 18:
        return data
    hexed = at.kind.encoding == "hex"
    state = bytes((0, 3) if stands else (0, 1)) if hexed else b"03" if stands else b"01"
    body = data[1:4] + state + data[6:13]
    total = sum(body) & 0xFFFF
    check = total.to_bytes(4) if hexed else b"%04X" % total
    return data[:1] + body + check + data[17:]


def _beyond_its_range(at: Case) -> None:
    """d.4 is plausible up to 1,200 V: a swap that makes more of it is shown, and called uncertain."""
    line = at.line(1)
    monitor = line.monitor(1, ("dc_bus_voltage",))
    line.run(1.0)
    reading = monitor.status().readings["dc_bus_voltage"]
    line.expect(reading.quality is Quality.GOOD, f"{reading}")
    place = 9 if at.kind.encoding == "ascii" else 11
    trick = line.trick(1, lambda say, data, when: say(swap(data, place), when), 1)
    while trick.times:
        line.run(0.1)
    line.run(0.2)
    reading = monitor.status().readings["dc_bus_voltage"]
    line.expect(reading.quality is Quality.UNCERTAIN and (reading.raw or 0) > 1200, f"{reading}")
