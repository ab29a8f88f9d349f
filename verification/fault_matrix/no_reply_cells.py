"""Rows of the table: no answer to a read, a setpoint, a start, a stop."""

from __future__ import annotations

from itertools import pairwise

from verification.fault_matrix.cell import CellRun, cell
from verification.fault_matrix.frame_fields import shows_standstill, status_read_key
from verification.fault_matrix.matrix_bus import MatrixBus, MatrixRequest
from verification.fault_matrix.void_checks import check_persistent_failure, check_void
from verification.reference.request_effects import RequestEffect

READING_MAX_AGE_S = 2.0
"""No frame of a start is older."""
SETPOINT_MAX_AGE_S = 5.0
IMMEDIATE_MAX_S = 0.3
RECOVERY_MAX_S = 4.0
"""Between two repeated stops of a drive that is not there."""


@cell("no_answer_read")
def no_reply_to_read(at: CellRun) -> None:
    """V, R, Q: whether the drive heard it or not."""
    line = at.bus()
    check_void(line, "mute", "NoReply")
    check_void(line, "deaf", "NoReply")
    check_persistent_failure(line, "deaf")
    line.expect(str(line.bus.health(1).presence) == "offline", "a drive that never answers is called present")


@cell("no_answer_setpoint")
def no_reply_to_setpoint(at: CellRun) -> None:
    """U: never called confirmed by itself. Resent behind a fence where it is absolute; DZB100's is a run command."""
    frame = RequestEffect.MOTION if at.kind.model == "dzb100" else RequestEffect.SETTING
    for lost, ends in (("mute", "done"), ("deaf", "done"), ("always", "open")):
        line, first, second = at.bus(1), at.random_hz(5, 12), at.random_hz(12, 20)
        line.start_at(1, first)
        mark = len(line.requests)
        trick = line.manipulate_replies(1, "deaf" if lost == "always" else lost, 9 if lost == "always" else 1, frame)
        command = line.command_to_end(1, "set_frequency", second)
        line.expect(trick.remaining < 9, "no frame was lost")
        _check_setpoint(line, lost, ends, command.result_word, line.requests_since(mark, frame), mark)
        line.run(3.0)
        taken = abs(line.station(1).motor.target_hz - second) < 0.006
        line.expect(
            taken is (command.result_word in ("confirmed", "acknowledged")), f"{command.result_word}, taken: {taken}"
        )


def _check_setpoint(line: MatrixBus, lost: str, ends: str, word: str, frames: list[MatrixRequest], mark: int) -> None:
    shows = line.kind.model in ("dzb100", "vc660")
    if line.kind.model == "dzb100":  # the frame starts the drive: ruling 6, never resent where it was seen running
        line.expect(len(frames) == 1, f"the run command was sent {len(frames)} times")
        line.expect(word == ("confirmed" if lost == "mute" else "failed"), f"{lost}: {word}")
        return
    good = "confirmed" if shows else "acknowledged"
    line.expect(word == (good if ends == "done" else "failed" if shows else "unknown"), f"{lost}: {word}")
    line.expect(2 <= len(frames) <= 3 and len({one.data for one in frames}) == 1, f"{len(frames)} setpoints")
    line.expect(frames[-1].start - frames[0].start < SETPOINT_MAX_AGE_S, "resent when it was too old")
    for one, other in pairwise(frames):
        between = [sent for sent in line.requests_since(mark) if one.end < sent.start < other.start]
        line.expect(line.sync_probes(between), "resent without a fence")


@cell("no_answer_start")
def no_reply_to_start(at: CellRun) -> None:
    """One execution, ever. Resent only after two fenced reads of standstill, within 2 s; DF800 never."""
    for lost in ("mute", "deaf", "always"):
        line = at.bus(1)
        mark = len(line.requests)
        line.manipulate_replies(
            1, "mute" if lost == "mute" else "deaf", 9 if lost == "always" else 1, RequestEffect.MOTION
        )
        command = line.command_to_end(1, "run", at.random_hz())
        line.run(1.0)
        starts, motor = line.requests_since(mark, RequestEffect.MOTION), line.station(1).motor
        line.expect(
            motor.starts == (lost == "mute" or (lost == "deaf" and at.kind.reports_running)), f"{motor.starts} starts"
        )
        if not at.kind.reports_running:
            line.expect(
                len(starts) == 1 and command.result_word == "unknown",
                f"{len(starts)} starts, told {command.result_word}",
            )
            continue
        expected = {"mute": ("confirmed",), "deaf": ("confirmed",), "always": ("failed", "unknown")}[lost]
        line.expect(command.result_word in expected, f"{lost}: {command.result_word}")
        line.expect(len(starts) == {"mute": 1, "deaf": 2}.get(lost, len(starts)), f"{lost}: {len(starts)} starts")
        _check_start_resent(line, starts)


def _check_start_resent(line: MatrixBus, starts: list[MatrixRequest]) -> None:
    line.expect(len(starts) <= 3, f"sent {len(starts)} times")
    for one, other in pairwise(starts):
        between = [sent for sent in line.requests if one.end < sent.start < other.start]
        text = [text for text in line.replies if one.end < text.start < other.start]
        shown = [
            shows_standstill(line.kind, text.request, text.data)
            for text in text
            if status_read_key(line.kind, text.request)
        ]
        line.expect(len(line.sync_probes(between)) >= 2, "resent without two fences")
        line.expect(len(shown) >= 2 and all(shown), "resent without two reads of standstill")
        line.expect(other.start - starts[0].start < READING_MAX_AGE_S, "resent when it was too old")


@cell("no_answer_stop")
def no_reply_to_stop(at: CellRun) -> None:
    """Resent at once and for ever, and said to be unconfirmed, until the drive shows that it stands."""
    line = at.bus(1)
    line.start_at(1, at.random_hz())
    line.station(1).faults.silent = True
    mark, command = len(line.requests), line.command_to_end(1, "stop")
    line.expect(
        type(command.error).__name__ == "StopUnconfirmed" and line.drives[1].stop_pending, f"told {command.error!r}"
    )
    line.run(at.rng.uniform(15.0, 25.0))
    stops = line.requests_since(mark, RequestEffect.STOP)
    line.expect(stops[1].start - stops[0].end < IMMEDIATE_MAX_S, f"again after {stops[1].start - stops[0].end:.3f} s")
    pauses = [other.start - one.end for one, other in pairwise(stops)]
    line.expect(
        max(pauses) < RECOVERY_MAX_S and line.loop.time() - stops[-1].end < RECOVERY_MAX_S,
        f"paused {max(pauses):.1f} s",
    )
    _check_recovery(line)
    _check_unanswered_stop(at)


def _check_recovery(line: MatrixBus) -> None:
    """From now on it hears: it stops, and is told so only when it stands."""
    line.station(1).faults.silent = False
    end = line.loop.time() + 20.0
    while line.drives[1].stop_pending and line.loop.time() < end:
        line.run(0.05)
    line.expect(not line.drives[1].stop_pending, "repeated though the drive hears again")
    line.expect(not line.kind.reports_running or not line.station(1).motor.energised, "no longer repeated, and it runs")
    if line.kind.reports_running:
        standstill_confirmed_twice(line)
    line.run(3.0)
    mark = len(line.requests)
    line.run(5.0)
    line.expect(
        not line.requests_since(mark, RequestEffect.STOP) and not line.station(1).motor.energised,
        "does not come to rest",
    )


def standstill_confirmed_twice(line: MatrixBus) -> None:
    """Whatever this family shows of standstill, its last two answers to each such question showed it."""
    answers: dict[bytes, list[bool]] = {}
    for text in line.replies:
        shown, question = shows_standstill(line.kind, text.request, text.data), status_read_key(line.kind, text.request)
        if question is not None and shown is not None:
            answers.setdefault(question, []).append(shown)
    wanted = 2 if line.kind.model == "dzb100" else 1
    line.expect(len(answers) == wanted, f"{len(answers)} kinds of questions")
    line.expect(all(len(one) >= 2 and all(one[-2:]) for one in answers.values()), f"taken for standstill: {answers}")


def _check_unanswered_stop(at: CellRun) -> None:
    """The drive obeys and can't say so: that is not known either."""
    line = at.bus(1)
    line.start_at(1, at.random_hz())
    line.station(1).faults.mute = True
    command = line.command_to_end(1, "stop")
    line.run(3.0)
    line.expect(command.result_word == "unknown" and line.drives[1].stop_pending, f"told {command.result_word}")
    line.expect(not line.station(1).motor.energised, "it was told, and runs")
