"""Rows of the table: the drive's own errors, and its faults."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.simulator.motor import Trip
from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.matrix_bus import MatrixBus
from verification.reference.request_effects import RequestEffect

REJECTED_WRITES = {
    "c320": ("F1.10", False),
    "dzb100": ("10", True),
    "vc660": ("F00.02", False),
    "df800": ("F1.07", True),
}
ERROR_CODES = {"c320": (1, 2, 3, 4, 6, 7, 8), "dzb100": (7,), "vc660": (1, 2, 3, 4), "df800": (None,)}
"""The families' tables: C320 2.4.5, DZB100 07H, VC660 section 5, DF800 none."""


def error_reply(kind: Any, code: int | None, request: Any) -> Any:
    """How the family says no with this code."""
    if kind.model == "c320":
        return sunfar.SunfarReply(
            1, sunfar.SunfarResponse(code or 0), sunfar.SunfarState.STOPPED, request.group, request.item, 0
        )
    if kind.model == "dzb100":
        return dzb100.Dzb100Reply("P", 1, request.parameter, request.data, False)
    return modbus.ExceptionReply(1, 6, code)


@cell("error_answer")
def error_answers(at: CellRun) -> None:
    """Each code refuses the write with its own words in both languages, once: what is locked stays locked."""
    line = at.bus(1)
    notation, save = REJECTED_WRITES[at.kind.model]
    codes = ERROR_CODES[at.kind.model]
    for code in at.rng.sample(codes, len(codes)):
        _check_rejected(line, notation, save, code)


def _check_rejected(line: MatrixBus, notation: str, save: bool, code: int | None) -> None:
    station, kind = line.station(1), line.kind
    answer = station.handle_request

    def refusing(message: Any, codec: Any) -> Any:
        request = getattr(message, "request", message)
        wrote = isinstance(request, sunfar.SunfarWriteParameter | dzb100.Dzb100WriteParameter | modbus.WriteRegister)
        if not wrote:
            return answer(message, codec)
        found = error_reply(kind, code, request)
        return sunfar.SunfarReply(1, found.response) if getattr(found, "response", 0) in (6, 7, 8) else found

    station.handle_request = refusing
    mark, failed = len(line.requests), line.failure_count(1)
    command = line.command_to_end(1, "write", {notation: 12.0}, save)
    station.handle_request = answer
    line.expect(command.result_word == "refused", f"code {code}: {command.result_word}")
    line.expect(
        len(line.requests_since(mark, RequestEffect.SETTING)) == 1,
        f"code {code}: sent {len(line.requests_since(mark, RequestEffect.SETTING))} times",
    )
    line.expect(line.failure_count(1) == failed, "counted as a failure of the line")
    outcome = command.outcome
    line.expect(outcome.params.get("code") == code, f"told code {outcome.params}")
    words = {i18n.text(outcome.key, language, **outcome.params) for language in ("en", "zh")}
    line.expect(len(words) == 2 and outcome.key not in words, f"{outcome.key} has no words in both languages")


DZB100_FAULT_LABELS = {
    2: "E00A",
    3: "E00E",
    4: "E008",
    6: "E00D",
    7: "E012",
    10: "E004",
    11: "E006",
    12: "E005",
    14: "E001",
}
"""CD of Q03 and what the keypad shows, by the note's table."""


@cell("status_fault")
def drive_in_fault(at: CellRun) -> None:
    """The fault and its code as the drive tells them, and no start; DF800 tells nothing, and nothing is made up."""
    line = at.bus(1)
    line.loop.run_until_complete(line.drives[1].preflight())
    station, trip = line.station(1), at.rng.choice(list(Trip))
    line.start_at(1, at.random_hz())
    station.trip(trip)
    status = line.loop.run_until_complete(line.drives[1].status())
    if not at.kind.reports_running:
        line.expect(str(status.state) == "unknown" and status.fault is None, f"{status}")
        line.expect(status.reason == "drives.no_run_status", f"the reason is {status.reason}")
        return
    line.expect(str(status.state) == "fault", f"{status}")
    _check_fault_named(line, status.fault, station.trip_code(trip))
    mark, command = len(line.requests), line.command_to_end(1, "run", at.random_hz())
    line.expect(
        command.result_word == "StartInhibited" and not line.requests_since(mark, RequestEffect.MOTION),
        f"a start in fault is {command.result_word}",
    )
    if at.kind.model == "c320":
        _check_item_missing(line)


def _check_fault_named(line: MatrixBus, fault: Any, code: int) -> None:
    line.expect(fault is not None and fault.code == code, f"{fault} instead of {code}")
    words = {getattr(fault.text, language) for language in ("en", "zh")}
    line.expect(len(words) == 2 and "" not in words, f"fault {code} has no words in both languages")
    if line.kind.model == "dzb100":
        line.expect(fault.label == DZB100_FAULT_LABELS.get(code, fault.label), f"{code} is called {fault.label}")


def _check_item_missing(line: MatrixBus) -> None:
    """T05: the fault's code stands where the item was: values are shown as what can't be placed."""
    readings = line.loop.run_until_complete(line.drives[1].status(("output_frequency", "dc_bus_voltage"))).readings
    for name in ("output_frequency", "dc_bus_voltage"):
        line.expect(str(readings[name].quality) != "good", f"{name} is {readings[name]}")
        line.expect(readings[name].reason == "drives.item_not_echoed", f"{name}: {readings[name].reason}")
