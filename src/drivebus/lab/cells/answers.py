"""Rows of the table: the drive's own errors, and its faults."""

from __future__ import annotations

from typing import Any

from drivebus import i18n
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line
from drivebus.lab.manual import Does
from drivebus.protocols import dzb, modbus, sifang
from drivebus.sim.plate import Trip

WRITES = {"c320": ("F1.10", False), "dzb100": ("10", True), "vc660": ("F00.02", False), "df800": ("F1.07", True)}
CODES = {"c320": (1, 2, 3, 4, 6, 7, 8), "dzb100": (7,), "vc660": (1, 2, 3, 4), "df800": (None,)}
"""The families' tables: C320 2.4.5, DZB100 07H, VC660 section 5, DF800 none."""


def error(kind: Any, code: int | None, request: Any) -> Any:
    """How the family says no with this code."""
    if kind.model == "c320":
        return sifang.Reply(1, sifang.Response(code or 0), sifang.State.STOPPED, request.group, request.item, 0)
    if kind.model == "dzb100":
        return dzb.Reply("P", 1, request.parameter, request.data, False)
    return modbus.ErrorReply(1, 6, code)


@case("error_answer")
def error_answers(at: Case) -> None:
    """Each code refuses the write with its own words in both languages, once: what is locked stays locked."""
    line = at.line(1)
    notation, save = WRITES[at.kind.model]
    codes = CODES[at.kind.model]
    for code in at.rng.sample(codes, len(codes)):
        _refused(line, notation, save, code)


def _refused(line: Line, notation: str, save: bool, code: int | None) -> None:
    station, kind = line.station(1), line.kind
    answer = station.answer

    def refusing(message: Any, codec: Any) -> Any:
        request = getattr(message, "request", message)
        wrote = isinstance(request, sifang.WriteParameter | dzb.WriteParameter | modbus.WriteRegister)
        if not wrote:
            return answer(message, codec)
        found = error(kind, code, request)
        return sifang.Reply(1, found.response) if getattr(found, "response", 0) in (6, 7, 8) else found

    station.answer = refusing
    mark, failed = len(line.sent), line.failures(1)
    wish = line.do(1, "write", {notation: 12.0}, save)
    station.answer = answer
    line.expect(wish.word == "refused", f"code {code}: {wish.word}")
    line.expect(len(line.since(mark, Does.SET)) == 1, f"code {code}: sent {len(line.since(mark, Does.SET))} times")
    line.expect(line.failures(1) == failed, "counted as a failure of the line")
    outcome = wish.outcome
    line.expect(outcome.params.get("code") == code, f"told code {outcome.params}")
    words = {i18n.text(outcome.key, language, **outcome.params) for language in ("en", "zh")}
    line.expect(len(words) == 2 and outcome.key not in words, f"{outcome.key} has no words in both languages")


DZB_LABELS = {2: "E00A", 3: "E00E", 4: "E008", 6: "E00D", 7: "E012", 10: "E004", 11: "E006", 12: "E005", 14: "E001"}
"""CD of Q03 and what the keypad shows, by the note's table."""


@case("status_fault")
def drive_in_fault(at: Case) -> None:
    """The fault and its code as the drive tells them, and no start; DF800 tells nothing, and nothing is made up."""
    line = at.line(1)
    line.loop.run(line.drives[1].preflight())
    station, trip = line.station(1), at.rng.choice(list(Trip))
    line.running_at(1, at.hz())
    station.trip(trip)
    status = line.loop.run(line.drives[1].status())
    if not at.kind.tells:
        line.expect(str(status.state) == "unknown" and status.fault is None, f"{status}")
        line.expect(status.reason == "drives.no_run_status", f"the reason is {status.reason}")
        return
    line.expect(str(status.state) == "fault", f"{status}")
    _named(line, status.fault, station.trip_code(trip))
    mark, wish = len(line.sent), line.do(1, "run", at.hz())
    line.expect(wish.word == "GateError" and not line.since(mark, Does.MOVE), f"a start in fault is {wish.word}")
    if at.kind.model == "c320":
        _item_is_gone(line)


def _named(line: Line, fault: Any, code: int) -> None:
    line.expect(fault is not None and fault.code == code, f"{fault} instead of {code}")
    words = {getattr(fault.text, language) for language in ("en", "zh")}
    line.expect(len(words) == 2 and "" not in words, f"fault {code} has no words in both languages")
    if line.kind.model == "dzb100":
        line.expect(fault.label == DZB_LABELS.get(code, fault.label), f"{code} is called {fault.label}")


def _item_is_gone(line: Line) -> None:
    """T05: the fault's code stands where the item was: values are shown as what can't be placed."""
    readings = line.loop.run(line.drives[1].status(("output_frequency", "dc_bus_voltage"))).readings
    for name in ("output_frequency", "dc_bus_voltage"):
        line.expect(str(readings[name].quality) != "good", f"{name} is {readings[name]}")
        line.expect(readings[name].reason == "drives.item_not_echoed", f"{name}: {readings[name].reason}")
