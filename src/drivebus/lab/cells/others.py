"""Rows of the table: two drives at one address, and a second master."""

from __future__ import annotations

from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line
from drivebus.lab.manual import Does
from drivebus.lab.world.loop import running
from drivebus.sim.models import make_station
from drivebus.sim.station import Station

PEACE_S = 61.0
PAUSE_S = (0.9, 1.5)
"""Our fence after their first question is over by then: a frame that meets ours on the wire can be read by nobody."""
LONGEST = {"c320-ascii": 18, "c320-hex": 18, "dzb100": 11, "vc660": 11, "df800-rtu": 9, "df800-ascii": 19}
"""Characters of the longest answer here: a second one that begins after it is heard whole."""


@case("duplicate_address")
def two_drives_at_one_address(at: Case) -> None:
    """Second answers tell of them: no command leaves but stops. Where their answers collide, nothing is believed."""
    for apart in (True, False):
        line = at.line(1, 2)
        second = make_station(at.kind.model, 1, dict(at.kind.options))
        second.set_ramps(2.0, 2.0)
        if apart:  # right behind the first one's answer, as a drive of another make or firmware
            second.faults.slow_s = line.bench.line.seconds(LONGEST[at.kind.name] + at.rng.uniform(0.5, 1.5))
        with running(line.loop):
            line.bench.add(second)
        for _ in range(6):
            line.read(1)
            line.run(1.0)
        line.expect(line.bus.health(1).duplicate or not apart, "no alarm")
        line.expect(line.kinds("duplicate") >= 2 or not apart, f"counted {line.kinds('duplicate')}")
        line.expect(line.failures(1) >= 6, "counted as good answers")
        _only_stops(at, line, (line.station(1), second))


def _only_stops(at: Case, line: Line, two: tuple[Station, Station]) -> None:
    mark = len(line.sent)
    for what in ("run", "set_frequency"):
        wish = line.do(1, what, at.hz())
        line.expect(wish.word not in ("confirmed", "acknowledged"), f"{what} is {wish.word}")
    line.expect(not line.since(mark, Does.MOVE, Does.SET), "a command was sent")
    line.expect(not any(station.motor.starts for station in two), "started")
    for station in two:
        station.press_run(at.hz())
    line.run(1.0)
    stopping = line.wish(1, "stop")
    line.run(5.0)
    line.expect(line.since(mark, Does.STOP), "a stop was withheld")
    line.expect(not any(station.motor.energised for station in two), "they did not stop")
    line.finish(stopping)


@case("foreign_master")
def second_master(at: Case) -> None:
    """Two requests that we did not send: told, starts blocked, stops not; a minute of peace ends it."""
    line = at.line(1, 2)
    line.loop.run(line.drives[1].preflight())
    _, data = line.plain(2)
    accepted = line.witness.accepted
    for _ in range(2):
        line.expect(not line.bus.health(1).foreign_master, "called a foreign master too early")
        line.stranger(data)
        line.run(at.rng.uniform(*PAUSE_S))
    line.expect(line.bus.health(1).foreign_master and line.bus.health(2).foreign_master, "no alarm within two frames")
    line.expect(line.kinds("master") == 2 and line.witness.accepted == accepted, "not counted, or believed")
    mark = len(line.sent)
    wish = line.do(1, "run", at.hz())
    line.expect(getattr(wish.error, "key", "") == "drives.foreign_master", f"a start is {wish.word}")
    line.expect(not line.since(mark, Does.MOVE) and not line.station(1).motor.starts, "started")
    line.station(1).press_run(at.hz())
    line.run(1.0)
    stop = line.do(1, "stop")
    line.expect(stop.word == ("confirmed" if at.kind.tells else "acknowledged"), f"the stop is {stop.word}")
    line.run(PEACE_S)
    wish = line.do(1, "run", at.hz())
    line.expect(wish.word == ("confirmed" if at.kind.tells else "acknowledged"), f"after a minute: {wish.word}")
