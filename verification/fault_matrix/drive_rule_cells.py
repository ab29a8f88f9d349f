"""Rows of the table: EEPROM wear, toggles and pulses, the scale of the setpoint."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from typing import Any

from drivebus.drives import Direction, Drive
from drivebus.errors import DrivebusError
from drivebus.protocols import modbus
from drivebus.simulator.motor import Trip
from verification.families.campaigns import campaign_of
from verification.families.dzb100.facts import DZB100
from verification.families.huanyang.facts import HUANYANG_HY
from verification.families.modbus.facts import DF800, DF800_ASCII, VC660, modbus_write
from verification.families.sunfar.facts import C320, C320_HEX, CONTROL, class_and_operation
from verification.fault_matrix.cell import COVERED, CellRun, cell
from verification.fault_matrix.matrix_scenario import MatrixScenario
from verification.reference.effects import RequestEffect
from verification.reference.huanyang import FREQUENCY
from verification.reference.request_effects import status_read_key
from verification.scenario.user_command import UserCommand

CELL_WRITES_PER_DAY = 20
"""Saves of one parameter a day."""


@cell("eeprom_burst")
def burst_of_saves(run: CellRun) -> None:
    """Check that twenty saves a day reach the EEPROM, across restarts, and that RAM writes do not count."""
    scenario = run.scenario(1)
    family = campaign_of(run.variant.model)
    notation, saves = family.saved_parameters[run.variant.model], scenario.station(1).memory.eeprom_writes
    words = [
        scenario.command_to_end(1, "write", {notation: 10.0 + n}, save=True).result_word
        for n in range(CELL_WRITES_PER_DAY // 2)
    ]
    store = scenario.drives[1]._store
    scenario.restart_host()
    scenario.drives[1]._store = scenario.drives[1]._runner._store = store
    scenario.drives[1]._context.eeprom_budget = scenario.drives[1]._eeprom_budget(scenario.drives[1]._context.limits)
    words += [
        scenario.command_to_end(1, "write", {notation: 30.0 + n}, save=True).result_word
        for n in range(CELL_WRITES_PER_DAY // 2 + 5)
    ]
    scenario.expect(words == ["confirmed"] * CELL_WRITES_PER_DAY + ["EepromBudgetExceeded"] * 5, f"{words}")
    scenario.expect(saves.total() == CELL_WRITES_PER_DAY, f"{saves.total()} writes wore the EEPROM")
    if notation in family.matrix.ram_parameters:
        _check_ram_writes(scenario, notation)
    else:
        command = scenario.command_to_end(1, "write", {notation: 12.0})
        scenario.expect(
            command.result_word == "CapabilityError" and saves.total() == CELL_WRITES_PER_DAY,
            f"without save: {command.result_word}",
        )


def _check_ram_writes(scenario: MatrixScenario, notation: str) -> None:
    """Check that RAM writes (class 3, or no 8000H) have no limit and do not wear the EEPROM."""
    mark, memory = len(scenario.requests), scenario.station(1).memory
    for number in range(CELL_WRITES_PER_DAY + 5):
        command = scenario.command_to_end(1, "write", {notation: 12.0 + number % 2})
        scenario.expect(command.result_word == "confirmed", f"RAM write {command.result_word}")
    scenario.expect(
        memory.eeprom_writes.total() == CELL_WRITES_PER_DAY
        and memory.ram_writes.total() >= 2 * CELL_WRITES_PER_DAY + 5,
        "EEPROM worn",
    )
    for request in scenario.requests_since(mark, RequestEffect.SETTING):
        if scenario.variant.model == "c320":
            scenario.expect(class_and_operation(scenario.variant, request.data)[0] == 3, "not class 3")
        else:
            scenario.expect((modbus_write(scenario.variant, request.data) or (0x8000, 0))[0] < 0x8000, "with 8000H")


@cell("toggle", C320, C320_HEX)
def operation_only_after_status(run: CellRun) -> None:
    """Check that only control frames carry an operation, with status reads before each start (T01, T07)."""
    scenario = run.scenario(1)
    for _ in range(2):
        for what in ("run", "run", "set_frequency", "stop"):
            scenario.command_to_end(1, what, *(() if what == "stop" else (run.random_hz(),)))
    scenario.command_to_end(1, "reset_fault")
    scenario.loop.run_until_complete(scenario.drives[1].read(("F0.1", "F9.4")))
    moves = [index for index, request in enumerate(scenario.requests) if request.effect is RequestEffect.MOTION]
    scenario.expect(len(moves) == 2, f"{len(moves)} starts for two runs from standstill")
    for one, other in pairwise([0, *moves]):
        status_reads = [sent for sent in scenario.requests[one:other] if status_read_key(scenario.variant, sent.data)]
        scenario.expect(len(status_reads) >= 2, f"{len(status_reads)} looks before a start")
    for sent in scenario.requests:
        kind, operation = class_and_operation(scenario.variant, sent.data)
        scenario.expect(kind == CONTROL or operation == 0, f"{sent.data.hex()} carries an operation")


@cell("toggle", DZB100)
def jog_ends_with_its_lease(run: CellRun) -> None:
    """Check that a jog ends half a second after its last renewal, and that a longer lease is rejected (T13)."""
    scenario = run.scenario(1)
    scenario.loop.run_until_complete(scenario.drives[1].preflight())
    drive, lease_s = scenario.drives[1], run.rng.uniform(0.2, 0.5)
    motor = scenario.station(1).motor

    async def jog(hz: float) -> Any:
        async with drive.jog(hz, lease_s=lease_s) as lease:
            for _ in range(5):
                await asyncio.sleep(lease_s / 2)
                lease.renew()
            await asyncio.sleep(8.0)  # the hand is gone, the program hangs
            return lease.stop_outcome or lease.start_outcome

    command = scenario.command_by(jog, 1, "jog", 5.0)
    scenario.finish(command)
    scenario.run(2.0)
    move, stop = scenario.requests_since(0, RequestEffect.MOTION)[-1], scenario.requests_since(0, RequestEffect.STOP)[0]
    scenario.expect(motor.starts == 1 and not motor.energised, f"{motor.starts} starts, on: {motor.energised}")
    scenario.expect(stop.start - move.end > 2 * lease_s, "ended while it was renewed")
    scenario.expect(stop.start - move.end < 3.5 * lease_s + 0.5, f"it went on for {stop.start - move.end:.3f} s")
    scenario.expect(_error_of(lambda: drive.jog(5.0, lease_s=0.51)) == "LimitError", "a lease above 0.5 s")


def error_text(command: UserCommand, language: str) -> str:
    """Return the error message of a command in a language; "" without an error."""
    return command.error.text(language) if isinstance(command.error, DrivebusError) else ""


def _error_of(call: Any) -> str:
    try:
        call()
    except Exception as error:
        return type(error).__name__
    return ""


@cell("toggle", VC660)
def one_pulse_per_edge(run: CellRun) -> None:
    """Check that each pulse is written once and cleared before the next."""
    scenario = run.scenario(1)
    for direction in (Direction.FORWARD, Direction.REVERSE):
        scenario.command_to_end(1, "run", run.random_hz(), direction)
        scenario.run(1.0)
        scenario.command_to_end(1, run.rng.choice(("stop", "coast")))
        scenario.run(2.0)
    scenario.station(1).trip(run.rng.choice(list(Trip)))
    scenario.command_to_end(1, "reset_fault")
    words = [
        word[1]
        for request in scenario.requests
        if (word := modbus_write(scenario.variant, request.data)) and word[0] == 0x2000
    ]
    for one, other in pairwise(words):
        scenario.expect(
            not one & VC660_PULSE_BITS or not other & VC660_PULSE_BITS,
            f"{one:04X} and {other:04X} without a fall between them",
        )
    starts, resets = (sum(bool(word & bit) for word in words) for bit in (0x01, 0x200))
    scenario.expect((starts, resets) == (2, 1), f"{starts} starts, {resets} resets")
    scenario.expect(
        scenario.station(1).motor.starts == 2 and scenario.station(1).motor.trip is None, "executed otherwise"
    )


VC660_PULSE_BITS = 0x0001 | 0x0002 | 0x0020 | 0x0040 | 0x0200
"""Pulse bits of the main control word: start, stop, coast, emergency stop, reset."""


@cell("toggle", DF800, DF800_ASCII)
def toggle_is_never_sent(run: CellRun) -> None:
    """Check that no command and no direct request sends 11 in the direction field (T16)."""
    scenario = run.scenario(1)
    for direction in (None, Direction.FORWARD, Direction.REVERSE):
        scenario.command_to_end(1, "run", run.random_hz(), *(() if direction is None else (direction,)))
        scenario.command_to_end(1, "stop")
        scenario.run(3.0)
    scenario.command_to_end(1, "reset_fault")
    for toggle in (0x0C, 0x0D, 0x0E, 0x0F, 0x1C):
        request = modbus.WriteRegister(1, 0x2000, toggle)
        answer = scenario.transact(1, request)
        scenario.expect(answer.error is not None and not answer.sent, f"{toggle:04X} was sent")
        frame = scenario.drives[1].dialect.codec.encode_request(request)
        scenario.expect(not scenario.drives[1].dialect.is_allowed(frame), f"the permissives allow {toggle:04X}")
    words = [
        word[1]
        for sent in scenario.requests
        if (word := modbus_write(scenario.variant, sent.data)) and word[0] == 0x2000
    ]
    scenario.expect(len(words) > 6 and not any(word & 0x0C == 0x0C for word in words), f"{words}")


@cell("toggle", *(variant for variant in COVERED if campaign_of(variant.model).matrix.undocumented_commands(variant)))
def only_documented_commands(run: CellRun) -> None:
    """Check that no run and no direct request sends a command that no document explains."""
    scenario = run.scenario(1)
    for direction in (None, Direction.FORWARD, Direction.REVERSE):
        scenario.command_to_end(1, "run", run.random_hz(), *(() if direction is None else (direction,)))
        scenario.command_to_end(1, "stop")
        scenario.run(3.0)
    starts = scenario.station(1).motor.starts
    scenario.expect(starts == 3, f"{starts} starts for three runs")
    dialect, mark = scenario.drives[1].dialect, len(scenario.requests)
    for request in campaign_of(run.variant.model).matrix.undocumented_commands(run.variant):
        frame = dialect.codec.encode_request(request)
        scenario.expect(not dialect.is_allowed(frame), f"the permissives allow {frame.hex(' ')}")
        answer = scenario.transact(1, request)
        scenario.expect(answer.error is not None and not answer.sent, f"{frame.hex(' ')} was sent")
    scenario.expect(not scenario.requests_since(mark), "something was sent")


@cell("scale", HUANYANG_HY)
def set_frequency_read_back(run: CellRun) -> None:
    """Check that status item 0 must return the frequency before a start: a drive with another scale is not started."""
    scenario, hz = run.scenario(1), run.random_hz()
    command = scenario.command_to_end(1, "run", hz)
    scenario.expect(command.result_word == "confirmed", f"{command.result_word}")
    other = run.scenario(1)
    station, factor = other.station(1), run.rng.choice((10, 0.1))
    answer = station.handle_request

    def scaled(message: Any, codec: Any) -> Any:
        reply = answer(message, codec)
        station.setpoint_hz *= factor if message.function == FREQUENCY else 1
        return reply

    station.handle_request = scaled
    mark, command = len(other.requests), other.command_to_end(1, "run", hz)
    other.expect(
        command.result_word == "failed" and not other.requests_since(mark, RequestEffect.MOTION),
        f"another scale: {command.result_word}",
    )
    other.expect(not station.motor.starts, "started")


@cell("scale", DZB100)
def uncalibrated_scale(run: CellRun) -> None:
    """Check that before calibration no word is sent that means more than 5 Hz in any coding (T08)."""
    for coding in ("hex-0.1", "hex-0.01", "decimal-0.1", "hex-1"):
        scenario = run.scenario(1, setpoint_coding=coding, query_coding=coding)
        scenario.drives[1].close()
        scenario.drives[1] = Drive(scenario.bus, "dzb100", 1)
        for hz in (10.0, 50.0, run.random_hz(0.6, 40)):
            mark, command = len(scenario.requests), scenario.command_to_end(1, "run", hz)
            scenario.expect(
                command.result_word == "LimitError" and not scenario.requests_since(mark),
                f"{hz} Hz: {command.result_word}",
            )
        scenario.finish(
            scenario.command_by(scenario.drives[1].run, 1, "run at the cap", run.rng.choice((0.1, 0.3, 0.5)))
        )
        scenario.run(5.0)
        scenario.expect(scenario.station(1).motor.starts == 1, "not started at the cap")
        scenario.expect(
            abs(scenario.station(1).motor.target_hz) <= 5.0, f"{scenario.station(1).motor.target_hz} Hz under {coding}"
        )
        scenario.command_to_end(1, "stop")


@cell("scale", VC660)
def scale_read_back(run: CellRun) -> None:
    """Check that 3001H must return the frequency before a start: a drive with another scale is not started."""
    scenario, hz = run.scenario(1), run.random_hz()
    mark, command = len(scenario.requests), scenario.command_to_end(1, "run", hz)
    values = [
        word
        for request in scenario.requests_since(mark)
        if (word := modbus_write(scenario.variant, request.data)) and word[0] == 0x2001
    ]
    scenario.expect(
        command.result_word == "confirmed" and values == [(0x2001, round(hz * 100))], f"{command.result_word}: {values}"
    )
    other = run.scenario(1)
    station = other.station(1)
    take, factor = station._set_frequency, run.rng.choice((10, 0.1))
    station._set_frequency = lambda value: take(min(40000, round(value * factor)))
    mark, command = len(other.requests), other.command_to_end(1, "run", hz)
    other.expect(
        command.result_word == "failed" and not other.requests_since(mark, RequestEffect.MOTION),
        f"another scale: {command.result_word}",
    )
    other.expect(not station.motor.starts, "started")


@cell("scale", DF800, DF800_ASCII)
def frequency_source(run: CellRun) -> None:
    """Check that a start is refused, naming F1.01, unless F1.01 = 5 makes 2001H the frequency source."""
    scenario, hz = run.scenario(1), run.random_hz()
    mark, command = len(scenario.requests), scenario.command_to_end(1, "run", hz)
    values = [
        word
        for request in scenario.requests_since(mark)
        if (word := modbus_write(scenario.variant, request.data)) and word[0] == 0x2001
    ]
    scenario.expect(
        command.result_word == "acknowledged" and values == [(0x2001, round(hz * 100))],
        f"{command.result_word}: {values}",
    )
    scenario.expect(
        abs(scenario.station(1).motor.target_hz - hz) < 0.006, f"it goes to {scenario.station(1).motor.target_hz}"
    )
    other = run.scenario(1)
    other.station(1).keypad_set(101, run.rng.choice((0, 1, 3)))
    mark, command = len(other.requests), other.command_to_end(1, "run", hz)
    other.expect(
        command.result_word == "PreflightError" and "F1.01" in error_text(command, "en"), f"{command.result_word}"
    )
    other.expect(
        "F1.01" in error_text(command, "zh")
        and not other.requests_since(mark, RequestEffect.MOTION, RequestEffect.SETTING),
        "something was sent",
    )
