"""Rows of the table: frames to everybody."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus.bus.messages import BusRequest, RequestPriority
from drivebus.drives import StopReport, stop_bus
from drivebus.errors import NotPermitted
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.testing.virtual_time import running
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.frame_fields import status_read_key
from verification.fault_matrix.matrix_bus import MatrixBus, MatrixRequest
from verification.reference.request_effects import RequestEffect


def forbidden_broadcasts(kind: Any) -> Iterator[Any]:
    """Starts, jogs, setpoints, resets and parameter writes to the family's broadcast address."""
    if kind.model == "c320":
        for operation in ("RUN_FORWARD", "RUN_REVERSE_AT", "JOG_FORWARD", "SET_FREQUENCY", "RESET_FAULT"):
            yield sunfar.SunfarControl(31, sunfar.SunfarOperation[operation], 0)
        yield sunfar.SunfarWriteParameter(31, 1, 10, 0, False)
    elif kind.model == "dzb100":
        for command in ("FORWARD", "REVERSE", "JOG_FORWARD", "RESET"):
            yield dzb100.Dzb100Control(0, dzb100.Dzb100Command[command], 0, broadcast=True)
    else:
        words = ((0x2000, 0x01), (0x2000, 0x02), (0x2000, 0x10), (0x2000, 0x200), (0x2001, 500), (2, 500))
        stop = 0x02 if kind.model == "vc660" else 0x01
        for register, value in words:
            if (register, value) != (0x2000, stop):
                yield modbus.WriteRegister(0, register, value)


@cell("broadcast_other")
def only_stops_are_broadcast(at: CellRun) -> None:
    """Never sent, from whatever lane and through whichever station somebody tries it."""
    line = at.bus(1, 2)
    mark = len(line.requests)
    for wanted in forbidden_broadcasts(at.kind):
        for station in (1, at.kind.broadcast or 0):
            answer = line.loop.run_until_complete(
                line.bus.transact(BusRequest(station, wanted, at.rng.choice(list(RequestPriority))))
            )
            line.expect(isinstance(answer.error, NotPermitted) and not answer.sent, f"{wanted}: {answer.error!r}")
    line.run(1.0)
    line.expect(not line.requests_since(mark), "something was sent")
    line.expect(not any(line.station(a).motor.starts for a in (1, 2)), "started")


@cell("broadcast_stop")
def broadcast_stop(at: CellRun) -> None:
    """To the family's address where it has one, awaiting no answer, then each drive by itself until it shows it."""
    line = at.bus(1, 2, 3)
    for address in (1, 2):
        line.start_at(address, at.random_hz())
    line.station(3).keypad_run(at.random_hz())
    line.run(1.0)
    mark = len(line.requests)
    report = _stop_all(line)
    line.run(4.0)
    sent = line.requests_since(mark)
    everybody = [one for one in sent if one.address == at.kind.broadcast]
    if at.kind.model == "df800":
        line.expect(not everybody, "a broadcast that nobody documented")
    else:
        _check_all_stopped(line, everybody, sent)
    for address in (1, 2, 3):
        line.expect(
            any(o.effect is RequestEffect.STOP and o.address == address for o in sent), f"{address} was not told itself"
        )
        looked = any(o.address == address and status_read_key(line.kind, o.data) for o in sent)
        line.expect(looked or not at.kind.reports_running, f"{address} was not looked at")
        line.expect(not line.station(address).motor.energised, f"{address} runs")
    words = {outcome.status.value for _, outcome in report.outcomes}
    line.expect(words == {"confirmed" if at.kind.reports_running else "acknowledged"}, f"told {words}")
    line.expect(report.confirmed is at.kind.reports_running, "confirmed what nobody showed")
    _check_deaf_drive_named(at)


def _check_all_stopped(line: MatrixBus, everybody: list[MatrixRequest], sent: list[MatrixRequest]) -> None:
    line.expect(sent[0] in everybody and sent[0].effect is RequestEffect.STOP, "the broadcast is not the first frame")
    line.expect(
        all(one.effect in (RequestEffect.STOP, RequestEffect.RELEASE) for one in everybody),
        "a broadcast that is no stop",
    )
    if line.kind.model == "dzb100":
        line.expect(all(one.data[2:5] == b"\x0200" for one in everybody), "A is not 02, or the address not 00")


def _stop_all(line: MatrixBus) -> StopReport:
    """As a user does it: each drive's stop is a wish of its own."""
    commands = [line.oracle.on_command(address, "stop", ("everybody",)) for address in line.drives]

    async def stop() -> StopReport:
        report = await stop_bus(line.bus, list(line.drives.values()))
        line.bus.release_start()
        return report

    report: StopReport = line.loop.run_until_complete(stop())
    with running(line.loop):
        for command, (_, outcome) in zip(commands, report.outcomes, strict=True):
            command.outcome = outcome
            line.oracle.on_command_ended(command)
    return report


def _check_deaf_drive_named(at: CellRun) -> None:
    """What does not show that it stands is named."""
    line = at.bus(1, 2)
    line.start_at(1, at.random_hz())
    line.station(1).faults.silent = True
    report = _stop_all(line)
    line.expect(1 in report.unconfirmed and not report.confirmed, f"{report.outcomes}")
    line.expect(line.drives[1].stop_pending, "not repeated")
