"""Starting: once, permitted, confirmed by fenced reads, never resent blindly (rulings 1, 4, 6; matrix 6.4; 6.5)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from drivebus.drives.memory import DriveLimits
from drivebus.drives.operation import Talk
from drivebus.drives.start import run
from drivebus.drives.state import Direction, Outcome, OutcomeWord
from drivebus.errors import (
    CapabilityError,
    Expired,
    GateError,
    LimitError,
    NotReached,
    PreflightError,
    Superseded,
)
from drivebus.message import Effect
from drivebus.protocols import modbus, sifang
from drivekit import PaperC320, PaperModbus, World, dialect_of, memory_of, talk_of

ON_320 = sifang.Operation.RUN_FORWARD_AT


def c320(paper: PaperC320, **limits: Any) -> tuple[World, Talk]:
    dialect = dialect_of("c320")
    return World(dialect, paper), talk_of(dialect, limits=DriveLimits(**limits))


def vc660(paper: PaperModbus) -> tuple[World, Talk]:
    dialect = dialect_of("vc660")
    paper.registers |= {0x3000: 0x0001, 1: 4}
    return World(dialect, paper), talk_of(dialect)


def df800(paper: PaperModbus, **settings: Any) -> tuple[World, Talk]:
    dialect = dialect_of("df800", **settings)
    paper.registers |= {101: 5, 102: 2, 107: 100, 108: 50}
    return World(dialect, paper), talk_of(dialect)


def starts(paper: PaperC320, request: sifang.Control) -> Any:
    paper.state = sifang.State.ACCELERATING_FORWARD
    return paper.ok()


def start(world: World, talk: Talk, hz: float = 10.0, direction: Direction | None = None) -> Outcome:
    return world.play(run(talk, hz, direction))


def test_a_start_is_one_frame_with_its_frequency_and_confirmed_by_later_reads() -> None:
    world, talk = c320(PaperC320(obey=starts))
    outcome = start(world, talk)
    assert outcome.word is OutcomeWord.CONFIRMED
    assert world.sent(sifang.Control) == [sifang.Control(1, ON_320, 1000)]
    assert outcome.evidence[-1].sent_at is not None


def test_ruling_1_a_start_whose_reply_says_ok_is_not_confirmed_by_it() -> None:
    """The drive answers yes and stays where it is: failed, never confirmed."""
    world, talk = c320(PaperC320())
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.start_ignored")
    assert len(world.sent(sifang.Control)) == 1


def test_ruling_2_every_confirming_read_has_a_fence_of_its_own_before_it() -> None:
    world, talk = c320(PaperC320(obey=starts))
    start(world, talk)
    place = next(i for i, ask in enumerate(world.asks) if isinstance(ask.request, sifang.Control))
    after = [ask.request for ask in world.asks[place + 1 :]]
    assert [type(r) for r in after] == [sifang.ReadParameter, sifang.ReadMonitor] * 2
    fences = [r for r in after if isinstance(r, sifang.ReadParameter)]
    assert all(f.group != 0 for f in fences)
    assert fences[0] != fences[1]


def test_ruling_6_an_unanswered_start_is_resent_after_two_fenced_reads_show_standstill() -> None:
    lost = [True]

    def first_is_lost(paper: PaperC320, request: sifang.Control) -> Any:
        return None if lost and lost.pop() else starts(paper, request)

    world, talk = c320(PaperC320(obey=first_is_lost))
    outcome = start(world, talk)
    assert outcome.word is OutcomeWord.CONFIRMED
    places = [i for i, ask in enumerate(world.asks) if isinstance(ask.request, sifang.Control)]
    assert len(places) == 2
    between = [type(ask.request) for ask in world.asks[places[0] + 1 : places[1]]]
    assert between == [sifang.ReadParameter, sifang.ReadMonitor] * 2


def test_ruling_6_a_start_whose_reply_was_lost_is_not_sent_twice() -> None:
    """I2: executed, the reply lost: the reads show running and nothing is repeated."""

    def reply_lost(paper: PaperC320, request: sifang.Control) -> Any:
        paper.state = sifang.State.RUNNING_FORWARD

    world, talk = c320(PaperC320(obey=reply_lost))
    outcome = start(world, talk)
    assert outcome.word is OutcomeWord.CONFIRMED
    assert len(world.sent(sifang.Control)) == 1


def test_ruling_6_a_stop_at_the_keypad_is_never_undone() -> None:
    """Running was seen once after the unanswered start; then a person stops the drive: no resend."""
    reads = []

    def reply_lost(paper: PaperC320, request: sifang.Control) -> Any:
        paper.state = sifang.State.RUNNING_FORWARD

    paper = PaperC320(obey=reply_lost)
    world, talk = c320(paper)

    def person(ask: Any) -> None:
        if isinstance(ask.request, sifang.ReadMonitor) and paper.state == sifang.State.RUNNING_FORWARD:
            reads.append(ask)
            paper.state = sifang.State.STOPPED

    world.on_ask = person
    outcome = start(world, talk)
    assert reads
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.started_and_stopped")
    assert len(world.sent(sifang.Control)) == 1


def test_i1_an_unanswered_start_is_not_resent_once_it_is_two_seconds_old() -> None:
    world, talk = c320(PaperC320(obey=lambda paper, request: None))
    world.silence_s = 2.1
    outcome = start(world, talk)
    assert outcome.word is not OutcomeWord.CONFIRMED
    assert len(world.sent(sifang.Control)) == 1


def test_an_unanswered_start_is_sent_three_times_at_most() -> None:
    world, talk = c320(PaperC320(obey=lambda paper, request: None))
    world.silence_s = world.transaction_s = 0.001
    outcome = start(world, talk)
    assert outcome.word is OutcomeWord.FAILED
    assert len(world.sent(sifang.Control)) == 3


def test_a_stop_that_comes_while_a_start_waits_to_be_confirmed_ends_it() -> None:
    """6.5: the bus counts the stop; the start sees its generation gone and is not resent."""
    world, talk = c320(PaperC320(obey=lambda paper, request: None))

    def stop_comes(ask: Any) -> None:
        if isinstance(ask.request, sifang.Control):
            from dataclasses import replace

            world.around = replace(world.around, generation=world.around.generation + 1)

    world.on_ask = stop_comes
    with pytest.raises(Superseded) as caught:
        start(world, talk)
    assert caught.value.outcome.word is OutcomeWord.UNKNOWN
    assert len(world.sent(sifang.Control)) == 1


def test_a_drive_that_falls_silent_after_the_start_leaves_the_outcome_unknown() -> None:
    def dies(paper: PaperC320, request: sifang.Control) -> Any:
        paper.silent = True

    world, talk = c320(PaperC320(obey=dies))
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.start_unknown")
    assert len(world.sent(sifang.Control)) == 1


def test_a_drive_that_says_no_is_believed() -> None:
    def no(paper: PaperC320, request: sifang.Control) -> Any:
        return sifang.Reply(1, sifang.Response.OUT_OF_RANGE, sifang.State.STOPPED, 0, None, None)

    world, talk = c320(PaperC320(obey=no))
    outcome = start(world, talk)
    assert (outcome.word, outcome.params["code"]) == (OutcomeWord.REFUSED, 1)


def test_a_drive_that_trips_on_the_start_did_not_start() -> None:
    def trips(paper: PaperC320, request: sifang.Control) -> Any:
        paper.state, paper.fault_code = sifang.State.FAULT, 7
        return paper.ok()

    world, talk = c320(PaperC320(obey=trips))
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.start_failed")
    assert outcome.status is not None and outcome.status.fault is not None and outcome.status.fault.code == 7


def test_a_drive_that_turns_the_other_way_is_a_failure() -> None:
    def wrong(paper: PaperC320, request: sifang.Control) -> Any:
        paper.state = sifang.State.RUNNING_REVERSE
        return paper.ok()

    world, talk = c320(PaperC320(obey=wrong))
    outcome = start(world, talk, direction=Direction.FORWARD)
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.wrong_way")


@pytest.mark.parametrize(
    ("hz", "limits", "key"),
    [
        (50.01, {}, "drives.above_maximum"),
        (30.0, {"maximum_hz": 25.0}, "drives.above_maximum"),
        (60.0, {"maximum_hz": 100.0}, "drives.above_maximum"),
        (4.99, {"minimum_hz": 5.0}, "drives.below_minimum"),
        (-1.0, {}, "drives.below_minimum"),
        (float("nan"), {}, "drives.above_maximum"),
        (float("inf"), {}, "drives.above_maximum"),
    ],
)
def test_a_frequency_outside_the_limits_is_refused_before_anything_is_sent(hz: float, limits: Any, key: str) -> None:
    world, talk = c320(PaperC320(), **limits)
    with pytest.raises(LimitError) as caught:
        start(world, talk, hz)
    assert caught.value.key == key
    assert not world.asks


def test_a_forbidden_direction_is_refused_before_anything_is_sent() -> None:
    world, talk = c320(PaperC320(), reverse=False)
    with pytest.raises(LimitError):
        start(world, talk, 10.0, Direction.REVERSE)
    assert not world.asks


def test_a_drive_that_can_not_tell_its_direction_is_not_started_where_one_is_forbidden() -> None:
    dialect = dialect_of("df800")
    world = World(dialect, PaperModbus())
    with pytest.raises(LimitError) as caught:
        start(world, talk_of(dialect, limits=DriveLimits(reverse=False)))
    assert caught.value.key == "drives.direction_forbidden"
    assert not world.asks


def test_what_the_drive_makes_of_a_frequency_is_within_the_limits_too() -> None:
    """In steps of 1 Hz 10.6 Hz is 11 Hz."""
    dialect = dialect_of("dzb100", setpoint_coding="hex-1")
    memory = memory_of(dialect, DriveLimits(maximum_hz=10.6))
    assert memory.check_frequency(10.4) == (10, 10.0)
    with pytest.raises(LimitError) as caught:
        memory.check_frequency(10.6)
    assert caught.value.params["frequency_hz"] == 11.0


def test_ruling_4_a_drive_that_ignores_the_bus_is_named_with_its_keypad_step() -> None:
    world, talk = c320(PaperC320(parameters={(0, 1): 0}))
    with pytest.raises(PreflightError) as caught:
        start(world, talk)
    assert caught.value.params["parameters"] == "F0.1"
    assert str(caught.value) == (
        "c320 at station 1 does not listen to the bus: F0.1 reads 0: Set F0.1 = 2 (frequency from RS485)."
    )
    assert not world.effects()


def test_a_drive_in_fault_is_not_started() -> None:
    world, talk = c320(PaperC320(state=sifang.State.FAULT, fault_code=3))
    with pytest.raises(GateError) as caught:
        start(world, talk)
    assert caught.value.params["state"] == "fault"
    assert not world.effects()


def test_a_drive_whose_state_flickers_is_not_started() -> None:
    states = [sifang.State.STOPPED, sifang.State.FAULT]

    class Flickers(PaperC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sifang.ReadMonitor):
                states.reverse()
                self.state = states[0]
            return super().__call__(request)

    world, talk = c320(Flickers())
    with pytest.raises(GateError):
        start(world, talk)
    assert not world.effects()


def test_a_running_drive_only_gets_its_new_frequency() -> None:
    world, talk = c320(PaperC320(state=sifang.State.RUNNING_FORWARD))
    outcome = start(world, talk, 12.0)
    assert world.sent(sifang.Control) == [sifang.Control(1, sifang.Operation.SET_FREQUENCY, 1200)]
    assert outcome.word is OutcomeWord.ACKNOWLEDGED


def test_a_running_drive_is_not_turned_round() -> None:
    world, talk = c320(PaperC320(state=sifang.State.RUNNING_FORWARD))
    with pytest.raises(GateError) as caught:
        start(world, talk, 12.0, Direction.REVERSE)
    assert caught.value.key == "drives.turning"
    assert not world.effects()


def test_vc660_sets_the_frequency_reads_it_back_and_only_then_starts() -> None:
    def obey(paper: PaperModbus, word: int) -> bool:
        if word & 1:
            paper.registers[0x3000] = 0x0009
        return True

    paper = PaperModbus(obey=obey)
    world, talk = vc660(paper)
    outcome = start(world, talk)
    assert outcome.word is OutcomeWord.CONFIRMED
    assert paper.written == [(0x2001, 1000), (0x2000, 0x0001), (0x2000, 0x0000)]


def test_vc660_that_does_not_take_the_frequency_is_not_started() -> None:
    class Deaf(PaperModbus):
        def __call__(self, request: Any) -> Any:
            reply = super().__call__(request)
            self.registers[0x3001] = 300
            return reply

    paper = Deaf()
    world, talk = vc660(paper)
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.not_started")
    assert [register for register, _ in paper.written] == [0x2001]
    assert Effect.MOTION not in world.effects()


@pytest.mark.parametrize("model", ["vc660", "df800"])
def test_a_start_that_is_withheld_after_its_frequency_left_is_not_told_as_if_nothing_was_sent(model: str) -> None:
    """Ruling 1: Expired and GateError promise that nothing was sent; here the drive holds a new frequency by then."""
    paper = PaperModbus()
    world, talk = vc660(paper) if model == "vc660" else df800(paper)
    world.on_ask = lambda ask: world.pass_time(6.0 if getattr(ask.request, "register", 0) == 0x2001 else 0.0)
    outcome = start(world, talk, 10.0)
    assert outcome.word is OutcomeWord.FAILED and outcome.key == "drives.not_started"
    assert isinstance(outcome.params["why"], Expired)
    assert world.sent(modbus.WriteRegister, register=0x2001) and not world.sent(modbus.WriteRegister, register=0x2000)


def test_a_resend_that_is_not_allowed_any_more_does_not_hide_that_the_start_was_sent() -> None:
    """Ruling 1: GateError promises that nothing was sent. The drive stood twice, so it is known to have failed."""
    world, talk = c320(PaperC320(obey=lambda paper, request: None))

    def seen(ask: Any) -> None:
        if isinstance(ask.request, sifang.Control):
            world.around = replace(world.around, duplicate=True)

    world.on_ask = seen
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.FAILED, "drives.start_ignored")
    assert len(world.sent(sifang.Control)) == 1


def test_what_follows_a_pulse_may_be_withheld_without_hiding_the_pulse() -> None:
    """VC660: another drive shows up at its address between the pulse and its end; the start has left."""
    paper = PaperModbus(obey=lambda paper, word: paper.registers.update({0x3000: 0x0009}) is None)
    world, talk = vc660(paper)

    def seen(ask: Any) -> None:
        if getattr(ask.request, "register", 0) == 0x2000:
            world.around = replace(world.around, duplicate=True)

    world.on_ask = seen
    assert start(world, talk).word is OutcomeWord.CONFIRMED
    assert paper.written == [(0x2001, 1000), (0x2000, 0x0001)]


def test_t13_an_unanswered_pulse_of_vc660_is_not_repeated_when_the_drive_runs() -> None:
    def obeys_silently(paper: PaperModbus, word: int) -> bool:
        if word & 1:
            paper.registers[0x3000] = 0x0009
            return False
        return True

    paper = PaperModbus(obey=obeys_silently)
    world, talk = vc660(paper)
    assert start(world, talk).word is OutcomeWord.CONFIRMED
    assert [value for register, value in paper.written if register == 0x2000] == [0x0001, 0x0000]


def test_ruling_4_df800_is_started_on_its_preflight_and_only_acknowledged() -> None:
    paper = PaperModbus()
    world, talk = df800(paper)
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.ACKNOWLEDGED, "drives.start_acknowledged")
    assert paper.written == [(0x2001, 1000), (0x2000, 0x0002)]
    assert outcome.status is not None and outcome.status.state == "unknown"


def test_df800_reads_its_preflight_before_every_start() -> None:
    paper = PaperModbus()
    world, talk = df800(paper)
    start(world, talk)
    paper.registers[102] = 0
    with pytest.raises(PreflightError) as caught:
        start(world, Talk(talk.memory))
    assert caught.value.params["parameters"] == "F1.02"


def test_an_unanswered_start_of_df800_is_never_resent() -> None:
    paper = PaperModbus(obey=lambda paper, word: False)
    world, talk = df800(paper)
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.UNKNOWN, "drives.start_unknown")
    assert [value for register, value in paper.written if register == 0x2000] == [0x0002]


@pytest.mark.parametrize("direction", list(Direction))
def test_an_explicit_direction_on_df800_waits_for_its_jog_proof(direction: Direction) -> None:
    paper = PaperModbus()
    world, talk = df800(paper)
    with pytest.raises(GateError) as caught:
        start(world, talk, 10.0, direction)
    assert caught.value.key == "drives.direction_unproved"
    assert not world.asks


def test_waiting_is_refused_where_nothing_shows_the_frequency() -> None:
    world, talk = df800(PaperModbus())
    with pytest.raises(CapabilityError):
        world.play(run(talk, 10.0, None, will_wait=True))
    assert not world.asks


def test_a_capability_that_the_model_lacks_is_refused_before_sending() -> None:
    from dataclasses import replace

    dialect = dialect_of("c320")
    dialect.profile = replace(dialect.profile, capabilities=frozenset({"status"}))
    world = World(dialect, PaperC320())
    with pytest.raises(CapabilityError):
        start(world, Talk(memory_of(dialect)))
    assert not world.asks


def test_a_precondition_that_can_not_be_read_is_named_and_not_assumed() -> None:
    """VC660 F01.00: its address is unknown until the user supplies the group sizes."""

    def obey(paper: PaperModbus, word: int) -> bool:
        paper.registers[0x3000] = 0x0009
        return True

    world, talk = vc660(PaperModbus(obey=obey))
    outcome = start(world, talk)
    assert [params["notation"] for key, params in outcome.notes if key == "drives.precondition_unread"] == ["F01.00"]


def test_a_drive_that_runs_at_another_set_frequency_is_not_confirmed() -> None:
    """A class-4 reply could say anything; what the drive shows counts (wrong scale, wrong drive)."""
    from drivebus.drives.start import _with_setpoint

    paper = PaperModbus(registers={0x3001: 100})
    world, talk = vc660(paper)
    paper.registers[0x3001] = 100
    with pytest.raises(NotReached):
        world.play(_with_setpoint(talk, talk.outcome(OutcomeWord.CONFIRMED, "drives.start_confirmed"), 1000, 10.0))


def test_modbus_errors_of_the_drive_are_refusals() -> None:
    class Refuses(PaperModbus):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, modbus.WriteRegister) and request.register == 0x2000:
                return modbus.ErrorReply(1, 6, None)
            return super().__call__(request)

    world, talk = df800(Refuses())
    outcome = start(world, talk)
    assert (outcome.word, outcome.key) == (OutcomeWord.REFUSED, "drives.modbus_refused_short")
