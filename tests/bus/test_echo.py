"""Two-wire adapters give our own frames back; a wrong setting never forges an acknowledgement (F03, G19, T21)."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from buskit import TIMING, C, Station, ask_read, ask_write, byte_by_byte, core, whole, wire
from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoState
from drivebus.errors import LineFault, PortLost
from drivebus.line import LineSettings
from drivebus.message import Ask, Effect, Lane, Permit, StationLink, WriteClass
from drivebus.protocols import sifang
from drivebus.testing.playbook import Playbook, Wire


def echoing(inner: Wire, late_s: float = 0.0, pieces: bool = True) -> Wire:
    """An adapter that gives back every byte as it leaves, or in one batch a little later."""

    def adapter(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        begins = ended_at - len(frame) * C
        yield from (byte_by_byte if pieces else whole)(frame, begins + late_s)
        yield from inner(frame, ended_at)

    return adapter


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("pieces", [True, False])
def test_an_echo_is_detected_and_removed(paced: bool, pieces: bool) -> None:
    play = Playbook(core(1, paced=paced, echo="detect"), echoing(wire(Station()), pieces=pieces))
    for number in range(5):
        play.ask(ask_read(), number)
        assert play.answer(number).reply.values == (number + 1,) * 4
    assert play.core.echo.state is EchoState.ON
    assert play.core.echo.count == 5
    play.ask(ask_write(play.core), "write")
    answer = play.answer("write")
    assert answer.error is None and answer.received == answer.sent, "the echo is gone, the equal reply is there"


@pytest.mark.parametrize("paced", [True, False])
def test_no_echo_is_detected_too(paced: bool) -> None:
    play = Playbook(core(1, paced=paced, echo="detect"), wire(Station()))
    play.ask(ask_read())
    assert play.answer().error is None
    assert play.core.echo.state is EchoState.OFF and play.core.echo.proved


def test_a_dead_drive_behind_an_echo_is_detected_as_an_echo_too() -> None:
    play = Playbook(core(1, echo="detect"), echoing(wire()))
    play.ask(ask_read())
    assert play.answer().error is not None
    assert play.core.echo.state is EchoState.ON


@pytest.mark.parametrize("setting", ["on", "off", "detect"])
@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("late_s", [0.0, 0.004, 0.018])
def test_a_write_to_an_absent_drive_is_never_acknowledged(setting: str, real: bool, paced: bool, late_s: float) -> None:
    """G19: set rightly or wrongly, echo at once or through a slow adapter, with another drive alive or not."""
    chance = random.Random(5)
    for alive in (True, False):
        alone = wire(Station(2)) if alive else wire()
        play = Playbook(core(1, 2, paced=paced, echo=setting), echoing(alone, late_s) if real else alone)
        for number in range(60):
            if chance.random() < 0.5:
                play.ask(ask_read(2), ("read", number))
                play.until(play.now + chance.random())
            play.ask(ask_write(play.core, 1, value=chance.randrange(0x10000), until=play.now + 60), number)
            answer = play.answer(number)
            assert answer.reply is None and answer.error is not None
            play.until(play.now + chance.random() * 2)


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("late_s", [0.0, 1.5 * C])
def test_an_echo_that_was_not_heard_at_first_is_detected_later(paced: bool, late_s: float) -> None:
    """The first frame got lost in the adapter: no echo, it seemed. Then no mirrored reply would ever be believed.

    ``late_s``: the adapter hands the echo over as a batch, so that a part of it seems to come after our last bit.
    """
    inner, lost = wire(Station()), [True]

    def adapter(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        return () if lost and lost.pop() else echoing(inner, late_s, pieces=not late_s)(frame, ended_at)

    play = Playbook(core(1, paced=paced, echo="detect"), adapter)
    play.ask(ask_read(), "lost")
    play.answer("lost")
    for number in range(3):
        play.ask(ask_read(), number)
        play.answer(number)
        play.until(play.now + 70.0)
    assert play.core.echo.state is EchoState.ON
    play.ask(ask_write(play.core, until=play.now + 60), "write")
    assert play.answer("write").error is None


def test_an_echo_that_comes_back_changed_is_a_collision() -> None:
    station = Station()
    inner = wire(station)
    spoil = [False]

    def line(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        back = bytearray(frame)
        back[3] ^= 0x10 * spoil[0]
        yield ended_at, bytes(back)
        yield from inner(frame, ended_at)

    play = Playbook(core(1, echo="on"), line)
    play.ask(ask_read(), "good")
    assert play.answer("good").error is None
    spoil[0] = True
    play.ask(ask_read(), "bad")
    error = play.answer("bad").error
    assert isinstance(error, LineFault) and error.params["position"] == 4
    assert play.core.counters.kinds["collision"] == 2, "and its one retry"


def test_silence_and_debris_do_not_say_that_there_is_no_echo() -> None:
    """Found by `lab commands`: half an echo, on a line that loses bytes, was taken for the absence of one."""
    for heard in (b"", b"\x30\x00"):
        play = Playbook(core(1, paced=False, echo="detect"), lambda _, at, heard=heard: whole(heard, at))
        play.ask(ask_read())
        assert play.answer().error is not None
        assert play.core.echo.state is EchoState.UNKNOWN


def test_a_line_on_which_only_fences_are_asked_finds_its_echo() -> None:
    """Found by `lab commands`: our fence passed for its mirrored answer, the answer for a late one, for ever."""
    play = Playbook(core(1, paced=False, echo="detect"), echoing(wire(Station())))
    play.ask(ask_write(play.core), "mirrored")
    play.answer("mirrored")
    assert play.core.echo.state is not EchoState.ON
    play.until(play.now + 1)
    assert play.core.echo.state is EchoState.ON, "it was heard once more: that was the answer"


def test_a_new_adapter_is_listened_to_anew() -> None:
    """After reopening, another adapter may be in the old one's place."""
    station = Station()
    play = Playbook(core(1, echo="detect"), wire(station))
    play.ask(ask_read(), 1)
    play.answer(1)
    play.lose(PortLost("ports.lost"))
    play.until(play.now + 1)
    play.wire = echoing(wire(station))
    play.reopen()
    play.ask(ask_read(), 2)
    assert play.answer(2).error is None
    assert play.core.echo.state is EchoState.ON


def test_a_detected_echo_that_stays_away_is_doubted() -> None:
    station = Station()
    play = Playbook(core(1, echo="detect"), echoing(wire(station)))
    play.ask(ask_read(), "with")
    play.answer("with")
    play.wire = wire(station)
    for number in range(8):
        play.ask(ask_read(), number)
        play.answer(number)
        play.until(play.now + 1)
    assert play.answers[7][0].error is None
    assert play.core.echo.state is EchoState.OFF


def test_the_echo_of_a_c320_parameter_write_acknowledges_nothing() -> None:
    """T21: it has the length and the sum of a reply (response 3, state 00). Behind a wrongly set adapter it is void."""
    codec = sifang.SifangCodec()
    request = sifang.WriteParameter(1, 0, 1, 5000)
    link = StationLink(1, codec, TIMING, lambda frame: Effect.SETTING, lambda n: sifang.ReadParameter(1, 1 + n % 9, 0))
    bus = BusCore(LineSettings(9600, parity="E"), paced=False, echo="off")
    bus.add(link)
    play = Playbook(bus, echoing(wire(), 0.004))
    for number in range(5):
        permit = Permit(1, Effect.SETTING, WriteClass.EEPROM, 1e9, 0)
        play.ask(Ask(1, request, Lane.PARAMETER, WriteClass.EEPROM, permit), number)
        answer = play.answer(number)
        assert answer.reply is None and answer.error is not None
