"""Stopping: asks nobody for leave, repeated until seen, never said to be done when it was not (ruling 5, F17, G07)."""

from __future__ import annotations

from typing import Any

import pytest

from drivebus.drives.dialect import Stop
from drivebus.drives.state import OutcomeWord
from drivebus.drives.stopping import PATIENCE_S, stop
from drivebus.errors import Superseded
from drivebus.message import Answer, Ask, Lane, WriteClass
from drivebus.protocols import dzb, modbus, sifang
from drivekit import PaperC320, PaperModbus, World, dialect_of, talk_of


def c320(paper: PaperC320) -> World:
    return World(dialect_of("c320"), paper)


def stops(paper: PaperC320, request: sifang.Control) -> Any:
    paper.state = sifang.State.STOPPED
    return paper.ok()


def test_a_stop_goes_in_the_stop_lane_without_a_permit_and_before_anything_is_read() -> None:
    world = c320(PaperC320(sifang.State.RUNNING_FORWARD, obey=stops))
    outcome = world.play(stop(talk_of(world.dialect)))
    first = world.asks[0]
    assert isinstance(first.request, sifang.Control)
    assert (first.lane, first.permit, first.expires_at) == (Lane.STOP, None, None)
    assert (outcome.word, outcome.key) == (OutcomeWord.CONFIRMED, "drives.stop_confirmed")


def test_i3_the_levels_after_a_stop_pulse_leave_the_stop_lane_to_other_drives() -> None:
    world = World(dialect_of("vc660"), PaperModbus())
    world.play(stop(talk_of(world.dialect)))
    pulse, levels, *_ = (ask for ask in world.asks if ask.write_class is WriteClass.ABSOLUTE)
    assert (pulse.lane, levels.lane) == (Lane.STOP, Lane.COMMAND)


def test_ruling_1_a_stop_is_not_confirmed_by_its_own_reply() -> None:
    """The drive says yes and runs on."""
    world = c320(PaperC320(sifang.State.RUNNING_FORWARD))
    outcome = world.play(stop(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.stop_unconfirmed")


def test_g07_an_unconfirmed_stop_is_declared_within_two_seconds_of_no_progress() -> None:
    world = c320(PaperC320(sifang.State.RUNNING_FORWARD))
    world.play(stop(talk_of(world.dialect)))
    assert PATIENCE_S < world.now < PATIENCE_S + 0.5


def test_a_lost_stop_is_sent_again_at_once() -> None:
    lost = [1, 1]

    def third(paper: PaperC320, request: sifang.Control) -> Any:
        return None if lost and lost.pop() else stops(paper, request)

    world = c320(PaperC320(sifang.State.RUNNING_FORWARD, obey=third))
    outcome = world.play(stop(talk_of(world.dialect)))
    assert outcome.word is OutcomeWord.CONFIRMED
    assert len(world.sent(sifang.Control)) == 3


def test_ruling_5_no_state_of_the_host_withholds_a_stop() -> None:
    from dataclasses import replace

    world = c320(PaperC320(sifang.State.RUNNING_FORWARD, obey=stops))
    world.around = replace(world.around, latched=True, foreign_master=True, duplicate=True, error_rate=0.9, failures=99)
    assert world.play(stop(talk_of(world.dialect))).word is OutcomeWord.CONFIRMED


@pytest.mark.parametrize("state", [sifang.State.FAULT, sifang.State.NOT_READY])
def test_ruling_5_a_fault_or_an_uncharged_bus_finishes_a_stop_and_is_said_so(state: sifang.State) -> None:
    world = c320(PaperC320(state, fault_code=4))
    outcome = world.play(stop(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.CONFIRMED, "drives.output_off")


def test_an_emergency_stop_state_confirms_a_quick_stop() -> None:
    def quick(paper: PaperC320, request: sifang.Control) -> Any:
        assert request.operation is sifang.Operation.EMERGENCY_STOP
        paper.state = sifang.State.EMERGENCY_STOP
        return paper.ok()

    world = c320(PaperC320(sifang.State.RUNNING_FORWARD, obey=quick))
    assert world.play(stop(talk_of(world.dialect), Stop.QUICK_STOP)).key == "drives.stop_confirmed"


def test_a_drive_that_slows_down_is_given_its_time() -> None:
    """The ramp of C320 is not published: a falling frequency is progress."""

    class Ramps(PaperC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sifang.Control):
                self.state = sifang.State.DECELERATING_FORWARD
            if isinstance(request, sifang.ReadMonitor) and self.state == sifang.State.DECELERATING_FORWARD:
                self.output = max(0, self.output - 20)
                self.state = self.state if self.output else sifang.State.STOPPED
            return super().__call__(request)

    world = c320(Ramps(sifang.State.RUNNING_FORWARD, output=2000))
    outcome = world.play(stop(talk_of(world.dialect)))
    assert outcome.word is OutcomeWord.CONFIRMED
    assert world.now > 2 * PATIENCE_S


def test_a_slowing_drive_is_told_again_every_half_second() -> None:
    world = c320(PaperC320(sifang.State.DECELERATING_FORWARD))
    world.play(stop(talk_of(world.dialect)))
    times = [i for i, ask in enumerate(world.asks) if isinstance(ask.request, sifang.Control)]
    assert len(times) > 100


def test_a_stop_to_a_dead_drive_is_repeated_and_reported() -> None:
    world = c320(PaperC320(silent=True))
    outcome = world.play(stop(talk_of(world.dialect)))
    assert outcome.key == "drives.stop_unconfirmed"
    assert len(world.sent(sifang.Control)) >= 3
    assert all(e.received == b"" for e in outcome.evidence)


def test_one_reading_of_standstill_is_not_enough() -> None:
    """Two out of two: a single flipped status must not end a stop."""
    flips = [sifang.State.STOPPED, sifang.State.RUNNING_FORWARD]

    class Flips(PaperC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sifang.ReadMonitor):
                flips.reverse()
                self.state = flips[0]
            return super().__call__(request)

    world = c320(Flips())
    assert world.play(stop(talk_of(world.dialect))).word is OutcomeWord.UNKNOWN


def test_without_waiting_an_answered_stop_is_said_to_be_unconfirmed() -> None:
    world = c320(PaperC320(sifang.State.RUNNING_FORWARD))
    outcome = world.play(stop(talk_of(world.dialect), wait_for_it=False))
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.stop_answered")
    assert len(world.asks) == 1


def test_t17_df800_is_told_three_times_and_never_confirmed() -> None:
    paper = PaperModbus()
    world = World(dialect_of("df800"), paper)
    outcome = world.play(stop(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.ACKNOWLEDGED, "drives.stop_acknowledged")
    assert paper.written == [(0x2000, 1)] * 3


def test_t17_a_silent_df800_is_unconfirmed() -> None:
    world = World(dialect_of("df800"), PaperModbus(silent=True))
    outcome = world.play(stop(talk_of(world.dialect)))
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.stop_unconfirmed")


def test_vc660_writes_the_levels_after_each_stop_pulse_so_that_a_repeated_stop_acts() -> None:
    """The drive acts on the edge only, and the first pulse is lost: the second must have an edge again."""
    last = [0]

    def edge(paper: PaperModbus, word: int) -> bool:
        fresh = word & ~last[0]
        last[0] = word
        if fresh & 2:
            paper.registers[0x3000] = 0x0001
        return True

    paper = PaperModbus(registers={0x3000: 0x0009}, obey=edge)
    last[0] = 2
    world = World(dialect_of("vc660"), paper)
    outcome = world.play(stop(talk_of(world.dialect)))
    assert outcome.word is OutcomeWord.CONFIRMED
    assert [value for _, value in paper.written][:3] == [0x0002, 0x0000, 0x0002]


def test_dzb100_is_stopped_when_q01_reads_zero_twice_and_q03_repeats_the_stop() -> None:
    class Paper:
        def __init__(self, output: int, state: int) -> None:
            self.output, self.state = output, state

        def __call__(self, request: Any) -> Any:
            if isinstance(request, dzb.Control):
                return dzb.Reply("C", 1, request.index, 0, True)
            if isinstance(request, dzb.ReadParameter):
                return dzb.Reply("R", 1, request.index, 0, True)
            data = {1: self.output, 3: self.state}[request.item]
            return dzb.Reply("Q", 1, request.item, data, True)

    for output, state, word in ((0, 0x0000, "confirmed"), (0, 0x1000, "unknown"), (5, 0x0000, "unknown")):
        world = World(dialect_of("dzb100"), Paper(output, state))
        assert world.play(stop(talk_of(world.dialect))).word == word


def test_g07_each_reading_that_is_lower_is_progress_where_a_look_takes_longer_than_patience() -> None:
    """A DZB100 that slows down from 30 Hz within 3 s and has no ramp to read, on a line with many other drives."""

    def slowing(request: Any) -> Any:
        if isinstance(request, dzb.Control):
            return dzb.Reply("C", 1, request.index, 0, True)
        if isinstance(request, dzb.ReadParameter):
            return dzb.Reply("R", 1, request.index, 0, True)
        output = max(0, round(300 - 100 * world.now))
        return dzb.Reply("Q", 1, request.item, {1: output, 3: 0x0100 * (output > 0)}[request.item], True)

    class Crowded(World):
        def transact(self, ask: Ask) -> Answer:
            self.pass_time(0.35)
            return super().transact(ask)

    world = Crowded(dialect_of("dzb100"), slowing)
    assert world.play(stop(talk_of(world.dialect))).word is OutcomeWord.CONFIRMED
    assert world.now > PATIENCE_S + 3.0


def test_superseded_reads_do_not_end_a_stop() -> None:
    """Two stops at once take each other's reads away: both go on."""
    taken = [1, 1, 1]

    class Taken(PaperC320):
        def __call__(self, request: Any) -> Any:
            if not isinstance(request, sifang.Control) and taken:
                taken.pop()
                return Superseded("bus.superseded", station=1)
            return super().__call__(request)

    world = c320(Taken(sifang.State.RUNNING_FORWARD, obey=stops))
    assert world.play(stop(talk_of(world.dialect))).word is OutcomeWord.CONFIRMED


def test_a_refused_stop_of_a_modbus_drive_is_not_an_answer() -> None:
    class Refuses(PaperModbus):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, modbus.WriteRegister):
                return modbus.ErrorReply(1, 6, None)
            return super().__call__(request)

    world = World(dialect_of("df800"), Refuses())
    assert world.play(stop(talk_of(world.dialect))).key == "drives.stop_unconfirmed"
