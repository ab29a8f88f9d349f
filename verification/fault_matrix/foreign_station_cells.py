"""Rows of the table: two drives at one address, and a second master."""

from __future__ import annotations

from drivebus.simulator.models.catalog import make_station
from drivebus.simulator.station import Station
from drivebus.testing.virtual_time import running
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus
from verification.reference.request_effects import RequestEffect

FOREIGN_QUIET_S = 61.0
FOREIGN_PAUSE_S = (0.9, 1.5)
"""Our fence after their first question is over by then: a frame that meets ours on the wire can be read by nobody."""
LONGEST_FRAME = {"c320-ascii": 18, "c320-hex": 18, "dzb100": 11, "vc660": 11, "df800-rtu": 9, "df800-ascii": 19}
"""Characters of the longest answer here: a second one that begins after it is heard whole."""


@cell("duplicate_address")
def duplicate_address(at: CellRun) -> None:
    """Second answers tell of them: no command leaves but stops. Where their answers collide, nothing is believed."""
    for apart in (True, False):
        line = at.bus(1, 2)
        second = make_station(at.kind.model, 1, dict(at.kind.options))
        second.set_ramps(2.0, 2.0)
        if apart:  # right behind the first one's answer, as a drive of another make or firmware
            second.faults.added_delay_s = line.bench.settings.seconds(
                LONGEST_FRAME[at.kind.name] + at.rng.uniform(0.5, 1.5)
            )
        with running(line.loop):
            line.bench.add(second)
        for _ in range(6):
            line.read(1)
            line.run(1.0)
        line.expect(line.bus.health(1).duplicate_address or not apart, "no alarm")
        line.expect(
            line.unsolicited_count("duplicate") >= 2 or not apart, f"counted {line.unsolicited_count('duplicate')}"
        )
        line.expect(line.failure_count(1) >= 6, "counted as good answers")
        _check_only_stops(at, line, (line.station(1), second))


def _check_only_stops(at: CellRun, line: MatrixBus, two: tuple[Station, Station]) -> None:
    mark = len(line.requests)
    for what in ("run", "set_frequency"):
        user_command = line.command_to_end(1, what, at.random_hz())
        line.expect(
            user_command.result_word not in ("confirmed", "acknowledged"), f"{what} is {user_command.result_word}"
        )
    line.expect(not line.requests_since(mark, RequestEffect.MOTION, RequestEffect.SETTING), "a command was sent")
    line.expect(not any(station.motor.starts for station in two), "started")
    for station in two:
        station.keypad_run(at.random_hz())
    line.run(1.0)
    stopping = line.command(1, "stop")
    line.run(5.0)
    line.expect(line.requests_since(mark, RequestEffect.STOP), "a stop was withheld")
    line.expect(not any(station.motor.energised for station in two), "they did not stop")
    line.finish(stopping)


@cell("foreign_master")
def foreign_master(at: CellRun) -> None:
    """Two requests that we did not send: told, starts blocked, stops not; a minute of peace ends it."""
    line = at.bus(1, 2)
    line.loop.run_until_complete(line.drives[1].preflight())
    _, data = line.plain_read(2)
    accepted = line.oracle.accepted_count
    for _ in range(2):
        line.expect(not line.bus.health(1).foreign_master, "called a foreign master too early")
        line.send_foreign(data)
        line.run(at.rng.uniform(*FOREIGN_PAUSE_S))
    line.expect(line.bus.health(1).foreign_master and line.bus.health(2).foreign_master, "no alarm within two frames")
    line.expect(
        line.unsolicited_count("foreign_request") == 2 and line.oracle.accepted_count == accepted,
        "not counted, or believed",
    )
    mark = len(line.requests)
    command = line.command_to_end(1, "run", at.random_hz())
    line.expect(getattr(command.error, "key", "") == "drives.foreign_master", f"a start is {command.result_word}")
    line.expect(not line.requests_since(mark, RequestEffect.MOTION) and not line.station(1).motor.starts, "started")
    line.station(1).keypad_run(at.random_hz())
    line.run(1.0)
    stop = line.command_to_end(1, "stop")
    line.expect(
        stop.result_word == ("confirmed" if at.kind.reports_running else "acknowledged"),
        f"the stop is {stop.result_word}",
    )
    line.run(FOREIGN_QUIET_S)
    command = line.command_to_end(1, "run", at.random_hz())
    line.expect(
        command.result_word == ("confirmed" if at.kind.reports_running else "acknowledged"),
        f"after a minute: {command.result_word}",
    )
