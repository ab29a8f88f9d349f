"""Rows of the table: the adapter cuts the last byte, hands bytes over in batches, is pulled out."""

from __future__ import annotations

from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line, Sent
from drivebus.lab.cells.void import void
from drivebus.lab.manual import Does

GOOD = ("confirmed", "acknowledged")


@case("cut_last_byte")
def driver_off_too_early(at: Case) -> None:
    """Ours cuts every frame: no drive hears us, all are told silent. A drive's own cuts one: void and asked again."""
    line = at.line(1, 2, 3)
    line.cuts = True
    for address in (1, 2, 3):
        line.monitored(address)
    line.run(6.0)
    for address in (1, 2, 3):
        line.expect(line.failures(address, "NoReply") >= 2, f"{address}: {line.figures(address).errors}")
        line.expect(str(line.bus.health(address).presence) == "silent", f"{address} is called present")
        line.expect(line.bad(address), f"{address} has values")
    wish = line.do(1, "run", at.hz())
    line.expect(wish.word not in GOOD and not line.station(1).motor.starts, f"run {wish.word}")
    own = at.line(1, 2)
    void(own, lambda say, data, when: say(data, when).dropped.add(len(data) - 1), "NoReply")
    if at.kind.model == "dzb100":
        _waits_for_its_last_byte(at)


def _waits_for_its_last_byte(at: Case) -> None:
    """No end mark: a drive without a timeout takes the next frame's first byte for its last. Nothing may move."""
    line = at.line(1)
    station = line.station(1)
    station.rule = type(station.rule)(1e6, starts=station.rule.starts)
    line.bench._group()
    line.read(1)
    for _ in range(3):
        line.cuts = True
        line.read(1)
        line.cuts = False
        line.run(2.0)
    line.run(8.0)
    line.expect(not station.motor.starts and not station.memory.eeprom_writes.total(), "cut reads did something")
    line.expect(line.read(1).error is None, "never in step again")


@case("batches")
def sixteen_milliseconds(at: Case) -> None:
    """The gap inside an answer is the adapter's: accepted, and commands end as ever."""
    line = at.line(1, 2, weather="batches")
    for address in (1, 2):
        line.monitored(address)
    line.run(3.0)
    wish = line.do(1, "run", at.hz())
    line.expect(wish.word in GOOD and line.station(1).motor.starts == 1, f"run {wish.word}")
    stop = line.do(1, "stop")
    line.expect(stop.word in GOOD, f"stop {stop.word}")
    line.run(3.0)
    for address in (1, 2):
        line.expect(not line.failures(address), f"{address}: {line.figures(address).errors}")
        line.expect(line.figures(address).replies > 5, "few answers")
        line.expect(not line.bad(address), "not accepted")


@case("adapter_lost")
def adapter_pulled_out(at: Case) -> None:
    """While a start is on the wire, and while one is wished: unknown or never sent, told so, and never sent again."""
    for what in (Does.MOVE, Does.READ):
        line = at.line(1, 2)
        line.loop.run(line.drives[1].preflight())
        line.monitored(2)
        _pull_at(at, line, what)
        wish, mark = line.wish(1, "run", at.hz()), len(line.sent)
        line.run(1.0)
        line.expect(not line.bench.wire.plugged, "nothing was pulled")
        _lost(line)
        line.replug()
        line.run(8.0)
        line.finish(wish)
        moves = line.since(mark, Does.MOVE)
        line.expect(wish.word not in GOOD or what is Does.READ, f"told {wish.word}")
        line.expect(len(moves) == (what is Does.MOVE), f"{len(moves)} starts")
        never_sent = ("PortLost", "PreflightError")
        line.expect(wish.word == "unknown" if moves else wish.word in never_sent, f"told {wish.word}, {wish.error!r}")
        line.expect(not line.since(mark, Does.SET) or at.kind.model in ("vc660", "df800"), "a setpoint was sent")
        line.expect(line.bus.is_open and not line.bus.health(2).suspect, "polling does not go on")
        line.expect(not line.bad(2), "no values again")


def _pull_at(at: Case, line: Line, what: Does) -> None:
    """Somewhere within the next frame that does this."""

    def pull(sent: Sent) -> None:
        if sent.address == 1 and sent.does is what:
            line.when_sent = lambda sent: None
            line.loop.call_later(at.rng.uniform(0.0, sent.end - sent.start), line.unplug)

    line.when_sent = pull


def _lost(line: Line) -> None:
    line.expect(not line.bus.is_open, "the port is not told lost")
    for address in (1, 2):
        health = line.bus.health(address)
        line.expect(str(health.presence) == "silent" and health.suspect, f"{address}: {health}")
    line.run(3.5)
    line.expect(line.bad(2), "values without a port")
