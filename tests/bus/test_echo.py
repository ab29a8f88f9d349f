"""Two-wire adapters echo the sent frames; a wrong setting never forges an acknowledgement."""

from __future__ import annotations

import random
from collections.abc import Iterable
from types import SimpleNamespace
from typing import Any

import pytest

from drivebus.bus.core import BusCore
from drivebus.bus.echo import EchoState
from drivebus.bus.messages import BusRequest, Permit, RequestPriority, RetryPolicy, StationConfig
from drivebus.bus.prepared_request import PreparedRequest
from drivebus.bus.transaction import EchoFilter, Transaction
from drivebus.errors import LineError, NoReply, PortLost
from drivebus.protocols import modbus, sunfar
from drivebus.protocols.codec import Effect
from drivebus.serial_settings import SerialSettings
from drivebus.testing.bus_script import BusScript, Wire
from fixtures.bus import (
    CHARACTER_S,
    CODEC,
    TIMING,
    FakeStation,
    byte_by_byte,
    make_core,
    read_request,
    stop_request,
    whole,
    wire_to,
    write_request,
)


def echoing(inner: Wire, late_s: float = 0.0, pieces: bool = True) -> Wire:
    """Return a wire with an adapter that echoes each byte at once, or all in one batch a little later."""

    def adapter(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        begins = ended_at - len(frame) * CHARACTER_S
        yield from (byte_by_byte if pieces else whole)(frame, begins + late_s)
        yield from inner(frame, ended_at)

    return adapter


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("pieces", [True, False])
def test_an_echo_is_detected_and_removed(paced: bool, pieces: bool) -> None:
    script = BusScript(
        make_core(1, has_line_timing=paced, echo="detect"), echoing(wire_to(FakeStation()), pieces=pieces)
    )
    for number in range(5):
        script.submit(read_request(), number)
        assert script.result(number).reply.values == (number + 1,) * 4
    assert script.core.echo.state is EchoState.ON
    assert script.core.echo.echo_count == 5
    script.submit(write_request(script.core), "write")
    result = script.result("write")
    assert result.error is None and result.received == result.sent, "the echo is removed and the equal reply accepted"


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("pause_s", [0.0, 0.02])
def test_a_reply_that_was_received_twice_is_not_called_a_collision_because_it_looked_like_an_echo(
    paced: bool, pause_s: float
) -> None:
    """The first frame of the port is a write, whose reply equals it: twice, it looks like an echo with the reply."""
    station = wire_to(FakeStation())

    def doubling(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        replies = list(station(frame, ended_at))
        yield from replies
        yield from ((at + replies[-1][0] - replies[0][0] + CHARACTER_S + pause_s, data) for at, data in replies)

    script = BusScript(make_core(1, has_line_timing=paced, echo="detect"), doubling)
    script.submit(write_request(script.core), "stop")
    script.result("stop")
    for number in range(3):
        script.submit(read_request(), number)
        assert getattr(script.result(number).error, "key", "") == "bus.second_reply"


def test_an_echo_that_was_assumed_from_a_write_is_certain_after_a_read() -> None:
    script = BusScript(make_core(1, has_line_timing=False, echo="detect"), echoing(wire_to(FakeStation())))
    script.submit(write_request(script.core), "write")
    script.result("write")
    for number in range(2):
        script.submit(read_request(), number)
        result = script.result(number)
    assert result.error is None and script.core.echo.state is EchoState.ON
    prepared = PreparedRequest(read_request(), None, script.core.stations[1], script.core.settings)
    echo = script.core.echo.filter_for(prepared)
    assert echo is not None and not echo.tentative, "a changed echo is a collision now"


@pytest.mark.parametrize("paced", [True, False])
def test_no_echo_is_detected_too(paced: bool) -> None:
    script = BusScript(make_core(1, has_line_timing=paced, echo="detect"), wire_to(FakeStation()))
    script.submit(read_request())
    assert script.result().error is None
    assert script.core.echo.state is EchoState.OFF and script.core.echo.ruled_out


def test_a_dead_drive_behind_an_echo_is_detected_as_an_echo_too() -> None:
    script = BusScript(make_core(1, echo="detect"), echoing(wire_to()))
    script.submit(read_request())
    assert script.result().error is not None
    assert script.core.echo.state is EchoState.ON


def test_an_echo_that_comes_back_changed_is_counted_for_its_bus_and_its_station() -> None:
    def changed(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        yield ended_at + CHARACTER_S, bytes([frame[0] ^ 1]) + frame[1:]

    script = BusScript(make_core(1, has_line_timing=False, echo="on"), changed)
    script.submit(read_request())
    error = script.result().error
    assert getattr(error, "key", "") == "bus.collision"
    statistics = script.core.statistics(script.now)
    assert statistics.counters["collision"] == statistics.stations[1].counters["collision"] > 0


@pytest.mark.parametrize("setting", ["on", "off", "detect"])
@pytest.mark.parametrize("real", [True, False])
@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("late_s", [0.0, 0.004, 0.018])
def test_a_write_to_an_absent_drive_is_never_acknowledged(setting: str, real: bool, paced: bool, late_s: float) -> None:
    """With a right or wrong setting, an immediate or late echo, and another drive that replies or not."""
    chance = random.Random(5)
    for alive in (True, False):
        alone = wire_to(FakeStation(address=2)) if alive else wire_to()
        script = BusScript(
            make_core(1, 2, has_line_timing=paced, echo=setting), echoing(alone, late_s) if real else alone
        )
        for number in range(60):
            if chance.random() < 0.5:
                script.submit(read_request(2), ("read", number))
                script.run_until(script.now + chance.random())
            script.submit(write_request(script.core, 1, value=chance.randrange(0x10000), until=script.now + 60), number)
            result = script.result(number)
            assert result.reply is None and result.error is not None
            script.run_until(script.now + chance.random() * 2)


@pytest.mark.parametrize("paced", [True, False])
@pytest.mark.parametrize("late_s", [0.0, 1.5 * CHARACTER_S])
def test_an_echo_that_is_lost_at_first_is_detected_later(paced: bool, late_s: float) -> None:
    """The adapter loses its first frame, so no echo is detected at first, and no mirrored reply would be accepted.

    ``late_s``: the adapter delivers the echo as a batch, so that a part of it seems to come after our last bit.
    """
    inner, lost = wire_to(FakeStation()), [True]

    def adapter(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        return () if lost and lost.pop() else echoing(inner, late_s, pieces=not late_s)(frame, ended_at)

    script = BusScript(make_core(1, has_line_timing=paced, echo="detect"), adapter)
    script.submit(read_request(), "lost")
    script.result("lost")
    for number in range(3):
        script.submit(read_request(), number)
        script.result(number)
        script.run_until(script.now + 70.0)
    assert script.core.echo.state is EchoState.ON
    script.submit(write_request(script.core, until=script.now + 60), "write")
    assert script.result("write").error is None


def test_an_echo_that_comes_back_changed_is_a_collision() -> None:
    station = FakeStation()
    inner = wire_to(station)
    spoil = [False]

    def line(frame: bytes, ended_at: float) -> Iterable[tuple[float, bytes]]:
        back = bytearray(frame)
        back[3] ^= 0x10 * spoil[0]
        yield ended_at, bytes(back)
        yield from inner(frame, ended_at)

    script = BusScript(make_core(1, echo="on"), line)
    script.submit(read_request(), "good")
    assert script.result("good").error is None
    spoil[0] = True
    script.submit(read_request(), "bad")
    error = script.result("bad").error
    assert isinstance(error, LineError) and error.params["position"] == 4
    assert script.core.counters.events["collision"] == 2, "and its one retry"


def test_silence_and_fragments_do_not_rule_out_an_echo() -> None:
    """Found by the campaign ``commands``: half an echo, on a bus that loses bytes, was taken for no echo."""
    for received in (b"", b"\x30\x00"):
        script = BusScript(
            make_core(1, has_line_timing=False, echo="detect"), lambda _, at, received=received: whole(received, at)
        )
        script.submit(read_request())
        assert script.result().error is not None
        assert script.core.echo.state is EchoState.UNKNOWN


def test_a_bus_with_sync_probes_only_detects_its_echo() -> None:
    """Found by the campaign ``commands``: the echo of a sync probe was taken for its reply."""
    script = BusScript(make_core(1, has_line_timing=False, echo="detect"), echoing(wire_to(FakeStation())))
    script.submit(write_request(script.core), "mirrored")
    script.result("mirrored")
    assert script.core.echo.state is not EchoState.ON
    script.run_until(script.now + 1)
    assert script.core.echo.state is EchoState.ON, "it came once more: that was the reply"


def test_a_new_adapter_is_observed_again() -> None:
    """After reopening the adapter may be another one."""
    station = FakeStation()
    script = BusScript(make_core(1, echo="detect"), wire_to(station))
    script.submit(read_request(), 1)
    script.result(1)
    script.lose_port(PortLost("ports.lost"))
    script.run_until(script.now + 1)
    script.wire = echoing(wire_to(station))
    script.reopen()
    script.submit(read_request(), 2)
    assert script.result(2).error is None
    assert script.core.echo.state is EchoState.ON


def test_a_detected_echo_that_is_missing_is_detected_again() -> None:
    station = FakeStation()
    script = BusScript(make_core(1, echo="detect"), echoing(wire_to(station)))
    script.submit(read_request(), "with")
    script.result("with")
    script.wire = wire_to(station)
    for number in range(8):
        script.submit(read_request(), number)
        script.result(number)
        script.run_until(script.now + 1)
    assert script.results[7][0].error is None
    assert script.core.echo.state is EchoState.OFF


def test_the_echo_of_a_c320_parameter_write_acknowledges_nothing() -> None:
    """The request has the length and the checksum of a reply; behind a wrongly set adapter it is invalid."""
    codec = sunfar.SunfarCodec()
    request = sunfar.SunfarWriteParameter(1, 0, 1, 5000)
    link = StationConfig(
        address=1,
        codec=codec,
        timing=TIMING,
        effect_of=lambda frame: Effect.SETTING if frame == codec.encode_request(request) else Effect.NONE,
        sync_request=lambda n: sunfar.SunfarReadParameter(1, 1 + n % 9, 0),
    )
    bus = BusCore(SerialSettings(9600, parity="E"), has_line_timing=False, echo="off")
    bus.registry.add(link)
    script = BusScript(bus, echoing(wire_to(), 0.004))
    for number in range(5):
        permit = Permit(station=1, effect=Effect.SETTING, retry_policy=RetryPolicy.EEPROM, expires_at=1e9, stop_epoch=0)
        script.submit(
            BusRequest(
                station=1,
                request=request,
                priority=RequestPriority.PARAMETER,
                permit=permit,
            ),
            number,
        )
        result = script.result(number)
        assert result.reply is None and result.error is not None


def test_a_cut_reply_that_begins_like_the_request_is_not_called_silence() -> None:
    """Found by the campaign ``statements``: "no reply" was reported of a cut reply whose
    bytes equalled the first ones of our frame, while the echo was unknown."""
    prepared: Any = SimpleNamespace(
        send_s=0.01,
        reply_timeout_s=0.1,
        is_broadcast=False,
        attempts=1,
        reply_bytes=8,
        station=SimpleNamespace(address=3),
    )
    transaction = Transaction(prepared, 0.0, 0.001, has_line_timing=True, echo=EchoFilter(b"*03100000", tentative=True))
    transaction.on_data(b"*03", 0.05)
    error = transaction.final_error()
    assert isinstance(error, NoReply)
    assert (error.key, error.params["bytes"]) == ("bus.truncated", 3)


@pytest.mark.parametrize(
    ("request_of", "key"),
    [(write_request, "bus.only_own_frame"), (lambda core: read_request(), "bus.no_reply")],
    ids=["reply equals the request", "reply differs"],
)
def test_a_reply_that_may_have_passed_for_the_echo_is_not_called_silence(request_of: Any, key: str) -> None:
    """A doubled mirrored reply looks like an echo with its reply; the next reply is then taken for the echo."""
    core = make_core(1, echo="on")
    prepared = PreparedRequest(request_of(core), None, core.stations[1], core.settings)
    echo = EchoFilter(prepared.data, tentative=False)
    transaction = Transaction(prepared, 0.0, CHARACTER_S, has_line_timing=False, echo=echo)
    transaction.on_data(prepared.data, 0.05)
    error = transaction.final_error()
    assert isinstance(error, NoReply) and error.key == key
    assert str(error) != key


def test_a_repeat_of_a_mirrored_frame_is_no_echo_once_a_reply_without_an_echo_was_received() -> None:
    """Another master writes the same value later; the next stop's acknowledgement was then taken for the echo."""
    script = BusScript(make_core(1, has_line_timing=False, echo="detect"), wire_to(FakeStation()))
    write = write_request(script.core)
    script.submit(write, "write")
    assert getattr(script.result("write").error, "key", "") == "bus.own_echo"
    script.run_until(script.now + 1.0)
    script.submit(read_request(), "read")
    assert script.result("read").error is None and script.core.echo.ruled_out
    for after_s in (1.0, 1.02):  # its request and the reply to it
        script.receive(CODEC.encode_request(write.request), at=script.now + after_s)
    script.run_until(script.now + 1.1)
    assert script.core.echo.state is EchoState.OFF
    script.submit(stop_request(), "stop")
    assert script.result("stop").error is None


def test_a_rejected_write_without_an_echo_before_it_shows_that_there_is_none() -> None:
    rejection = CODEC.encode_reply(modbus.ExceptionReply(1, 6, 2))
    core = make_core(1, has_line_timing=False, echo="detect")
    script = BusScript(core, lambda frame, ended_at: [(ended_at + 0.02, rejection)])
    script.submit(write_request(core))
    assert script.result().error is None
    assert core.echo.state is EchoState.OFF and core.echo.ruled_out
