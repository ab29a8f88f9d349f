"""Rows of the table: frames to everybody."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from drivebus.drives import StopReport, bus_stop
from drivebus.errors import NotPermitted
from drivebus.lab.cells.alphabet import looks
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line, Sent
from drivebus.lab.manual import Does
from drivebus.lab.world.loop import running
from drivebus.message import Ask, Lane
from drivebus.protocols import dzb, modbus, sifang


def to_everybody(kind: Any) -> Iterator[Any]:
    """Starts, jogs, setpoints, resets and parameter writes to the family's broadcast address."""
    if kind.model == "c320":
        for operation in ("RUN_FORWARD", "RUN_REVERSE_AT", "JOG_FORWARD", "SET_FREQUENCY", "RESET_FAULT"):
            yield sifang.Control(31, sifang.Operation[operation], 0)
        yield sifang.WriteParameter(31, 1, 10, 0, False)
    elif kind.model == "dzb100":
        for command in ("FORWARD", "REVERSE", "JOG_FORWARD", "RESET"):
            yield dzb.Control(0, dzb.Command[command], 0, everyone=True)
    else:
        words = ((0x2000, 0x01), (0x2000, 0x02), (0x2000, 0x10), (0x2000, 0x200), (0x2001, 500), (2, 500))
        stop = 0x02 if kind.model == "vc660" else 0x01
        for register, value in words:
            if (register, value) != (0x2000, stop):
                yield modbus.WriteRegister(0, register, value)


@case("broadcast_other")
def nothing_but_stops_to_everybody(at: Case) -> None:
    """Never sent, from whatever lane and through whichever station somebody tries it."""
    line = at.line(1, 2)
    mark = len(line.sent)
    for wanted in to_everybody(at.kind):
        for station in (1, at.kind.broadcast or 0):
            answer = line.loop.run(line.bus.transact(Ask(station, wanted, at.rng.choice(list(Lane)))))
            line.expect(isinstance(answer.error, NotPermitted) and not answer.sent, f"{wanted}: {answer.error!r}")
    line.run(1.0)
    line.expect(not line.since(mark), "something was sent")
    line.expect(not any(line.station(a).motor.starts for a in (1, 2)), "started")


@case("broadcast_stop")
def stop_to_everybody(at: Case) -> None:
    """To the family's address where it has one, awaiting no answer, then each drive by itself until it shows it."""
    line = at.line(1, 2, 3)
    for address in (1, 2):
        line.running_at(address, at.hz())
    line.station(3).press_run(at.hz())
    line.run(1.0)
    mark = len(line.sent)
    report = _stop_all(line)
    line.run(4.0)
    sent = line.since(mark)
    everybody = [one for one in sent if one.address == at.kind.broadcast]
    if at.kind.model == "df800":
        line.expect(not everybody, "a broadcast that nobody documented")
    else:
        _heard_by_all(line, everybody, sent)
    for address in (1, 2, 3):
        line.expect(any(o.does is Does.STOP and o.address == address for o in sent), f"{address} was not told itself")
        looked = any(o.address == address and looks(line.kind, o.data) for o in sent)
        line.expect(looked or not at.kind.tells, f"{address} was not looked at")
        line.expect(not line.station(address).motor.energised, f"{address} runs")
    words = {outcome.word.value for _, outcome in report.outcomes}
    line.expect(words == {"confirmed" if at.kind.tells else "acknowledged"}, f"told {words}")
    line.expect(report.confirmed is at.kind.tells, "confirmed what nobody showed")
    _one_is_deaf(at)


def _heard_by_all(line: Line, everybody: list[Sent], sent: list[Sent]) -> None:
    line.expect(sent[0] in everybody and sent[0].does is Does.STOP, "the broadcast is not the first frame")
    line.expect(all(one.does in (Does.STOP, Does.REST) for one in everybody), "a broadcast that is no stop")
    if line.kind.model == "dzb100":
        line.expect(all(one.data[2:5] == b"\x0200" for one in everybody), "A is not 02, or the address not 00")


def _stop_all(line: Line) -> StopReport:
    """As a user does it: each drive's stop is a wish of its own."""
    wishes = [line.witness.wished(address, "stop", ("everybody",)) for address in line.drives]

    async def stop() -> StopReport:
        report = await bus_stop(line.bus, list(line.drives.values()))
        line.bus.release()
        return report

    report: StopReport = line.loop.run(stop())
    with running(line.loop):
        for wish, (_, outcome) in zip(wishes, report.outcomes, strict=True):
            wish.outcome = outcome
            line.witness.ended(wish)
    return report


def _one_is_deaf(at: Case) -> None:
    """What does not show that it stands is named."""
    line = at.line(1, 2)
    line.running_at(1, at.hz())
    line.station(1).faults.silent = True
    report = _stop_all(line)
    line.expect(1 in report.unconfirmed and not report.confirmed, f"{report.outcomes}")
    line.expect(line.drives[1].stop_pending, "not repeated")
