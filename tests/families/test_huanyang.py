"""Huanyang HY: recorded frames, the effect of every control byte, and one story on four lines."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus import i18n, profiles
from drivebus.bus import Bus
from drivebus.bus.core import BusCore
from drivebus.bus.messages import BusRequest
from drivebus.commissioning.decode.describe import describe_frame
from drivebus.drives import Drive, create_dialect
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.outcome import OutcomeStatus
from drivebus.drives.state import Direction, DriveState
from drivebus.errors import (
    AddressError,
    CapabilityError,
    DrivebusError,
    EchoError,
    NoReply,
    PreflightError,
    ProtocolError,
)
from drivebus.families.huanyang import codec as hy
from drivebus.families.huanyang.codec import HuanyangReply, HuanyangRequest
from drivebus.ports import open_port
from drivebus.protocols.codec import Complete, Effect
from drivebus.protocols.family import protocol_family
from drivebus.serial_settings import SerialSettings
from drivebus.simulator.motor import Trip
from drivebus.testing.bus_script import BusScript
from drivebus.testing.virtual_time import run
from verification.reference.huanyang import HuanyangReference

CODEC: Any = protocol_family("huanyang").codecs["rtu"]()  # loads the family's texts
RECORDED = [
    ("04 01 03 01 00 00 6D DB", HuanyangRequest(4, 1, 1), "04 01 02 01 02 F5 AD", HuanyangReply(4, 1, 1, 2, 1)),
    ("04 01 03 05 00 00 2C 1A", HuanyangRequest(4, 1, 5), "04 01 03 05 17 70 22 0E", HuanyangReply(4, 1, 5, 6000)),
    ("04 01 03 08 00 00 BD D9", HuanyangRequest(4, 1, 8), "04 01 03 08 08 98 BB B3", HuanyangReply(4, 1, 8, 2200)),
    ("04 01 03 A3 00 00 CC 39", HuanyangRequest(4, 1, 163), "04 01 02 A3 04 0C CF", HuanyangReply(4, 1, 163, 4, 1)),
    ("04 01 03 A5 00 00 2C 38", HuanyangRequest(4, 1, 165), "04 01 02 A5 03 4E AD", HuanyangReply(4, 1, 165, 3, 1)),
]
"""Requests and replies of a HY01D523B, from unininu.tistory.com/288."""
PRINTED = [
    ("04 02 03 08 04 4C FA EC", HuanyangRequest(4, 2, 8, 1100)),
    ("04 03 01 01 31 44", HuanyangRequest(4, 3, 0, 0x01, 1)),
    ("01 03 01 08 F1 8E", HuanyangRequest(1, 3, 0, 0x08, 1)),
]
"""From the same page, and the last from gist.github.com/Bouni/803492ed0aab3f944066."""


@pytest.mark.parametrize(("sent", "request_", "received", "reply"), RECORDED, ids=[row[0] for row in RECORDED])
def test_recorded_frames_decode_to_their_messages_and_are_encoded_again(
    sent: str, request_: HuanyangRequest, received: str, reply: HuanyangReply
) -> None:
    assert CODEC.encode_request(request_) == bytes.fromhex(sent)
    assert CODEC.decode_request(bytes.fromhex(sent)) == Complete(request_, 8)
    assert CODEC.decode_reply(request_, bytes.fromhex(received)) == Complete(reply, len(bytes.fromhex(received)))
    assert CODEC.encode_reply(reply) == bytes.fromhex(received)


@pytest.mark.parametrize(("frame", "request_"), PRINTED, ids=[row[0] for row in PRINTED])
def test_the_requests_printed_in_the_manual_decode_to_their_messages_and_are_encoded_again(
    frame: str, request_: HuanyangRequest
) -> None:
    assert CODEC.encode_request(request_) == bytes.fromhex(frame)
    assert CODEC.decode_request(bytes.fromhex(frame)).message == request_  # type: ignore[union-attr]


def test_of_all_control_bytes_only_08h_is_a_stop_and_only_the_explained_ones_get_a_permit() -> None:
    dialect = Drive(Bus(open_port("sim://huanyang_hy@3")), profiles.load("huanyang_hy"), 3).dialect
    frames = {value: CODEC.encode_request(hy.control(3, value)) for value in range(256)}
    effects = {value: hy.frame_effect(frame) for value, frame in frames.items()}
    assert [value for value, effect in effects.items() if effect is Effect.STOP] == [0x08]
    assert set(effects.values()) == {Effect.STOP, Effect.MOTION}
    assert [value for value, frame in frames.items() if dialect.is_allowed(frame)] == [0x01, 0x08, 0x11]


def test_a_frame_that_is_not_canonical_counts_as_motion() -> None:
    stop = CODEC.encode_request(hy.control(3, hy.STOP))
    assert hy.frame_effect(stop) is Effect.STOP
    for frame in (stop[:-1], stop + b"\0", stop[:-1] + bytes((stop[-1] ^ 1,)), b""):
        assert hy.frame_effect(frame) is Effect.MOTION
    assert hy.frame_effect(CODEC.encode_request(hy.set_frequency(3, 5000))) is Effect.SETTING


@given(st.integers(1, 250), st.integers(0, 7), st.integers(0, 0xFFFF))
def test_no_reply_to_a_status_read_equals_its_request(address: int, item: int, value: int) -> None:
    """A read with two zero bytes is repeated by its reply at 0 Hz: then an echo could pass for a stopped motor."""
    request = hy.read_status(address, item)
    assert CODEC.encode_reply(HuanyangReply(address, 4, item, value)) != CODEC.encode_request(request)


READ, SETPOINT = hy.read_parameter(1, 5), hy.set_frequency(1, 5000)


@pytest.mark.parametrize(
    ("request_", "reply", "key", "words"),
    [
        (READ, CODEC.encode_reply(HuanyangReply(1, 1, 6, 0)), "huanyang.index", "number 6"),
        (READ, CODEC.encode_reply(HuanyangReply(1, 1, 6, accepted=False)), "huanyang.index", "number 6"),
        (SETPOINT, CODEC.encode_reply(HuanyangReply(1, 5, 0, 4999)), "huanyang.frequency", "4999"),
        (SETPOINT, CODEC.encode_reply(HuanyangReply(1, 1, 5, 0)), "huanyang.reply_function", "function 01H"),
        # as the manual's example of a reply is printed
        (hy.read_status(1, 0), bytes.fromhex("01 04 03 13 88 89 A6 2D"), "huanyang.item", "status item 19"),
        (READ, bytes.fromhex("01 06"), "huanyang.function", "06H"),
        (READ, bytes.fromhex("01 01 04"), "huanyang.length", "length 4"),
        (READ, bytes.fromhex("01 81 02"), "huanyang.length", "length 2"),
    ],
)
def test_a_reply_that_does_not_fit_its_request_is_rejected_with_what_differs(
    request_: HuanyangRequest, reply: bytes, key: str, words: str
) -> None:
    with pytest.raises(ProtocolError, match=words) as caught:
        CODEC.decode_reply(request_, reply)
    assert caught.value.key == key


@pytest.mark.parametrize(
    ("frame", "key"),
    [("01 06", "huanyang.function"), ("01 81 01", "huanyang.function"), ("01 01 02", "huanyang.length")],
)
def test_a_request_of_an_unknown_function_or_length_is_rejected(frame: str, key: str) -> None:
    """A station never rejects a request by the form of a rejected reply."""
    with pytest.raises(ProtocolError) as caught:
        CODEC.decode_request(bytes.fromhex(frame))
    assert caught.value.key == key


@pytest.mark.parametrize("more", ["87", "87 04 01"])
def test_bytes_behind_a_reply_do_not_become_part_of_its_value(more: str) -> None:
    """The value was taken to the end of all received bytes, so that a set frequency looked like another one."""
    setpoint, frame = hy.set_frequency(1, 5000), CODEC.encode_reply(HuanyangReply(1, 5, 0, 5000))
    assert CODEC.decode_reply(setpoint, frame + bytes.fromhex(more)) == Complete(HuanyangReply(1, 5, 0, 5000), 7)


def test_a_reply_to_a_broadcast_is_rejected() -> None:
    frame = CODEC.encode_reply(HuanyangReply(0, 3, 0, hy.STOP, 1))
    with pytest.raises(AddressError) as caught:
        CODEC.decode_reply(hy.control(0, hy.STOP), frame)
    assert caught.value.key == "huanyang.broadcast_answered"


@pytest.mark.parametrize("hz", [0.0, 12.5])
def test_stray_bytes_after_replies_are_neither_a_second_drive_nor_a_foreign_master(hz: float) -> None:
    """A status reply has the form of a request, so it was taken for another reply or for the request of a master."""

    async def play() -> None:
        async with simulated_drive("clean") as (drive, station):
            await drive.preflight()
            station.keypad_run(hz)
            await asyncio.sleep(3)
            wire: Any = drive.bus.port.simulated_bus.wire
            transmit = wire.transmit_reply

            def followed_by_noise(source: Any, data: bytes, now: float, at: float) -> Any:
                return transmit(source, data + b"\xfd\x18" * (data[1] == hy.STATUS), now, at)

            wire.transmit_reply = followed_by_noise
            for _ in range(4):
                answer = await drive.bus.transact(BusRequest(station=3, request=hy.read_status(3, 1)))
                assert answer.error is not None
                await asyncio.sleep(6)
            wire.transmit_reply = transmit
            health = drive.bus.health(3)
            assert (health.duplicate_address, health.foreign_master) == (False, False)
            assert health.damaged >= 4

    run(play())


def test_no_station_has_an_address_above_250() -> None:
    frame = CODEC.encode_request(hy.control(250, hy.STOP))
    beyond = HuanyangReference().reseal(b"\xfb" + frame[1:])
    assert CODEC.decode_request(frame) == Complete(hy.control(250, hy.STOP), 6)
    with pytest.raises(AddressError, match="251") as caught:
        CODEC.decode_request(beyond)
    assert caught.value.key == "huanyang.address"


def test_no_sync_probe_reads_a_parameter_of_one_byte() -> None:
    """The bus took its reply, which is shorter than the longest one, for a rejection and probed once more."""
    dialect: Any = Drive(Bus(open_port("sim://huanyang_hy@3")), profiles.load("huanyang_hy"), 3).dialect
    probes = {dialect._bus_sync_request(n).index for n in range(20)} | {dialect.sync_request().index for _ in range(20)}
    assert len(probes) >= 8 and not probes & {1, 2, 23, 143, 163, 164, 165}


def test_a_rejection_is_a_reply() -> None:
    reply = HuanyangReply(1, 1, 200, accepted=False)
    frame = CODEC.encode_reply(reply)
    assert frame[:4] == bytes((1, 0x81, 1, 200))
    assert CODEC.decode_reply(hy.read_parameter(1, 200), frame) == Complete(reply, 6)
    with pytest.raises(EchoError):
        CODEC.decode_reply(hy.read_parameter(1, 201), frame)


@asynccontextmanager
async def simulated_drive(quality: str, **options: str) -> AsyncIterator[tuple[Drive, Any]]:
    more = "".join(f"&{name}={value}" for name, value in options.items())
    port: Any = open_port(f"sim://huanyang_hy@3?line_quality={quality}&ramp=2{more}")
    async with Bus(port) as bus:
        yield Drive(bus, profiles.load("huanyang_hy"), 3), port.simulated_bus.stations[0]


async def until_confirmed(action: Any) -> None:
    """Repeat as a user would on a line that loses frames."""
    for _ in range(10):
        try:
            if (await action()).status is OutcomeStatus.CONFIRMED:
                return
        except DrivebusError:
            await asyncio.sleep(1)
    raise AssertionError("not confirmed in ten tries")


@pytest.mark.parametrize("answer", ["state", "echo"])
@pytest.mark.parametrize("quality", ["clean", "bytes", "loss=0.03", "late=0.02:0.3"])
def test_the_motor_does_what_was_confirmed_on_a_line_of_any_quality(quality: str, answer: str) -> None:
    async def play() -> None:
        async with simulated_drive(quality, answer=answer) as (drive, station):
            await until_confirmed(lambda: drive.run(20.0))
            await asyncio.sleep(3)
            station.advance(asyncio.get_running_loop().time())
            assert station.motor.output_hz == pytest.approx(20.0)
            await until_confirmed(lambda: drive.set_frequency(12.34))
            await asyncio.sleep(3)
            station.advance(asyncio.get_running_loop().time())
            assert station.motor.output_hz == pytest.approx(12.34)
            await until_confirmed(drive.stop)
            station.advance(asyncio.get_running_loop().time())
            assert not station.motor.energised
            await until_confirmed(lambda: drive.run(10.0, Direction.REVERSE))
            await asyncio.sleep(3)
            station.advance(asyncio.get_running_loop().time())
            assert station.motor.output_hz == pytest.approx(-10.0)
            await until_confirmed(drive.stop)

    run(play())


def test_a_tripped_drive_shows_0_hz_and_no_fault_and_nothing_claims_to_reset_it() -> None:
    async def play() -> None:
        async with simulated_drive("clean") as (drive, station):
            await drive.run(20.0)
            await asyncio.sleep(3)
            station.trip(Trip.OVERCURRENT_RUNNING)
            status = await drive.status()
            assert (status.state, status.fault) == (DriveState.STOPPED, None)
            with pytest.raises(CapabilityError):
                await drive.reset_fault()

    run(play())


@pytest.mark.parametrize(
    ("language", "words"), [("en", "does not report whether the output is on"), ("zh", "不报告输出")]
)
def test_a_stop_is_confirmed_by_0_hz_and_nothing_more(language: str, words: str) -> None:
    """The outcome was that the drive reports "stopped", also where it ran on at 0 Hz."""

    async def play() -> None:
        async with simulated_drive("clean") as (drive, _):
            await drive.run(20.0)
            outcome = await drive.stop()
            assert (outcome.status, outcome.key) == (OutcomeStatus.CONFIRMED, "drives.stop_confirmed_by_frequency")
            assert words in i18n.text(outcome.key, language)

    run(play())


def test_no_start_while_commands_come_from_the_keypad() -> None:
    async def play() -> None:
        async with simulated_drive("clean") as (drive, station):
            station.keypad_set(1, 0)
            with pytest.raises(PreflightError, match="PD001"):
                await drive.run(20.0)
            assert station.motor.starts == 0

    run(play())


def test_parameters_of_one_and_two_bytes_are_written_with_their_own_width() -> None:
    async def play() -> None:
        async with simulated_drive("clean") as (drive, station):
            await drive.write({"PD014": 12.0, "PD023": 0}, save=True)
            assert (station.memory[14], station.memory[23]) == (120, 0)
            frames = [
                drive.dialect.write_parameter(drive.profile.parameters[name], 1, save=True)
                for name in ("PD014", "PD023")
            ]
            assert [frame.request.width for frame in frames] == [2, 1]

    run(play())


@pytest.mark.parametrize(("language", "moves"), [("en", "may start the motor"), ("zh", "可能启动")])
def test_a_reverse_start_is_described_with_its_hazard(language: str, moves: str) -> None:
    found = describe_frame("huanyang_hy", CODEC.encode_request(hy.control(4, hy.RUN_REVERSE)))
    assert (found.valid, found.fields["name"]) == (True, "run_reverse")
    ((key, params),) = found.hazards
    assert key == "huanyang.moves" and moves in i18n.text(key, language, **params)
    assert describe_frame("huanyang_hy", CODEC.encode_request(hy.control(4, hy.STOP))).hazards == ()


def test_the_reply_to_a_control_is_described_as_state_bits() -> None:
    request, reply = (CODEC.encode_request(hy.control(4, value)) for value in (hy.RUN_REVERSE, 0x2D))
    found = describe_frame("huanyang_hy", reply, request=request)
    assert found.fields["state_bits"] == ["run_command", "reverse_command", "running", "running_reverse"]


def test_a_rejected_request_is_reported_as_rejected() -> None:
    dialect = create_dialect(profiles.load("huanyang_hy"), 1)
    rejection = dialect.rejection(HuanyangReply(1, 0x05, accepted=False))
    assert rejection is not None and rejection.key == "huanyang.rejected"
    assert dialect.rejection(HuanyangReply(1, 0x05)) is None


def test_a_late_reply_to_a_stop_is_not_called_later_than_it_was() -> None:
    """The reply to a read follows it after a pause, in the same transaction: its end is not that of the late one.

    Found by the campaign ``statements`` (seed 1, huanyang-hy/322).
    """
    core = BusCore(SerialSettings(9600), echo="off")
    dialect = create_dialect(profiles.load("huanyang_hy"), 1)
    core.registry.add(dialect.station_config)
    script = BusScript(core)
    script.submit(BusRequest(station=1, request=dialect.stop(StopMode.STOP)[0]), "stop")
    script.result("stop")
    while len(script.sent) < 2:
        script.run_until(script.now + 0.002)
    (stopped_at, stop), (probe_at, probe) = script.sent
    late_at = probe_at + (len(probe) + 6) * core.character_s + 0.002
    script.receive(CODEC.encode_reply(HuanyangReply(1, 3, 0, 0, 1)), at=late_at)
    script.receive(CODEC.encode_reply(HuanyangReply(1, 1, probe[3], 5000)), at=late_at + 0.05)
    script.run_until(late_at + 0.2)
    error = core.stations[1].earlier_failure_reason
    late_ms = 1000 * (late_at - stopped_at - len(stop) * core.character_s)
    assert isinstance(error, NoReply) and error.key == "bus.late_reply"
    assert late_ms - 15 < error.params["milliseconds"] <= round(late_ms)
