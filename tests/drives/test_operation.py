"""What every conversation is made of: fences that prove, frames that are listed, evidence that is bounded."""

from __future__ import annotations

import json
from typing import Any

import pytest

from drivebus import i18n
from drivebus.drives.dialect import Frame
from drivebus.drives.gate import Kind
from drivebus.drives.operation import KEPT_READS, exchange_of
from drivebus.drives.start import run
from drivebus.drives.state import DriveState
from drivebus.drives.talk import Keep, Wait, play
from drivebus.drives.wear import Wear
from drivebus.errors import NoReply, NotPermitted
from drivebus.message import Answer, Ask, Lane, WriteClass
from drivebus.plant.failure import frame_json
from drivebus.protocols import modbus, sifang
from drivekit import PaperC320, PaperModbus, World, dialect_of, talk_of


@pytest.mark.parametrize("register", [0x200B, 0x2002, 0x3000, 0x0200])
def test_t12_a_frame_that_no_table_lists_is_not_sent_by_any_conversation(register: int) -> None:
    world = World(dialect_of("vc660"), PaperModbus())
    talk = talk_of(world.dialect)
    command = talk.memory.command(Kind.WRITE, world.around)
    with pytest.raises(NotPermitted) as caught:
        world.play(talk.act(command, Frame(modbus.WriteRegister(1, register, 1), WriteClass.EDGE)))
    assert caught.value.key == "drives.not_listed"
    assert not world.asks


def test_a_fence_that_the_drive_refuses_proves_nothing() -> None:
    """A short reply (6, 7, 8) echoes the address alone: it could be anybody's late one."""

    class Refuses(PaperC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sifang.ReadParameter):
                return sifang.Reply(1, sifang.Response.BAD_CODE)
            return super().__call__(request)

    world = World(dialect_of("c320"), Refuses())
    talk = talk_of(world.dialect)
    error = world.play(talk.judged())
    assert isinstance(error, NotPermitted) and error.key == "drives.fence_refused"
    assert talk.verdict.state is DriveState.UNKNOWN
    with pytest.raises(NotPermitted):
        world.play(run(talk_of(world.dialect), 10.0, None))
    assert not world.effects()


@pytest.mark.parametrize("language", i18n.LANGUAGES)
def test_evidence_says_what_went_wrong_with_a_frame_in_a_whole_sentence(language: str) -> None:
    silence = NoReply("bus.no_reply", station=1, attempt=2, bytes=0, milliseconds=50)
    frame = json.loads(json.dumps(frame_json(exchange_of(Answer(Ask(1, None), error=silence)))))
    told = i18n.text(frame["error"], language, **frame["params"])
    assert told == silence.text(language) and "{" not in told
    assert frame_json(exchange_of(Answer(Ask(1, None))))["error"] is None


def test_what_was_read_before_a_command_never_shows_its_effect() -> None:
    world = World(dialect_of("c320"), PaperC320(sifang.State.RUNNING_FORWARD))
    talk = talk_of(world.dialect)
    world.play(talk.judged())
    assert talk.verdict.state is DriveState.RUNNING
    world.station = PaperC320(silent=True)
    world.play(talk.judged())
    assert talk.verdict.state is DriveState.UNKNOWN
    assert not talk.book.latest


def test_i12_evidence_is_bounded_and_in_order() -> None:
    world = World(dialect_of("c320"), PaperC320())
    talk = talk_of(world.dialect)
    for _ in range(100):
        world.play(talk.judged())
    evidence = talk.evidence()
    assert len(evidence) == KEPT_READS
    times = [exchange.sent_at or 0.0 for exchange in evidence]
    assert times == sorted(times)


def test_confirming_reads_are_not_in_the_lane_that_a_stop_clears() -> None:
    world = World(dialect_of("c320"), PaperC320())
    world.play(talk_of(world.dialect).judged())
    assert {ask.lane for ask in world.asks} == {Lane.PARAMETER}


def test_a_drive_that_never_agrees_with_itself_is_unknown_and_says_why() -> None:
    turn = [0]

    class Flickers(PaperC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sifang.ReadMonitor):
                turn[0] += 1
                self.state = sifang.State.STOPPED if turn[0] % 2 else sifang.State.EMERGENCY_STOP
            return super().__call__(request)

    world = World(dialect_of("c320"), Flickers())
    talk = talk_of(world.dialect)
    assert world.play(talk.judged()) is None
    assert (talk.verdict.state, talk.verdict.reason) == (DriveState.UNKNOWN, "drives.disagree")


def test_one_failed_round_is_forgiven_and_two_are_not() -> None:
    lost = [1]

    class Loses(PaperC320):
        def __call__(self, request: Any) -> Any:
            if isinstance(request, sifang.ReadMonitor) and lost:
                lost.pop()
                return None
            return super().__call__(request)

    world = World(dialect_of("c320"), Loses())
    talk = talk_of(world.dialect)
    assert world.play(talk.judged()) is None
    assert talk.verdict.state is DriveState.STOPPED
    lost[:] = [1, 1]
    assert world.play(talk.judged()) is not None
    assert talk.verdict.state is DriveState.UNKNOWN


def test_a_conversation_is_a_script_of_values() -> None:
    """Sans-IO: storing is a step, and waiting too."""
    from drivebus.drives.store import MemoryStore

    steps = []

    def world(step: Any) -> Any:
        steps.append(step)

    play(Wear(MemoryStore(), "k").charge("F0.2", "2026-01-01"), world)
    assert [type(step) for step in steps] == [Keep]
    assert not isinstance(steps[0], Wait)
