"""Rows of the table: EEPROM wear, toggles and pulses, the scale of the setpoint."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

from drivebus.drives import Direction, Drive
from drivebus.errors import DrivebusError
from drivebus.lab.cells.alphabet import field, looks, written
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line
from drivebus.lab.kinds import C320, C320_HEX, DF800, DF800_ASCII, DZB100, VC660
from drivebus.lab.manual import Does
from drivebus.lab.world.wishes import Wish
from drivebus.protocols import modbus
from drivebus.sim.plate import Trip

BUDGET = 20
"""G16: a day and parameter."""
PARAMETERS = {"c320": "F1.10", "dzb100": "10", "vc660": "F00.02", "df800": "F1.07"}
GOOD = ("confirmed", "acknowledged")


@case("eeprom_burst")
def burst_of_saves(at: Case) -> None:
    """Twenty a day reach the EEPROM, over restarts too; where RAM can be told apart, a burst there costs none."""
    line = at.line(1)
    notation, saves = PARAMETERS[at.kind.model], line.station(1).memory.eeprom_writes
    words = [line.do(1, "write", {notation: 10.0 + n}, True).word for n in range(BUDGET // 2)]
    store = line.drives[1]._store
    line.restart()
    line.drives[1]._store = store
    line.drives[1]._memory.wear = line.drives[1]._wear(line.drives[1]._memory.limits)
    words += [line.do(1, "write", {notation: 30.0 + n}, True).word for n in range(BUDGET // 2 + 5)]
    line.expect(words == ["confirmed"] * BUDGET + ["WearBudget"] * 5, f"{words}")
    line.expect(saves.total() == BUDGET, f"{saves.total()} writes wore the EEPROM")
    if at.kind.model in ("c320", "vc660"):
        _ram(line, notation)
    else:
        wish = line.do(1, "write", {notation: 12.0})
        line.expect(wish.word == "CapabilityError" and saves.total() == BUDGET, f"without save: {wish.word}")


def _ram(line: Line, notation: str) -> None:
    """Class 3, or no 8000H: as often as somebody likes."""
    mark, memory = len(line.sent), line.station(1).memory
    for number in range(BUDGET + 5):
        wish = line.do(1, "write", {notation: 12.0 + number % 2})
        line.expect(wish.word == "confirmed", f"RAM write {wish.word}")
    line.expect(memory.eeprom_writes.total() == BUDGET and memory.ram_writes.total() >= 2 * BUDGET + 5, "EEPROM worn")
    for one in line.since(mark, Does.SET):
        if line.kind.model == "c320":
            line.expect(field(line.kind, one.data, 3, 1) == 3, "not class 3")
        else:
            line.expect((written(line.kind, one.data) or (0x8000, 0))[0] < 0x8000, "with 8000H")


@case("toggle", C320, C320_HEX)
def operations_go_behind_a_status(at: Case) -> None:
    """An operation stands in control frames alone, and none is sent twice without a look in between (T01, T07)."""
    line = at.line(1)
    for _ in range(2):
        for what in ("run", "run", "set_frequency", "stop"):
            line.do(1, what, *(() if what == "stop" else (at.hz(),)))
    line.do(1, "reset_fault")
    line.loop.run(line.drives[1].read(("F0.1", "F9.4")))
    moves = [index for index, one in enumerate(line.sent) if one.does is Does.MOVE]
    line.expect(len(moves) == 2, f"{len(moves)} starts for two runs from standstill")
    for one, other in pairwise([0, *moves]):
        seen = [sent for sent in line.sent[one:other] if looks(line.kind, sent.data)]
        line.expect(len(seen) >= 2, f"{len(seen)} looks before a start")
    for sent in line.sent:
        control = field(line.kind, sent.data, 3, 1) == 4
        line.expect(control or field(line.kind, sent.data, 4, 2) == 0, f"{sent.data.hex()} carries an operation")


@case("toggle", DZB100)
def a_jog_lives_by_its_lease(at: Case) -> None:
    """Half a second without a renewal ends it; a longer lease is refused (T13)."""
    line = at.line(1)
    line.loop.run(line.drives[1].preflight())
    drive, lease_s = line.drives[1], at.rng.uniform(0.2, 0.5)
    motor = line.station(1).motor

    async def jog(hz: float) -> Any:
        async with drive.jog(hz, lease_s=lease_s) as lease:
            for _ in range(5):
                await asyncio.sleep(lease_s / 2)
                lease.renew()
            await asyncio.sleep(8.0)  # the hand is gone, the program hangs
            return lease.ended or lease.begun

    wish = line.wish_by(jog, 1, "jog", 5.0)
    line.finish(wish)
    line.run(2.0)
    move, stop = line.since(0, Does.MOVE)[-1], line.since(0, Does.STOP)[0]
    line.expect(motor.starts == 1 and not motor.energised, f"{motor.starts} starts, on: {motor.energised}")
    line.expect(stop.start - move.end > 2 * lease_s, "ended while it was renewed")
    line.expect(stop.start - move.end < 3.5 * lease_s + 0.5, f"it went on for {stop.start - move.end:.3f} s")
    line.expect(_raises(lambda: drive.jog(5.0, lease_s=0.51)) == "LimitError", "a lease above 0.5 s")


def said(wish: Wish, language: str) -> str:
    """What the user is told in a language; "" where that is no error."""
    return wish.error.text(language) if isinstance(wish.error, DrivebusError) else ""


def _raises(call: Any) -> str:
    try:
        call()
    except Exception as error:
        return type(error).__name__
    return ""


@case("toggle", VC660)
def one_pulse_an_edge(at: Case) -> None:
    """Each pulse is written once and taken back before the next; levels stand in every word."""
    line = at.line(1)
    for direction in (Direction.FORWARD, Direction.REVERSE):
        line.do(1, "run", at.hz(), direction)
        line.run(1.0)
        line.do(1, at.rng.choice(("stop", "coast")))
        line.run(2.0)
    line.station(1).trip(at.rng.choice(list(Trip)))
    line.do(1, "reset_fault")
    words = [word[1] for one in line.sent if (word := written(line.kind, one.data)) and word[0] == 0x2000]
    for one, other in pairwise(words):
        line.expect(not one & PULSES or not other & PULSES, f"{one:04X} and {other:04X} without a fall between them")
    starts, resets = (sum(bool(word & bit) for word in words) for bit in (0x01, 0x200))
    line.expect((starts, resets) == (2, 1), f"{starts} starts, {resets} resets")
    line.expect(line.station(1).motor.starts == 2 and line.station(1).motor.trip is None, "executed otherwise")


PULSES = 0x0001 | 0x0002 | 0x0020 | 0x0040 | 0x0200
"""Main control: start, stop, coast, emergency stop, reset."""


@case("toggle", DF800, DF800_ASCII)
def the_toggle_is_never_sent(at: Case) -> None:
    """11 in the direction field: by no command, and not from somebody who asks the bus for it (T16)."""
    line = at.line(1)
    for direction in (None, Direction.FORWARD, Direction.REVERSE):
        line.do(1, "run", at.hz(), *(() if direction is None else (direction,)))
        line.do(1, "stop")
        line.run(3.0)
    line.do(1, "reset_fault")
    for toggle in (0x0C, 0x0D, 0x0E, 0x0F, 0x1C):
        request = modbus.WriteRegister(1, 0x2000, toggle)
        answer = line.ask(1, request)
        line.expect(answer.error is not None and not answer.sent, f"{toggle:04X} was sent")
        frame = line.drives[1].dialect.codec.encode_request(request)
        line.expect(not line.drives[1].dialect.lawful(frame), f"the gate would be asked for {toggle:04X}")
    words = [word[1] for one in line.sent if (word := written(line.kind, one.data)) and word[0] == 0x2000]
    line.expect(len(words) > 6 and not any(word & 0x0C == 0x0C for word in words), f"{words}")


@case("scale", DZB100)
def unproved_scale(at: Case) -> None:
    """T08: until the coding is proved no word leaves that any coding would make more than 5 Hz of."""
    for coding in ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"):
        line = at.line(1, setpoint_coding=coding, query_coding=coding)
        line.drives[1].close()
        line.drives[1] = Drive(line.bus, "dzb100", 1)
        for hz in (10.0, 50.0, at.hz(0.6, 40)):
            mark, wish = len(line.sent), line.do(1, "run", hz)
            line.expect(wish.word == "LimitError" and not line.since(mark), f"{hz} Hz: {wish.word}")
        line.finish(line.wish_by(line.drives[1].run, 1, "run at the cap", at.rng.choice((0.1, 0.3, 0.5))))
        line.run(5.0)
        line.expect(line.station(1).motor.starts == 1, "not started at the cap")
        line.expect(abs(line.station(1).motor.target_hz) <= 5.0, f"{line.station(1).motor.target_hz} Hz under {coding}")
        line.do(1, "stop")


@case("scale", VC660)
def scale_read_back(at: Case) -> None:
    """3001H must show the very frequency before a start leaves: a drive that counts otherwise is not started."""
    line, hz = at.line(1), at.hz()
    mark, wish = len(line.sent), line.do(1, "run", hz)
    values = [word for one in line.since(mark) if (word := written(line.kind, one.data)) and word[0] == 0x2001]
    line.expect(wish.word == "confirmed" and values == [(0x2001, round(hz * 100))], f"{wish.word}: {values}")
    other = at.line(1)
    station = other.station(1)
    take, factor = station._set_frequency, at.rng.choice((10, 0.1))
    station._set_frequency = lambda value: take(min(40000, round(value * factor)))
    mark, wish = len(other.sent), other.do(1, "run", hz)
    other.expect(wish.word == "failed" and not other.since(mark, Does.MOVE), f"another scale: {wish.word}")
    other.expect(not station.motor.starts, "started")


@case("scale", DF800, DF800_ASCII)
def source_of_the_frequency(at: Case) -> None:
    """0.01 Hz in 2001H, which counts only while F1.01 = 5: else the start is refused and the keypad step is named."""
    line, hz = at.line(1), at.hz()
    mark, wish = len(line.sent), line.do(1, "run", hz)
    values = [word for one in line.since(mark) if (word := written(line.kind, one.data)) and word[0] == 0x2001]
    line.expect(wish.word == "acknowledged" and values == [(0x2001, round(hz * 100))], f"{wish.word}: {values}")
    line.expect(abs(line.station(1).motor.target_hz - hz) < 0.006, f"it goes to {line.station(1).motor.target_hz}")
    other = at.line(1)
    other.station(1).press_set(101, at.rng.choice((0, 1, 3)))
    mark, wish = len(other.sent), other.do(1, "run", hz)
    other.expect(wish.word == "PreflightError" and "F1.01" in said(wish, "en"), f"{wish.word}")
    other.expect("F1.01" in said(wish, "zh") and not other.since(mark, Does.MOVE, Does.SET), "something was sent")
