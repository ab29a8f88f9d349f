"""Rows of the table: the host starts anew while a drive runs; what a drive does when its host dies."""

from __future__ import annotations

from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus
from verification.reference.request_effects import RequestEffect

COMM_LOSS_TIMEOUT_S = 5.0


@cell("host_restart")
def host_restarted_while_running(at: CellRun) -> None:
    """The new host sends reads alone, and says what it finds. C320 stops by itself when nobody speaks."""
    line, hz = at.bus(1, 2), at.random_hz()
    if at.kind.model == "c320":
        line.station(1).keypad_set(0x9_04, round(COMM_LOSS_TIMEOUT_S * 10))
    line.start_at(1, hz)
    _check_restart(at, line, hz)
    if at.kind.model == "c320":
        line.restart_host()
        line.run(COMM_LOSS_TIMEOUT_S + 4.0)
        line.expect(not line.station(1).motor.energised, "F9.4 has passed in silence, and it runs")


def _check_restart(at: CellRun, line: MatrixBus, hz: float) -> None:
    mark, at_s = len(line.requests), line.loop.time()
    line.restart_host()
    line.run(at.rng.uniform(0.0, 1.0))
    monitors = [line.monitored(address) for address in (1, 2)]
    line.run(20.0)
    line.expect(
        len(line.requests_since(mark)) > 20
        and not [o for o in line.requests[mark:] if o.effect is not RequestEffect.READ],
        "not only reads",
    )
    line.expect(line.station(1).motor.energised, "what ran was stopped")
    line.expect(not line.station(2).motor.starts, "what stood was started")
    status = monitors[0].status()
    if at.kind.reports_running:
        line.expect(str(status.state) == "running", f"called {status.state} {line.loop.time() - at_s:.1f} s after")
        line.expect(abs(float(status.readings["output_frequency"].value) - hz) <= 0.11, f"{status.readings}")
    else:
        line.expect(str(status.state) == "unknown", f"called {status.state}")
    stop = line.command_to_end(1, "stop")
    line.expect(
        stop.result_word == ("confirmed" if at.kind.reports_running else "acknowledged"),
        f"the stop is {stop.result_word}",
    )


@cell("comm_loss")
def communication_loss_reaction(at: CellRun) -> None:
    """Off is told as off; what no manual says is told as unknown, and never as "it stops"."""
    line = at.bus(1)
    report = line.loop.run_until_complete(line.drives[1].comm_loss_behaviour())
    words = {report.text(language) for language in ("en", "zh")}
    line.expect(len(words) == 2 and report.key not in words, f"{report.key} has no words in both languages")
    if at.kind.model != "c320":
        line.expect(report.stops_on_comm_loss is None and report.key == "drives.comm_loss_unpublished", f"{report}")
        return
    line.expect(report.stops_on_comm_loss is False and report.key == "drives.comm_loss_off", f"F9.4 = 0: {report}")
    line.station(1).keypad_set(0x9_04, at.rng.randrange(10, 100))
    report = line.loop.run_until_complete(line.drives[1].comm_loss_behaviour())
    line.expect(
        report.stops_on_comm_loss is None and report.key == "drives.comm_loss_unknown",
        f"F9.3 is not published: {report}",
    )
    line.station(1).faults.silent = True
    report = line.loop.run_until_complete(line.drives[1].comm_loss_behaviour())
    line.expect(report.stops_on_comm_loss is None and report.key == "drives.comm_loss_unread", f"unread: {report}")
