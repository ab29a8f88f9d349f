"""Rows of the table: no answer to a read, a setpoint, a start, a stop."""

from __future__ import annotations

from itertools import pairwise

from drivebus.lab.cells.alphabet import looks, stands
from drivebus.lab.cells.cell import Case, case
from drivebus.lab.cells.line import Line, Sent
from drivebus.lab.cells.void import lasting, void
from drivebus.lab.manual import Does

AGE_S = 2.0
"""Ruling 12: no frame of a start is older."""
SETPOINT_AGE_S = 5.0
AT_ONCE_S = 0.3
SLOWEST_S = 4.0
"""Between two repeated stops of a drive that is not there."""


@case("no_answer_read")
def no_answer_to_a_read(at: Case) -> None:
    """V, R, Q: whether the drive heard it or not."""
    line = at.line()
    void(line, "mute", "NoReply")
    void(line, "deaf", "NoReply")
    lasting(line, "deaf")
    line.expect(str(line.bus.health(1).presence) == "silent", "a drive that never answers is called present")


@case("no_answer_setpoint")
def no_answer_to_a_setpoint(at: Case) -> None:
    """U: never called confirmed by itself. Resent behind a fence where it is absolute; DZB100's is a run command."""
    frame = Does.MOVE if at.kind.model == "dzb100" else Does.SET
    for lost, ends in (("mute", "done"), ("deaf", "done"), ("always", "open")):
        line, first, second = at.line(1), at.hz(5, 12), at.hz(12, 20)
        line.running_at(1, first)
        mark = len(line.sent)
        trick = line.trick(1, "deaf" if lost == "always" else lost, 9 if lost == "always" else 1, frame)
        wish = line.do(1, "set_frequency", second)
        line.expect(trick.times < 9, "no frame was lost")
        _setpoint(line, lost, ends, wish.word, line.since(mark, frame), mark)
        line.run(3.0)
        taken = abs(line.station(1).motor.target_hz - second) < 0.006
        line.expect(taken is (wish.word in ("confirmed", "acknowledged")), f"{wish.word}, taken: {taken}")


def _setpoint(line: Line, lost: str, ends: str, word: str, frames: list[Sent], mark: int) -> None:
    shows = line.kind.model in ("dzb100", "vc660")
    if line.kind.model == "dzb100":  # the frame starts the drive: ruling 6, never resent where it was seen running
        line.expect(len(frames) == 1, f"the run command was sent {len(frames)} times")
        line.expect(word == ("confirmed" if lost == "mute" else "failed"), f"{lost}: {word}")
        return
    good = "confirmed" if shows else "acknowledged"
    line.expect(word == (good if ends == "done" else "failed" if shows else "unknown"), f"{lost}: {word}")
    line.expect(2 <= len(frames) <= 3 and len({one.data for one in frames}) == 1, f"{len(frames)} setpoints")
    line.expect(frames[-1].start - frames[0].start < SETPOINT_AGE_S, "resent when it was too old")
    for one, other in pairwise(frames):
        between = [sent for sent in line.since(mark) if one.end < sent.start < other.start]
        line.expect(line.fences(between), "resent without a fence")


@case("no_answer_start")
def no_answer_to_a_start(at: Case) -> None:
    """One execution, ever. Resent only after two fenced reads of standstill, within 2 s; DF800 never."""
    for lost in ("mute", "deaf", "always"):
        line = at.line(1)
        mark = len(line.sent)
        line.trick(1, "mute" if lost == "mute" else "deaf", 9 if lost == "always" else 1, Does.MOVE)
        wish = line.do(1, "run", at.hz())
        line.run(1.0)
        starts, motor = line.since(mark, Does.MOVE), line.station(1).motor
        line.expect(motor.starts == (lost == "mute" or (lost == "deaf" and at.kind.tells)), f"{motor.starts} starts")
        if not at.kind.tells:
            line.expect(len(starts) == 1 and wish.word == "unknown", f"{len(starts)} starts, told {wish.word}")
            continue
        expected = {"mute": ("confirmed",), "deaf": ("confirmed",), "always": ("failed", "unknown")}[lost]
        line.expect(wish.word in expected, f"{lost}: {wish.word}")
        line.expect(len(starts) == {"mute": 1, "deaf": 2}.get(lost, len(starts)), f"{lost}: {len(starts)} starts")
        _resent(line, starts)


def _resent(line: Line, starts: list[Sent]) -> None:
    line.expect(len(starts) <= 3, f"sent {len(starts)} times")
    for one, other in pairwise(starts):
        between = [sent for sent in line.sent if one.end < sent.start < other.start]
        said = [said for said in line.said if one.end < said.start < other.start]
        shown = [stands(line.kind, said.request, said.data) for said in said if looks(line.kind, said.request)]
        line.expect(len(line.fences(between)) >= 2, "resent without two fences")
        line.expect(len(shown) >= 2 and all(shown), "resent without two reads of standstill")
        line.expect(other.start - starts[0].start < AGE_S, "resent when it was too old")


@case("no_answer_stop")
def no_answer_to_a_stop(at: Case) -> None:
    """Resent at once and for ever, and said to be unconfirmed, until the drive shows that it stands."""
    line = at.line(1)
    line.running_at(1, at.hz())
    line.station(1).faults.silent = True
    mark, wish = len(line.sent), line.do(1, "stop")
    line.expect(type(wish.error).__name__ == "StopUnconfirmed" and line.drives[1].stop_pending, f"told {wish.error!r}")
    line.run(at.rng.uniform(15.0, 25.0))
    stops = line.since(mark, Does.STOP)
    line.expect(stops[1].start - stops[0].end < AT_ONCE_S, f"again after {stops[1].start - stops[0].end:.3f} s")
    pauses = [other.start - one.end for one, other in pairwise(stops)]
    line.expect(max(pauses) < SLOWEST_S and line.loop.time() - stops[-1].end < SLOWEST_S, f"paused {max(pauses):.1f} s")
    _heard_again(line)
    _unanswered(at)


def _heard_again(line: Line) -> None:
    """From now on it hears: it stops, and is told so only when it stands."""
    line.station(1).faults.silent = False
    end = line.loop.time() + 20.0
    while line.drives[1].stop_pending and line.loop.time() < end:
        line.run(0.05)
    line.expect(not line.drives[1].stop_pending, "repeated though the drive hears again")
    line.expect(not line.kind.tells or not line.station(1).motor.energised, "no longer repeated, and it runs")
    if line.kind.tells:
        shown_twice(line)
    line.run(3.0)
    mark = len(line.sent)
    line.run(5.0)
    line.expect(not line.since(mark, Does.STOP) and not line.station(1).motor.energised, "does not come to rest")


def shown_twice(line: Line) -> None:
    """Whatever this family shows of standstill, its last two answers to each such question showed it."""
    answers: dict[bytes, list[bool]] = {}
    for said in line.said:
        shown, question = stands(line.kind, said.request, said.data), looks(line.kind, said.request)
        if question is not None and shown is not None:
            answers.setdefault(question, []).append(shown)
    wanted = 2 if line.kind.model == "dzb100" else 1
    line.expect(len(answers) == wanted, f"{len(answers)} kinds of questions")
    line.expect(all(len(one) >= 2 and all(one[-2:]) for one in answers.values()), f"taken for standstill: {answers}")


def _unanswered(at: Case) -> None:
    """The drive obeys and can't say so: that is not known either."""
    line = at.line(1)
    line.running_at(1, at.hz())
    line.station(1).faults.mute = True
    wish = line.do(1, "stop")
    line.run(3.0)
    line.expect(wish.word == "unknown" and line.drives[1].stop_pending, f"told {wish.word}")
    line.expect(not line.station(1).motor.energised, "it was told, and runs")
