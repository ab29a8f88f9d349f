"""Captures as pcapng: frames out of records, the wrap, the file, and what ``drivebus capture export`` says."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from struct import unpack, unpack_from
from typing import Any

import pytest
from click.testing import CliRunner, Result

from drivebus.capture import pcapng
from drivebus.capture.dbcap import BytesRecord, Capture, CaptureError, CaptureHeader, EventRecord, Record
from drivebus.cli.main import cli
from drivebus.commissioning import wireshark
from drivebus.commissioning.decode.framing import CapturedFrame, split_frames
from drivebus.protocols.modbus.rtu import build_frame
from drivebus.serial_settings import SerialSettings

READ = build_frame(bytes.fromhex("030330000001"))
REPLY = build_frame(bytes.fromhex("0303020001"))
WRITE = build_frame(bytes.fromhex("030620000001"))
C320 = b"*00001000018\r1"
STARTED = "2026-11-21T10:00:00+00:00"
STARTED_US = 1795255200_000000
HEAD = f'{{"dbcap": 1, "baud": 9600, "format": "8N1", "port": "usb:1", "started": "{STARTED}", "writer": "w 1"}}\n'


def capture(*records: Record, started: str = STARTED, baud: int = 9600) -> Capture:
    return Capture(CaptureHeader(SerialSettings(baud), "usb:1", started, "w 1"), records)


def tx(time_s: float, data: bytes) -> BytesRecord:
    return BytesRecord(time_s, "tx", data)


def rx(time_s: float, data: bytes, marks: int = 0) -> BytesRecord:
    return BytesRecord(time_s, "rx", data, marks)


def shape(frames: list[CapturedFrame]) -> list[tuple[float, bool, bool, bytes]]:
    return [(frame.time_s, frame.received, frame.from_master, frame.data) for frame in frames]


# frames


def test_a_reply_that_came_in_pieces_is_one_frame_with_the_time_of_the_first() -> None:
    pieces = [rx(0.1, REPLY[:1]), rx(0.116, REPLY[1:4], 1), rx(0.132, REPLY[4:], 1)]
    found = split_frames(capture(tx(0.0, READ), *pieces))
    assert shape(found) == [(0.0, False, True, READ), (0.1, True, False, REPLY)]
    assert found[1].line_errors == 2


@pytest.mark.parametrize(("silence_s", "count"), [(0.0199, 1), (0.0201, 2)])
def test_a_silence_splits_received_bytes_counted_from_the_first_bit_of_the_next(silence_s: float, count: int) -> None:
    later = 1.0 + silence_s + SerialSettings(9600).seconds(len(REPLY))
    assert len(split_frames(capture(rx(1.0, REPLY), rx(later, REPLY)))) == count


def test_at_a_slow_line_the_silence_is_three_and_a_half_characters() -> None:
    line = SerialSettings(600)
    later = 1.0 + line.seconds(len(REPLY) + 3.4)
    assert len(split_frames(capture(rx(1.0, REPLY), rx(later, REPLY), baud=600))) == 1
    assert len(split_frames(capture(rx(1.0, REPLY), rx(later + line.seconds(0.2), REPLY), baud=600))) == 2


@pytest.mark.parametrize(
    ("details", "count"),
    [({"baud": 600, "format": "8N1"}, 1), ({"baud": 600}, 2), ({"baud": "fast", "format": 8}, 2), ({}, 2)],
)
def test_the_characters_are_those_of_the_line_as_it_was_opened_last(details: dict[str, Any], count: int) -> None:
    """A scan opens it with one setting after another; an event that does not tell them changes nothing."""
    opened, later = EventRecord(0.5, "opened", details), 1.0 + SerialSettings(600).seconds(len(REPLY) + 3.4)
    assert len(split_frames(capture(opened, rx(1.0, REPLY), rx(later, REPLY)))) == count


def test_what_we_sent_is_never_joined() -> None:
    found = split_frames(capture(tx(0.0, READ), tx(0.001, READ), rx(0.002, REPLY), tx(0.003, READ)))
    assert [frame.data for frame in found] == [READ, READ, REPLY, READ]


@pytest.mark.parametrize("pieces", [[READ + REPLY], [READ, REPLY], [READ[:3], READ[3:] + REPLY]])
def test_an_adapters_echo_is_the_masters_however_it_came(pieces: list[bytes]) -> None:
    found = split_frames(capture(tx(0.0, READ), *(rx(0.1 + 0.2 * at, piece) for at, piece in enumerate(pieces))))
    if pieces[0] != READ[:3]:
        assert [(frame.received, frame.from_master, frame.data) for frame in found] == [
            (False, True, READ),
            (True, True, READ),
            (True, False, REPLY),
        ]
    else:
        assert len(found) == 3, "0.2 s apart: the beginning is no echo"


@pytest.mark.parametrize("received", [WRITE, WRITE + b"\x00", WRITE + b"\x00" * 4])
def test_a_write_whose_reply_mirrors_it_has_its_reply(received: bytes) -> None:
    """Nothing that could be a reply came after it, so it is the reply."""
    found = split_frames(capture(tx(0.0, WRITE), rx(0.1, received)))
    assert [frame.from_master for frame in found] == [True, False]


def test_the_protocol_of_a_sent_frame_applies_to_the_bytes_after_it() -> None:
    damaged = bytes((REPLY[0] ^ 1,)) + REPLY[1:]
    found = split_frames(
        capture(tx(0, READ), rx(0.1, damaged), tx(1, C320), rx(1.1, REPLY), tx(2, READ), rx(2.1, C320))
    )
    assert [frame.modbus for frame in found] == [True, True, False, False, True, True]


def test_bytes_received_before_any_request_are_classified_by_their_checksum() -> None:
    found = split_frames(capture(rx(0, READ), rx(1, b"\xff\xff"), rx(2, b""), rx(3, C320)))
    assert [frame.modbus for frame in found] == [True, False, False, False]
    assert all(frame.modbus for frame in split_frames(capture(rx(0, C320), tx(1, C320)), all_modbus=True))


def test_an_event_is_kept_as_its_line_with_the_frame_after_it_and_parts_frames() -> None:
    lost = EventRecord(0.102, "lost", {"reason": "拔出"})
    found = split_frames(
        capture(EventRecord(0.0, "opened", {"baud": 9600}), tx(0.1, READ), rx(0.101, REPLY), lost, rx(0.103, REPLY))
    )
    assert [frame.events for frame in found] == [
        ('{"t": 0.0, "event": "opened", "baud": 9600}',),
        (),
        ('{"t": 0.102, "event": "lost", "reason": "拔出"}',),
    ]


def test_an_event_after_the_last_frame_is_kept_with_that_frame() -> None:
    found = split_frames(capture(EventRecord(0.0, "opened"), tx(0.1, READ), EventRecord(0.2, "closed")))
    assert found[0].events == ('{"t": 0.0, "event": "opened"}', '{"t": 0.2, "event": "closed"}')
    assert split_frames(capture(EventRecord(0.0, "opened"))) == []


# the file


def blocks(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Type and body of each block, its two lengths equal and a multiple of four."""
    at = 0
    while at < len(data):
        kind, size = unpack_from("<II", data, at)
        assert size % 4 == 0 and unpack_from("<I", data, at + size - 4) == (size,)
        yield kind, data[at + 8 : at + size - 4]
        at += size


def options(body: bytes) -> list[tuple[int, bytes]]:
    found, at = [], 0
    while True:
        code, size = unpack_from("<HH", body, at)
        if code == 0:
            assert size == 0 and at + 4 == len(body)
            return found
        found.append((code, body[at + 4 : at + 4 + size]))
        at += 4 + size + -size % 4


def test_the_blocks_are_those_of_the_specification() -> None:
    packets = [
        pcapng.PcapngPacket(2**32 + 5, b"abcde", inbound=True, damaged=True, comments=("one", "二")),
        pcapng.PcapngPacket(0, b"", False),
    ]
    data = pcapng.encode(packets, pcapng.PcapngInterface(228, "usb:1", "9600 8N1", 9600), "w 1", "why")
    (section, head), (interface, line), (kind, first), (_, second) = blocks(data)
    assert (section, interface, kind) == (0x0A0D0D0A, 1, 6)
    assert unpack("<IHHq", head[:16]) == (0x1A2B3C4D, 1, 0, -1)
    assert options(head[16:]) == [(1, b"why"), (4, b"w 1")]
    assert unpack("<HHI", line[:8]) == (228, 0, 0)
    assert options(line[8:]) == [(2, b"usb:1"), (3, b"9600 8N1"), (8, (9600).to_bytes(8, "little")), (9, b"\x06")]
    assert unpack("<5I", first[:20]) == (0, 1, 5, 5, 5) and first[20:28] == b"abcde\0\0\0"
    assert options(first[28:]) == [(2, (0x80000001).to_bytes(4, "little")), (1, b"one"), (1, "二".encode())]
    assert options(second[20:]) == [(2, b"\x02\0\0\0")]


def test_a_text_is_cut_where_an_option_could_not_hold_it_and_half_a_character_is_replaced() -> None:
    (_, head), _ = blocks(pcapng.encode([], pcapng.PcapngInterface(228), comment="\ud800" + "长" * 70_000))
    (_, text), *_ = options(head[16:])
    assert text.decode() == "?" + "长" * 999


def packets(*frames: CapturedFrame, **rest: Any) -> list[bytes]:
    """The datagrams of frames."""
    data = wireshark.encode_wireshark(capture(**rest), frames)
    found = [body for kind, body in blocks(data) if kind == 6]
    return [body[20 : 20 + unpack_from("<I", body, 12)[0]] for body in found]


@pytest.mark.parametrize(
    ("frame", "source", "target", "ports"),
    [
        (
            CapturedFrame(time_s=0, data=READ, received=False, from_master=True, modbus=True),
            "c6336401",
            "c0000203",
            (50500, 50502),
        ),
        (
            CapturedFrame(time_s=0, data=READ, received=True, from_master=True, modbus=True),
            "c6336401",
            "c0000203",
            (50500, 50502),
        ),
        (
            CapturedFrame(time_s=0, data=REPLY, received=True, from_master=False, modbus=True),
            "c0000203",
            "c6336401",
            (50502, 50500),
        ),
        (CapturedFrame(time_s=0, data=C320, received=False, from_master=True), "c6336401", "c6336402", (50500, 50501)),
        (CapturedFrame(time_s=0, data=C320, received=True, from_master=False), "c6336402", "c6336401", (50501, 50500)),
        (
            CapturedFrame(time_s=0, data=b"", received=True, from_master=False, modbus=True),
            "c6336402",
            "c6336401",
            (50502, 50500),
        ),
    ],
)
def test_the_datagram_tells_who_spoke_to_whom(
    frame: CapturedFrame, source: str, target: str, ports: tuple[int, int]
) -> None:
    (datagram,) = packets(frame)
    assert (datagram[12:16].hex(), datagram[16:20].hex()) == (source, target)
    assert unpack(">HHHH", datagram[20:28]) == (*ports, 8 + len(frame.data), 0)
    assert datagram[28:] == frame.data
    assert unpack_from(">H", datagram, 2) == (len(datagram),)
    total = sum(unpack(">10H", datagram[:20]))
    assert (total & 0xFFFF) + (total >> 16) == 0xFFFF, "the header's check"


def test_a_burst_without_end_becomes_several_datagrams() -> None:
    burst = CapturedFrame(time_s=0, data=bytes(9000), received=True, from_master=False, events=("lost",))
    assert [len(packet) - 28 for packet in packets(burst)] == [4096, 4096, 808]
    assert wireshark.encode_wireshark(capture(), [burst]).count(b"lost") == 1


@pytest.mark.parametrize(
    ("started", "began_us"),
    [
        (STARTED, STARTED_US),
        ("2026-11-21T18:00:00.25+08:00", STARTED_US + 250_000),
        ("2026-11-21T10:00:00", STARTED_US),
        ("", None),
        ("last night", None),
        ("1066-10-14T09:00:00Z", None),
        ("0001-01-01T00:00:00+14:00", None),
    ],
)
def test_the_capture_says_when_it_began_or_does_not(started: str, began_us: int | None) -> None:
    """A label; without a zone it is taken as UTC."""
    assert wireshark.capture_start_us(capture(started=started)) == began_us


def test_the_time_of_a_packet_is_that_of_its_record_to_the_microsecond() -> None:
    data = wireshark.encode_wireshark(
        capture(), [CapturedFrame(time_s=86400.000001, data=READ, received=False, from_master=True)]
    )
    (body,) = [body for kind, body in blocks(data) if kind == 6]
    high, low = unpack_from("<II", body, 4)
    assert (high << 32 | low) == STARTED_US + 86400_000001


def test_a_time_beyond_the_range_of_pcapng_is_rejected() -> None:
    frame = CapturedFrame(time_s=1e13, data=READ, received=False, from_master=True)
    wireshark.encode_wireshark(capture(), [frame])
    with pytest.raises(CaptureError, match=r"t = 2e\+13"):
        wireshark.encode_wireshark(capture(), [replace(frame, time_s=2e13)])


# the command


def export(*words: str | Path, lang: str = "en") -> Result:
    return CliRunner().invoke(cli, ["capture", "export", *map(str, words), "--lang", lang])


@pytest.fixture
def trip(tmp_path: Path) -> Path:
    file = tmp_path / "trip.dbcap"
    file.write_text(
        HEAD + f'{{"t":0.5,"tx":"{READ.hex()}"}}\n{{"t":0.75,"rx":"{REPLY.hex()}"}}\n{{"t":1,"tx":"{C320.hex()}"}}\n'
    )
    return file


def test_the_command_writes_the_file_and_says_what_is_in_it_and_how_to_open_it(trip: Path) -> None:
    out = trip.with_suffix(".pcapng")
    result = export(trip, "-o", out)
    assert result.exit_code == 0
    assert f"{out}: 3 frames, 2 sent and 1 received; 2 of them Modbus RTU." in result.stdout
    assert f"wireshark -o mbrtu.udp.port:50502 -o mbrtu.crc_verification:TRUE {out}" in result.stdout
    assert "Modbus ASCII or noise): 1." in result.stderr
    assert len(list(blocks(out.read_bytes()))) == 5
    assert b"trip.dbcap" in out.read_bytes(), "the file says what it is"


def test_the_command_speaks_chinese_and_so_does_the_file(trip: Path) -> None:
    out = trip.with_suffix(".pcapng")
    assert "3 帧，发送 2，收到 1" in export(trip, "-o", out, lang="zh").stdout
    assert "串行帧的外壳" in out.read_bytes().decode(errors="ignore")


def test_the_document_has_the_same_numbers(trip: Path) -> None:
    out = trip.with_suffix(".pcapng")
    result = export(trip, "-o", out, "--all-modbus", "--json")
    assert json.loads(result.stdout) == {
        "file": str(trip),
        "pcapng": str(out),
        "frames": 3,
        "sent": 2,
        "received": 1,
        "modbus": 3,
        "other": 0,
        "started": STARTED,
        "truncated": False,
    }


def test_an_existing_file_is_replaced_only_where_force_says_so(trip: Path) -> None:
    out = trip.with_suffix(".pcapng")
    out.write_text("evidence")
    refused = export(trip, "-o", out)
    assert refused.exit_code == 2 and out.read_text() == "evidence"
    assert f"{out} already exists" in refused.stderr and "--force" in refused.stderr
    assert export(trip, "-o", out, "--force").exit_code == 0
    assert out.read_bytes()[:4] == b"\x0a\x0d\x0d\x0a"
    assert sorted(path.name for path in trip.parent.iterdir()) == ["trip.dbcap", "trip.pcapng"]


def test_a_forced_link_to_the_capture_itself_spares_the_capture(trip: Path) -> None:
    before, out = trip.read_bytes(), trip.with_suffix(".pcapng")
    out.symlink_to(trip)
    assert export(trip, "-o", out, "--force").exit_code == 0
    assert trip.read_bytes() == before and not out.is_symlink()


@pytest.mark.parametrize("name", ["trip.dbcap", "trip.pcap", "trip"])
def test_only_a_pcapng_is_written(trip: Path, name: str) -> None:
    result = export(trip, "-o", trip.parent / name, "--force")
    assert result.exit_code == 2 and "ends with .pcapng" in result.output


@pytest.mark.parametrize("words", [(), ("--force",)])
def test_half_a_file_is_taken_away_again(trip: Path, words: tuple[str, ...]) -> None:
    """A disk without room, played by a limit on the size of files."""
    resource = pytest.importorskip("resource")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        result = export(trip, "-o", trip.with_suffix(".pcapng"), *words)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert result.exit_code == 2 and "File too large" in result.stderr
    assert [path.name for path in trip.parent.iterdir()] == ["trip.dbcap"]


def test_a_cut_or_undated_capture_is_exported_with_a_note(tmp_path: Path) -> None:
    file = tmp_path / "cut.dbcap"
    file.write_text(f'{{"dbcap": 1, "baud": 9600, "format": "8N1"}}\n{{"t":1,"tx":"{READ.hex()}"}}\n{{"t":2,"t')
    result = export(file, "-o", tmp_path / "cut.pcapng")
    assert result.exit_code == 0
    assert "1 frames" in result.stdout
    assert "last line is incomplete" in result.stderr and "1970-01-01" in result.stderr


@pytest.mark.parametrize("language", ["en", "zh"])
@pytest.mark.parametrize(
    ("text", "reply_text", "hint"),
    [
        (None, {"en": "can't be read", "zh": "无法读取"}, "--record FILE.dbcap"),
        ("", {"en": "no complete line", "zh": "没有完整的行"}, "--record FILE.dbcap"),
        ("{}\n", {"en": "line 1", "zh": "第 1 行"}, "dbcap"),
        (HEAD + "spoiled\n" + '{"t":1,"tx":""}\n', {"en": "line 2", "zh": "第 2 行"}, ".dbcap"),
        (HEAD + '{"t":1,"tx":"0x"}\n', {"en": "line 2: tx is 0x; expected", "zh": "第 2 行：tx 为 0x"}, ".dbcap"),
    ],
)
def test_a_missing_or_damaged_capture_is_rejected_with_file_line_and_next_step(
    tmp_path: Path, text: str | None, reply_text: dict[str, str], hint: str, language: str
) -> None:
    file, out = tmp_path / "x.dbcap", tmp_path / "x.pcapng"
    if text is not None:
        file.write_text(text)
    result = export(file, "-o", out, lang=language)
    assert result.exit_code == 2 and not out.exists()
    first, second = result.stderr.splitlines()
    assert str(file) in first and reply_text[language] in first
    assert hint in second


def test_a_folder_that_is_not_there_is_named(trip: Path) -> None:
    result = export(trip, "-o", trip.parent / "no" / "x.pcapng")
    assert result.exit_code == 2
    assert "can't be written: No such file or directory" in result.stderr
