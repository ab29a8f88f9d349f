"""Recording and replay of the traffic of a bus in virtual time."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from drivebus import Bus, Drive, DriveStatus, open_bus
from drivebus.capture.dbcap import (
    BytesRecord,
    CaptureError,
    CaptureHeader,
    CaptureWriter,
    EventRecord,
    read_capture,
)
from drivebus.errors import PortLost, PortUnavailable
from drivebus.ports import open_port
from drivebus.ports.base import PausableReader, PendingReader
from drivebus.ports.memory import create_pair
from drivebus.ports.recording import RecordingPort
from drivebus.ports.replay import ReplayDifference, ReplayPort, ReplayReport
from drivebus.serial_settings import SerialSettings
from drivebus.testing.virtual_time import run
from fixtures.receiver import FakeReceiver


def recorded(path: Path) -> str:
    """Record two requests with their replies, an unplugged and replugged adapter, and one more byte."""
    writer = CaptureWriter(path, CaptureHeader(SerialSettings(19200, 8, "E", 1)), now=0.0)
    writer.write_event(0.0, "opened")
    writer.write_bytes(1.0, "tx", b"ask1")
    writer.write_bytes(1.25, "rx", b"rep")
    writer.write_bytes(1.5, "rx", b"ly1", 1)
    writer.write_bytes(2.0, "tx", b"ask2")
    writer.write_bytes(2.5, "rx", b"reply2")
    writer.write_event(3.0, "lost", reason="pulled")
    writer.write_event(5.0, "opened")
    writer.write_bytes(5.5, "rx", b"!")
    writer.close()
    return f"replay://{path}"


def test_received_bytes_arrive_at_their_recorded_times_and_written_bytes_are_compared(tmp_path: Path) -> None:
    async def main() -> None:
        port, sink, loop = open_port(recorded(tmp_path / "a.dbcap")), FakeReceiver(), asyncio.get_running_loop()
        assert isinstance(port, ReplayPort)
        await asyncio.sleep(10)
        await port.open(sink)
        await asyncio.sleep(1)
        port.write(b"ask1")
        await asyncio.sleep(1)
        port.write(b"ask9")
        await asyncio.sleep(1.5)
        assert [(at - 10, data) for at, data in sink.chunks] == [(1.25, b"rep"), (1.5, b"ly1"), (2.5, b"reply2")]
        assert sink.line_errors == 1
        assert [str(error.params["reason"]) for error in sink.lost] == ["pulled"]
        with pytest.raises(PortLost):
            port.write(b"x")
        begun = loop.time()
        await port.open(sink)
        port.write(b"more")
        await asyncio.sleep(3)
        assert sink.chunks[-1] == (begun + 2.5, b"!")
        assert len(sink.lost) == 1, "the last reply is accepted only after a gap"
        await asyncio.sleep(1)
        assert [str(error.params["reason"]) for error in sink.lost] == ["pulled", "end of the capture"]
        assert port.report == ReplayReport(
            1, (ReplayDifference(2.0, b"ask2", b"ask9", 6), ReplayDifference(3.0, None, b"more", 0)), 0
        )
        with pytest.raises(PortUnavailable) as caught:
            await port.open(sink)
        assert caught.value.key == "ports.replay_end"

    run(main())


def test_with_request_timing_each_reply_follows_its_request_at_any_time(tmp_path: Path) -> None:
    async def main() -> None:
        port, sink = open_port(recorded(tmp_path / "a.dbcap"), timing="request"), FakeReceiver()
        assert isinstance(port, ReplayPort)
        await port.open(sink)
        await asyncio.sleep(100)
        assert sink.chunks == []
        port.write(b"other")
        port.write(b"ask1")
        await asyncio.sleep(1)
        assert sink.chunks == [(100.25, b"rep"), (100.5, b"ly1")]
        assert port.report.unsent == 1
        port.write(b"ask2")
        await asyncio.sleep(0.5)
        assert sink.chunks[-1] == (101.5, b"reply2")
        assert [(difference.expected, difference.found) for difference in port.report.differences] == [
            (b"ask1", b"other")
        ]
        assert port.report.matched == 2
        await port.close()
        await asyncio.sleep(9)
        assert sink.lost == []

    run(main())


def test_a_request_beyond_the_end_of_a_capture_is_a_difference(tmp_path: Path) -> None:
    async def main() -> None:
        path = tmp_path / "a.dbcap"
        writer = CaptureWriter(path, CaptureHeader(SerialSettings()), now=0.0)
        writer.write_bytes(1.0, "tx", b"ask")
        writer.write_bytes(2.0, "rx", b"reply")
        writer.close()
        port, sink = open_port(f"replay://{path}", timing="request"), FakeReceiver()
        assert isinstance(port, ReplayPort)
        await port.open(sink)
        port.write(b"ask")
        await asyncio.sleep(1.1)
        port.write(b"more")
        assert port.report == ReplayReport(1, (ReplayDifference(2.1, None, b"more", 0),), 0)

    run(main())


@pytest.mark.parametrize("timing", ["clock", "request"])
@pytest.mark.parametrize(("model", "hz"), [("c320", 0.5), ("vc660", 5.0), ("dzb100", 0.5), ("df800", 5.0)])
def test_a_bus_on_a_capture_receives_the_recorded_replies(tmp_path: Path, model: str, hz: float, timing: str) -> None:
    """It receives all replies, and the same requests send the same bytes."""
    path = tmp_path / "a.dbcap"

    async def work(bus: Bus) -> list[str]:
        async with bus:
            drive = Drive(bus, model, 1)
            outcomes = [shown(await drive.status()), (await drive.run(hz)).text()]
            await asyncio.sleep(2)
            return [*outcomes, shown(await drive.status()), (await drive.stop()).text()]

    def shown(status: DriveStatus) -> str:
        return f"{status.state} {[(name, reading.value) for name, reading in status.readings.items()]}"

    async def record() -> list[str]:
        port = RecordingPort(open_port(f"sim://{model}@1"), path)
        outcomes = await work(Bus(port))
        port.end_capture()
        return outcomes

    async def play() -> tuple[list[str], object]:
        bus = open_bus(f"replay://{path}?timing={timing}")
        outcomes = await work(bus)
        return outcomes, bus.port.report  # type: ignore[attr-defined]

    outcomes = run(record())
    again, report = run(play())
    sent = sum(isinstance(record, BytesRecord) and record.direction == "tx" for record in read_capture(path).records)
    assert again == outcomes
    assert report == ReplayReport(sent, (), 0)


def test_a_replay_has_the_serial_settings_of_its_capture_unless_others_are_given(tmp_path: Path) -> None:
    link = recorded(tmp_path / "a.dbcap")
    assert open_port(link).settings == SerialSettings(19200, 8, "E", 1)
    assert open_port(link, baud=9600).settings == SerialSettings(9600, 8, "E", 1)
    assert open_port(link, format="8N2").settings == SerialSettings(19200, 8, "N", 2)
    with pytest.raises(CaptureError):
        open_port(f"replay://{tmp_path}/none.dbcap")


def test_a_recording_port_records_every_byte_and_changes_none(tmp_path: Path) -> None:
    path = tmp_path / "a.dbcap"

    async def main() -> None:
        near, far = create_pair(SerialSettings(4800, 8, "E", 1), has_line_timing=True)
        port, near_sink, far_sink = RecordingPort(near, path), FakeReceiver(), FakeReceiver()
        assert not isinstance(port, PausableReader)
        await asyncio.sleep(50)
        await port.open(near_sink)
        await far.open(far_sink)
        port.write(b"ask")
        await asyncio.sleep(1)
        far.write(b"!")
        await asyncio.sleep(1)
        assert (bytes(near_sink.data), bytes(far_sink.data)) == (b"!", b"ask")
        near.unplug()
        assert len(near_sink.lost) == 1
        with pytest.raises(PortLost):
            port.write(b"not sent, so not recorded")
        near.plug()
        await port.open(near_sink)
        await port.close()
        port.end_capture()
        assert port.error is None

    run(main())
    capture = read_capture(path)
    assert capture.header.settings == SerialSettings(4800, 8, "E", 1)
    assert capture.header.port == "memory://pair"
    kinds = [record.name if isinstance(record, EventRecord) else record.direction for record in capture.records]
    assert kinds == ["opened", "tx", "rx", "lost", "opened", "closed"]
    tx, rx = [record for record in capture.records if isinstance(record, BytesRecord)]
    assert (tx.time_s, tx.data, rx.data) == (0.0, b"ask", b"!")
    assert rx.time_s == pytest.approx(1 + 11 / 4800, abs=1e-6)


def test_a_recording_port_delivers_pending_bytes_where_its_port_does(tmp_path: Path) -> None:
    near, _ = create_pair(SerialSettings(4800, 8, "E", 1), has_line_timing=True)
    assert not isinstance(RecordingPort(near, tmp_path / "a.dbcap"), PendingReader)
    recording = RecordingPort(open_port("sim://vc660@1"), tmp_path / "b.dbcap")
    assert isinstance(recording, PendingReader) and not isinstance(recording, PausableReader)


def test_a_capture_that_cannot_be_created_leaves_the_port_closed(tmp_path: Path) -> None:
    async def main() -> None:
        near, _ = create_pair()
        (tmp_path / "a.dbcap").write_text("an older capture")
        with pytest.raises(CaptureError):
            await RecordingPort(near, tmp_path / "a.dbcap").open(FakeReceiver())
        with pytest.raises(PortLost):
            near.write(b"x")

    run(main())
