"""V, R and Q of the table's legend: void and counted, one retry of a read, quarantine and fence, "bad" if it lasts."""

from __future__ import annotations

from drivebus.bus import Kind as Became
from drivebus.lab.cells.alphabet import is_fence
from drivebus.lab.cells.line import Act, Line

STEP_S = 0.05
STALE_S = 3 * 1.0 + 0.4
"""Ruling 12 for the slowest signal that is watched here: max(3 x period, 1 s) + timeout."""


def void(line: Line, act: Act | str, error: str, address: int = 1) -> None:
    """One spoiled answer to a read: void, counted, asked once more, behind a fence: a true answer may still come."""
    wanted, data = line.plain(address)
    failed, mark, events = line.failures(address, error), len(line.sent), len(line.events)
    trick = line.trick(address, act, 1)
    answer = line.ask(address, wanted)
    sent = line.since(mark)
    line.expect(trick.times == 0 and [one.data for one in sent].count(data) == 2, f"asked {len(sent)} times, not twice")
    believed = answer.error is None and answer.attempts == 2 and answer.received == line.said[-1].data
    line.expect(believed, f"the second answer is not what was believed: {answer}")
    line.expect(line.failures(address, error) == failed + 1, f"counted: {line.figures(address).errors}, not {error}")
    told = [event for event in line.events[events:] if event.kind in (Became.VOID, Became.SILENCE)]
    line.expect(len(told) == 1, f"{len(told)} voids in the trace")
    quarantined(line, mark)


def quarantined(line: Line, mark: int) -> None:
    """Q: after the frame at ``mark`` the family's longest lateness in silence, then a fence."""
    first, second = line.sent[mark : mark + 2]
    line.expect(is_fence(line.kind, second.data), f"{second.data.hex()} is no fence")
    line.expect(second.start - first.end >= line.kind.lateness_s, f"fence after {second.start - first.end:.3f} s")


def lasting(line: Line, act: Act | str, address: int = 1) -> None:
    """One void leaves a polled drive good; where it lasts, its values are bad and its state is unknown."""
    monitor = line.monitored(address)
    line.expect(not line.bad(address), "bad before anything happened")
    line.trick(address, act, 1)
    for _ in range(round(2.0 / STEP_S)):
        line.run(STEP_S)
        if line.bad(address):
            line.expect(False, "bad after one void")
            break
    failed, trick = line.failures(address), line.trick(address, act)
    line.run(STALE_S + 1.0)
    line.expect(line.bad(address) and monitor.status().state == "unknown", "still good after 3 periods of voids")
    line.expect(line.failures(address) >= failed + 2, "bad after fewer than two voids")
    trick.times = 0
