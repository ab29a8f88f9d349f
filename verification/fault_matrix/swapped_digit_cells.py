"""Rows of the table: two swapped digits, and what single reads may decide where no check tells them from true ones."""

from __future__ import annotations

from typing import Any

from drivebus.values import Quality
from verification.drive_variants import C320, C320_HEX, DF800, DF800_ASCII, DZB100, VC660
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus, WireSend

DIGITS_OBSERVATION_S = 6.0
"""Longer than any answer can be late: garbage is told from a late answer only where none may come (5 s)."""
ECHOED_FIELDS = {"c320": (1, 10), "dzb100": (3, 7)}
"""Where an answer repeats what was asked: C320 address … item, DZB100 address and item."""


def swap_neighbours(data: bytes, index: int) -> bytes:
    return data[:index] + data[index + 1 : index + 2] + data[index : index + 1] + data[index + 2 :]


def swapped_digits(at: CellRun, first: int, last: int) -> Any:
    """Two neighbours that differ change places, somewhere in these bytes."""

    def act(say: WireSend, data: bytes, when: float) -> Any:
        places = [index for index in range(first, min(last, len(data)) - 1) if data[index] != data[index + 1]]
        return say(swap_neighbours(data, at.rng.choice(places)), when)

    return act


@cell("digit_swap", VC660, DF800, DF800_ASCII)
def swapped_digits_meet_a_check(at: CellRun) -> None:
    """CRC and LRC see every swap of neighbours."""
    line = at.bus()
    line.station(1).keypad_run(at.random_hz())
    for _ in range(4):
        line.run(DIGITS_OBSERVATION_S)
        size = len(line.replies[0].data)
        first, last = (1, size - 2) if at.kind.encoding == "ascii" else (0, size)
        failed = line.failure_count(1)
        line.manipulate_replies(1, swapped_digits(at, first, last), 1)
        answer = line.read(1)
        line.expect(answer.error is None and answer.attempts == 2, f"a swap was believed: {answer}")
        line.expect(line.failure_count(1) == failed + 1, f"not counted: {line.statistics(1).errors}")


@cell("digit_swap", C320, C320_HEX, DZB100)
def swapped_digits_pass_the_check(at: CellRun) -> None:
    """In what is echoed: void. In a value: out of range it is uncertain; one read alone decides nothing."""
    line = at.bus(12, 13)
    first, last = ECHOED_FIELDS[at.kind.model]
    for _ in range(3):
        line.run(DIGITS_OBSERVATION_S)
        attempts = _check_one_swap(at, line, first, last)
        line.expect(attempts == 2, "an answer with another address or item was believed")
    single_reads_decide_nothing(at)
    if at.kind.model == "c320":
        _check_out_of_range_value(at)


def _check_one_swap(at: CellRun, line: MatrixBus, first: int, last: int) -> int:
    line.manipulate_replies(12, swapped_digits(at, first, last), 1)
    answer = line.read(12)
    line.expect(answer.error is None and answer.received == line.replies[-1].data, f"{answer}")
    return answer.attempts


def single_reads_decide_nothing(at: CellRun) -> None:
    """A stop is not called confirmed, a stopped drive not called running, on the strength of one wrong answer."""
    line = at.bus(1)
    monitor = line.monitored(1)
    states = []
    for _ in range(4):
        line.manipulate_replies(1, falsified_replies(at, stands=False), 1)
        for _ in range(12):
            line.run(0.1)
            states.append(str(monitor.status().state))
    line.expect(
        {"stopped"} <= set(states) <= {"stopped", "unknown"}, f"a standing drive is called {sorted(set(states))}"
    )
    monitor.close()
    line.monitors.clear()
    line.start_at(1, at.random_hz(15, 20))
    line.station(1).faults.frozen_readings = False
    for _ in range(3):
        line.manipulate_replies(1, falsified_replies(at, stands=True), 1)
        status = line.loop.run_until_complete(line.drives[1].status())
        line.expect(str(status.state) == "running", f"a running drive is called {status.state}")


def falsified_replies(at: CellRun, stands: bool) -> Any:
    """One answer in which as many digits are wrong as it takes to say the other thing, with a check that fits."""

    def act(say: WireSend, data: bytes, when: float) -> Any:
        return say(falsify_state(at, data, stands), when)

    return act


def falsify_state(at: CellRun, data: bytes, stands: bool) -> bytes:
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


def _check_out_of_range_value(at: CellRun) -> None:
    """d.4 is plausible up to 1,200 V: a swap that makes more of it is shown, and called uncertain."""
    line = at.bus(1)
    monitor = line.monitor(1, ("dc_bus_voltage",))
    line.run(1.0)
    reading = monitor.status().readings["dc_bus_voltage"]
    line.expect(reading.quality is Quality.GOOD, f"{reading}")
    place = 9 if at.kind.encoding == "ascii" else 11
    trick = line.manipulate_replies(1, lambda say, data, when: say(swap_neighbours(data, place), when), 1)
    while trick.remaining:
        line.run(0.1)
    line.run(0.2)
    reading = monitor.status().readings["dc_bus_voltage"]
    line.expect(reading.quality is Quality.UNCERTAIN and (reading.raw or 0) > 1200, f"{reading}")
