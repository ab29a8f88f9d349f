"""Rows of the table: EEPROM wear, toggles and pulses, the scale of the setpoint."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

from drivebus.drives import Direction, Drive
from drivebus.errors import DrivebusError
from drivebus.protocols import modbus
from drivebus.simulator.motor import Trip
from verification.drive_variants import C320, C320_HEX, DF800, DF800_ASCII, DZB100, VC660
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.frame_fields import c320_field, modbus_write, status_read_key
from verification.fault_matrix.matrix_bus import MatrixBus
from verification.reference.request_effects import RequestEffect
from verification.scenario.user_command import UserCommand

CELL_WRITES_PER_DAY = 20
"""A day and parameter."""
CELL_PARAMETERS = {"c320": "F1.10", "dzb100": "10", "vc660": "F00.02", "df800": "F1.07"}
COMMAND_DONE_WORDS = ("confirmed", "acknowledged")


@cell("eeprom_burst")
def burst_of_saves(at: CellRun) -> None:
    """Twenty a day reach the EEPROM, over restarts too; where RAM can be told apart, a burst there costs none."""
    line = at.bus(1)
    notation, saves = CELL_PARAMETERS[at.kind.model], line.station(1).memory.eeprom_writes
    words = [
        line.command_to_end(1, "write", {notation: 10.0 + n}, True).result_word for n in range(CELL_WRITES_PER_DAY // 2)
    ]
    store = line.drives[1]._store
    line.restart_host()
    line.drives[1]._store = line.drives[1]._runner._store = store
    line.drives[1]._context.eeprom_budget = line.drives[1]._eeprom_budget(line.drives[1]._context.limits)
    words += [
        line.command_to_end(1, "write", {notation: 30.0 + n}, True).result_word
        for n in range(CELL_WRITES_PER_DAY // 2 + 5)
    ]
    line.expect(words == ["confirmed"] * CELL_WRITES_PER_DAY + ["EepromBudgetExceeded"] * 5, f"{words}")
    line.expect(saves.total() == CELL_WRITES_PER_DAY, f"{saves.total()} writes wore the EEPROM")
    if at.kind.model in ("c320", "vc660"):
        _check_ram_writes(line, notation)
    else:
        command = line.command_to_end(1, "write", {notation: 12.0})
        line.expect(
            command.result_word == "CapabilityError" and saves.total() == CELL_WRITES_PER_DAY,
            f"without save: {command.result_word}",
        )


def _check_ram_writes(line: MatrixBus, notation: str) -> None:
    """Class 3, or no 8000H: as often as somebody likes."""
    mark, memory = len(line.requests), line.station(1).memory
    for number in range(CELL_WRITES_PER_DAY + 5):
        command = line.command_to_end(1, "write", {notation: 12.0 + number % 2})
        line.expect(command.result_word == "confirmed", f"RAM write {command.result_word}")
    line.expect(
        memory.eeprom_writes.total() == CELL_WRITES_PER_DAY
        and memory.ram_writes.total() >= 2 * CELL_WRITES_PER_DAY + 5,
        "EEPROM worn",
    )
    for one in line.requests_since(mark, RequestEffect.SETTING):
        if line.kind.model == "c320":
            line.expect(c320_field(line.kind, one.data, 3, 1) == 3, "not class 3")
        else:
            line.expect((modbus_write(line.kind, one.data) or (0x8000, 0))[0] < 0x8000, "with 8000H")


@cell("toggle", C320, C320_HEX)
def operation_only_after_status(at: CellRun) -> None:
    """An operation stands in control frames alone, and none is sent twice without a look in between (T01, T07)."""
    line = at.bus(1)
    for _ in range(2):
        for what in ("run", "run", "set_frequency", "stop"):
            line.command_to_end(1, what, *(() if what == "stop" else (at.random_hz(),)))
    line.command_to_end(1, "reset_fault")
    line.loop.run_until_complete(line.drives[1].read(("F0.1", "F9.4")))
    moves = [index for index, one in enumerate(line.requests) if one.effect is RequestEffect.MOTION]
    line.expect(len(moves) == 2, f"{len(moves)} starts for two runs from standstill")
    for one, other in pairwise([0, *moves]):
        seen = [sent for sent in line.requests[one:other] if status_read_key(line.kind, sent.data)]
        line.expect(len(seen) >= 2, f"{len(seen)} looks before a start")
    for sent in line.requests:
        control = c320_field(line.kind, sent.data, 3, 1) == 4
        line.expect(control or c320_field(line.kind, sent.data, 4, 2) == 0, f"{sent.data.hex()} carries an operation")


@cell("toggle", DZB100)
def jog_ends_with_its_lease(at: CellRun) -> None:
    """Half a second without a renewal ends it; a longer lease is refused (T13)."""
    line = at.bus(1)
    line.loop.run_until_complete(line.drives[1].preflight())
    drive, lease_s = line.drives[1], at.rng.uniform(0.2, 0.5)
    motor = line.station(1).motor

    async def jog(hz: float) -> Any:
        async with drive.jog(hz, lease_s=lease_s) as lease:
            for _ in range(5):
                await asyncio.sleep(lease_s / 2)
                lease.renew()
            await asyncio.sleep(8.0)  # the hand is gone, the program hangs
            return lease.stop_outcome or lease.start_outcome

    command = line.command_by(jog, 1, "jog", 5.0)
    line.finish(command)
    line.run(2.0)
    move, stop = line.requests_since(0, RequestEffect.MOTION)[-1], line.requests_since(0, RequestEffect.STOP)[0]
    line.expect(motor.starts == 1 and not motor.energised, f"{motor.starts} starts, on: {motor.energised}")
    line.expect(stop.start - move.end > 2 * lease_s, "ended while it was renewed")
    line.expect(stop.start - move.end < 3.5 * lease_s + 0.5, f"it went on for {stop.start - move.end:.3f} s")
    line.expect(_error_of(lambda: drive.jog(5.0, lease_s=0.51)) == "LimitError", "a lease above 0.5 s")


def error_text(wish: UserCommand, language: str) -> str:
    """What the user is told in a language; "" where that is no error."""
    return wish.error.text(language) if isinstance(wish.error, DrivebusError) else ""


def _error_of(call: Any) -> str:
    try:
        call()
    except Exception as error:
        return type(error).__name__
    return ""


@cell("toggle", VC660)
def one_pulse_per_edge(at: CellRun) -> None:
    """Each pulse is written once and taken back before the next; levels stand in every word."""
    line = at.bus(1)
    for direction in (Direction.FORWARD, Direction.REVERSE):
        line.command_to_end(1, "run", at.random_hz(), direction)
        line.run(1.0)
        line.command_to_end(1, at.rng.choice(("stop", "coast")))
        line.run(2.0)
    line.station(1).trip(at.rng.choice(list(Trip)))
    line.command_to_end(1, "reset_fault")
    words = [word[1] for one in line.requests if (word := modbus_write(line.kind, one.data)) and word[0] == 0x2000]
    for one, other in pairwise(words):
        line.expect(
            not one & VC660_PULSE_BITS or not other & VC660_PULSE_BITS,
            f"{one:04X} and {other:04X} without a fall between them",
        )
    starts, resets = (sum(bool(word & bit) for word in words) for bit in (0x01, 0x200))
    line.expect((starts, resets) == (2, 1), f"{starts} starts, {resets} resets")
    line.expect(line.station(1).motor.starts == 2 and line.station(1).motor.trip is None, "executed otherwise")


VC660_PULSE_BITS = 0x0001 | 0x0002 | 0x0020 | 0x0040 | 0x0200
"""Main control: start, stop, coast, emergency stop, reset."""


@cell("toggle", DF800, DF800_ASCII)
def toggle_is_never_sent(at: CellRun) -> None:
    """11 in the direction field: by no command, and not from somebody who asks the bus for it (T16)."""
    line = at.bus(1)
    for direction in (None, Direction.FORWARD, Direction.REVERSE):
        line.command_to_end(1, "run", at.random_hz(), *(() if direction is None else (direction,)))
        line.command_to_end(1, "stop")
        line.run(3.0)
    line.command_to_end(1, "reset_fault")
    for toggle in (0x0C, 0x0D, 0x0E, 0x0F, 0x1C):
        request = modbus.WriteRegister(1, 0x2000, toggle)
        answer = line.transact(1, request)
        line.expect(answer.error is not None and not answer.sent, f"{toggle:04X} was sent")
        frame = line.drives[1].dialect.codec.encode_request(request)
        line.expect(not line.drives[1].dialect.is_allowed(frame), f"the gate would be asked for {toggle:04X}")
    words = [word[1] for one in line.requests if (word := modbus_write(line.kind, one.data)) and word[0] == 0x2000]
    line.expect(len(words) > 6 and not any(word & 0x0C == 0x0C for word in words), f"{words}")


@cell("scale", DZB100)
def uncalibrated_scale(at: CellRun) -> None:
    """T08: until the coding is proved no word leaves that any coding would make more than 5 Hz of."""
    for coding in ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"):
        line = at.bus(1, setpoint_coding=coding, query_coding=coding)
        line.drives[1].close()
        line.drives[1] = Drive(line.bus, "dzb100", 1)
        for hz in (10.0, 50.0, at.random_hz(0.6, 40)):
            mark, command = len(line.requests), line.command_to_end(1, "run", hz)
            line.expect(
                command.result_word == "LimitError" and not line.requests_since(mark), f"{hz} Hz: {command.result_word}"
            )
        line.finish(line.command_by(line.drives[1].run, 1, "run at the cap", at.rng.choice((0.1, 0.3, 0.5))))
        line.run(5.0)
        line.expect(line.station(1).motor.starts == 1, "not started at the cap")
        line.expect(abs(line.station(1).motor.target_hz) <= 5.0, f"{line.station(1).motor.target_hz} Hz under {coding}")
        line.command_to_end(1, "stop")


@cell("scale", VC660)
def scale_read_back(at: CellRun) -> None:
    """3001H must show the very frequency before a start leaves: a drive that counts otherwise is not started."""
    line, hz = at.bus(1), at.random_hz()
    mark, command = len(line.requests), line.command_to_end(1, "run", hz)
    values = [
        word for one in line.requests_since(mark) if (word := modbus_write(line.kind, one.data)) and word[0] == 0x2001
    ]
    line.expect(
        command.result_word == "confirmed" and values == [(0x2001, round(hz * 100))], f"{command.result_word}: {values}"
    )
    other = at.bus(1)
    station = other.station(1)
    take, factor = station._set_frequency, at.rng.choice((10, 0.1))
    station._set_frequency = lambda value: take(min(40000, round(value * factor)))
    mark, command = len(other.requests), other.command_to_end(1, "run", hz)
    other.expect(
        command.result_word == "failed" and not other.requests_since(mark, RequestEffect.MOTION),
        f"another scale: {command.result_word}",
    )
    other.expect(not station.motor.starts, "started")


@cell("scale", DF800, DF800_ASCII)
def frequency_source(at: CellRun) -> None:
    """0.01 Hz in 2001H, which counts only while F1.01 = 5: else the start is refused and the keypad step is named."""
    line, hz = at.bus(1), at.random_hz()
    mark, command = len(line.requests), line.command_to_end(1, "run", hz)
    values = [
        word for one in line.requests_since(mark) if (word := modbus_write(line.kind, one.data)) and word[0] == 0x2001
    ]
    line.expect(
        command.result_word == "acknowledged" and values == [(0x2001, round(hz * 100))],
        f"{command.result_word}: {values}",
    )
    line.expect(abs(line.station(1).motor.target_hz - hz) < 0.006, f"it goes to {line.station(1).motor.target_hz}")
    other = at.bus(1)
    other.station(1).keypad_set(101, at.rng.choice((0, 1, 3)))
    mark, command = len(other.requests), other.command_to_end(1, "run", hz)
    other.expect(
        command.result_word == "PreflightError" and "F1.01" in error_text(command, "en"), f"{command.result_word}"
    )
    other.expect(
        "F1.01" in error_text(command, "zh")
        and not other.requests_since(mark, RequestEffect.MOTION, RequestEffect.SETTING),
        "something was sent",
    )
