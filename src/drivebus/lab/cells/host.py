"""Rows of the table: the host starts anew while a drive runs; what a drive does when its host dies."""

from __future__ import annotations

from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line
from drivebus.lab.manual import Does

COMM_LOSS_S = 5.0


@case("host_restart")
def host_restarted_while_running(at: Case) -> None:
    """The new host sends reads alone, and says what it finds (ruling 7). C320 stops by itself when nobody speaks."""
    line, hz = at.line(1, 2), at.hz()
    if at.kind.model == "c320":
        line.station(1).press_set(0x9_04, round(COMM_LOSS_S * 10))
    line.running_at(1, hz)
    _restart(at, line, hz)
    if at.kind.model == "c320":
        line.restart()
        line.run(COMM_LOSS_S + 4.0)
        line.expect(not line.station(1).motor.energised, "F9.4 has passed in silence, and it runs")


def _restart(at: Case, line: Line, hz: float) -> None:
    mark, at_s = len(line.sent), line.loop.time()
    line.restart()
    line.run(at.rng.uniform(0.0, 1.0))
    monitors = [line.monitored(address) for address in (1, 2)]
    line.run(20.0)
    line.expect(
        len(line.since(mark)) > 20 and not [o for o in line.sent[mark:] if o.does is not Does.READ], "not only reads"
    )
    line.expect(line.station(1).motor.energised, "what ran was stopped")
    line.expect(not line.station(2).motor.starts, "what stood was started")
    status = monitors[0].status()
    if at.kind.tells:
        line.expect(str(status.state) == "running", f"called {status.state} {line.loop.time() - at_s:.1f} s after")
        line.expect(abs(float(status.readings["output_frequency"].value) - hz) <= 0.11, f"{status.readings}")
    else:
        line.expect(str(status.state) == "unknown", f"called {status.state}")
    stop = line.do(1, "stop")
    line.expect(stop.word == ("confirmed" if at.kind.tells else "acknowledged"), f"the stop is {stop.word}")


@case("comm_loss")
def what_happens_when_the_host_dies(at: Case) -> None:
    """Off is told as off; what no manual says is told as unknown, and never as "it stops"."""
    line = at.line(1)
    report = line.loop.run(line.drives[1].if_host_dies())
    words = {report.text(language) for language in ("en", "zh")}
    line.expect(len(words) == 2 and report.key not in words, f"{report.key} has no words in both languages")
    if at.kind.model != "c320":
        line.expect(report.trips is None and report.key == "drives.host_dies_unpublished", f"{report}")
        return
    line.expect(report.trips is False and report.key == "drives.host_dies_off", f"F9.4 = 0: {report}")
    line.station(1).press_set(0x9_04, at.rng.randrange(10, 100))
    report = line.loop.run(line.drives[1].if_host_dies())
    line.expect(report.trips is None and report.key == "drives.host_dies_unknown", f"F9.3 is not published: {report}")
    line.station(1).faults.silent = True
    report = line.loop.run(line.drives[1].if_host_dies())
    line.expect(report.trips is None and report.key == "drives.host_dies_unread", f"unread: {report}")
