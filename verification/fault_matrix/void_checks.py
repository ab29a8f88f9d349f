"""V, R and Q of the table's legend: void and counted, one retry of a read, quarantine and fence, "bad" if it lasts."""

from __future__ import annotations

from drivebus.bus import TraceKind as Became
from verification.fault_matrix.frame_fields import is_sync_probe
from verification.fault_matrix.matrix_bus import MatrixBus, ReplyAction

VOID_STEP_S = 0.05
STALE_AFTER_S = 3 * 1.0 + 0.4
"""Ruling 12 for the slowest signal that is watched here: max(3 x period, 1 s) + timeout."""


def check_void(line: MatrixBus, act: ReplyAction | str, error: str, address: int = 1) -> None:
    """One spoiled answer to a read: void, counted, asked once more, behind a fence: a true answer may still come."""
    wanted, data = line.plain_read(address)
    failed, mark, events = line.failure_count(address, error), len(line.requests), len(line.events)
    trick = line.manipulate_replies(address, act, 1)
    answer = line.transact(address, wanted)
    sent = line.requests_since(mark)
    line.expect(
        trick.remaining == 0 and [one.data for one in sent].count(data) == 2, f"asked {len(sent)} times, not twice"
    )
    believed = answer.error is None and answer.attempts == 2 and answer.received == line.replies[-1].data
    line.expect(believed, f"the second answer is not what was believed: {answer}")
    line.expect(
        line.failure_count(address, error) == failed + 1, f"counted: {line.statistics(address).errors}, not {error}"
    )
    message = [event for event in line.events[events:] if event.kind in (Became.INVALID, Became.NO_REPLY)]
    line.expect(len(message) == 1, f"{len(message)} voids in the trace")
    check_quarantine(line, mark)


def check_quarantine(line: MatrixBus, mark: int) -> None:
    """Q: after the frame at ``mark`` the family's longest lateness in silence, then a fence."""
    first, second = line.requests[mark : mark + 2]
    line.expect(is_sync_probe(line.kind, second.data), f"{second.data.hex()} is no fence")
    line.expect(
        second.start - first.end >= line.kind.max_reply_lateness_s, f"fence after {second.start - first.end:.3f} s"
    )


def check_persistent_failure(line: MatrixBus, act: ReplyAction | str, address: int = 1) -> None:
    """One void leaves a polled drive good; where it lasts, its values are bad and its state is unknown."""
    monitor = line.monitored(address)
    line.expect(not line.has_bad_quality(address), "bad before anything happened")
    line.manipulate_replies(address, act, 1)
    for _ in range(round(2.0 / VOID_STEP_S)):
        line.run(VOID_STEP_S)
        if line.has_bad_quality(address):
            line.expect(False, "bad after one void")
            break
    failed, trick = line.failure_count(address), line.manipulate_replies(address, act)
    line.run(STALE_AFTER_S + 1.0)
    line.expect(
        line.has_bad_quality(address) and monitor.status().state == "unknown", "still good after 3 periods of voids"
    )
    line.expect(line.failure_count(address) >= failed + 2, "bad after fewer than two voids")
    trick.remaining = 0
