"""Captures in Wireshark: tshark's Modbus dissector agrees with our decoder, frame for frame."""

from __future__ import annotations

import os
import subprocess
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from random import Random
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.capture.dbcap import BytesRecord, CaptureHeader, CaptureWriter, read_capture
from drivebus.cli.main import cli
from drivebus.commissioning.decode.framing import split_frames
from drivebus.commissioning.wireshark import WIRESHARK_OPTIONS
from drivebus.errors import ProtocolError
from drivebus.protocols.codec import Complete
from drivebus.protocols.modbus import (
    BitValues,
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    ModbusReply,
    ModbusRequest,
    ModbusRtuCodec,
    ReadBits,
    ReadRegisters,
    RegisterValues,
    WriteAck,
    WriteBit,
    WriteBits,
    WriteRegister,
    WriteRegisters,
    describe,
)
from drivebus.serial_settings import SerialSettings
from peers import need_program

STARTED, STARTED_US = "2026-11-21T10:00:00.000250+00:00", 1795255200_000250
FRAMES = 10_000
NO_OPENSAFETY = ("--disable-protocol", "opensafety")
"""Else Wireshark looks for openSAFETY in what 0FH writes, and finds it in one of the frames below by chance."""
CODEC = ModbusRtuCodec()
FIELDS = (
    "frame.time_epoch",
    "frame.packet_flags_direction",
    "udp.srcport",
    "udp.dstport",
    "ip.src",
    "ip.dst",
    "mbrtu.unit_id",
    "modbus.func_code",
    "mbrtu.crc16.status",
    "modbus.reference_num",
    "modbus.word_cnt",
    "modbus.bit_cnt",
    "modbus.byte_cnt",
    "modbus.regnum16",
    "modbus.regval_uint16",
    "modbus.bitnum",
    "modbus.bitval",
    "modbus.data",
    "modbus.exception_code",
    "modbus.diagnostic_code",
    "modbus.diagnostic.return_query_data.request",
    "modbus.diagnostic.return_query_data.echo",
    "modbus.request_frame",
    "data.data",
    "frame.protocols",
    "frame.packet_flags_symbol_error",
    "frame.comment",
)


pytestmark = pytest.mark.usefixtures("clean_simulated_buses")


# the generated line


@dataclass(frozen=True, slots=True)
class ConversationFrame:
    """Frame of a conversation; for a reply also its request."""

    time_us: int
    data: bytes
    whole: bool
    request: ModbusRequest | None = None
    """The request that it answers; None for a request."""
    request_number: int = 0
    """That request's frame, counted from 1 as tshark does."""


def some_request(chance: Random) -> ModbusRequest:
    """Return a request of any of the nine functions, address and valid length."""
    function, station = chance.choice((1, 2, 3, 4, 5, 6, 8, 15, 16)), chance.randint(1, 247)
    broadcast = function in (5, 6, 15, 16) and chance.random() < 0.05
    station = 0 if broadcast else station
    largest = {1: 2000, 2: 2000, 3: 125, 4: 125, 15: 1968, 16: 123}.get(function, 1)
    count = chance.choice((1, 8, largest, chance.randint(1, largest))) if largest > 1 else 1
    register = chance.choice((0, 0x10000 - count, chance.randint(0, 0x10000 - count)))
    word = chance.choice((0, 0xFFFF, chance.randrange(0x10000)))
    match function:
        case 1 | 2:
            return ReadBits(station, register, count, function)
        case 3 | 4:
            return ReadRegisters(station, register, count, function)
        case 5:
            return WriteBit(station, register, chance.random() < 0.5)
        case 6:
            return WriteRegister(station, register, word)
        case 8:
            return Diagnostics(station, word)
        case 15:
            return WriteBits(station, register, tuple(chance.random() < 0.5 for _ in range(count)))
        case _:
            return WriteRegisters(station, register, tuple(chance.randrange(0x10000) for _ in range(count)))


def some_reply(chance: Random, request: ModbusRequest) -> ModbusReply:
    """Return the normal reply, one time in six an exception."""
    station, function = request.address, request.function
    if chance.random() < 1 / 6:
        return ExceptionReply(station, function, chance.choice((1, 2, 3, 4, 5, 6, 8, 10, 11)))
    match request:
        case ReadBits(count=count):
            return BitValues(station, function, tuple(chance.random() < 0.5 for _ in range(count)))
        case ReadRegisters(count=count):
            return RegisterValues(station, function, tuple(chance.randrange(0x10000) for _ in range(count)))
        case Diagnostics(data=data):
            return DiagnosticsReply(station, data)
        case WriteBit(register=register, value=on):
            return WriteAck(station, function, register, 0xFF00 if on else 0)
        case WriteRegister(register=register, value=value):
            return WriteAck(station, function, register, value)
        case WriteBits(register=register, values=values) | WriteRegisters(register=register, values=values):
            return WriteAck(station, function, register, len(values))


def damaged(chance: Random, data: bytes) -> bytes:
    """Return data with one to three inverted bits, each of which the CRC detects."""
    number = int.from_bytes(data, "big")
    for place in chance.sample(range(8 * len(data)), chance.randint(1, 3)):
        number ^= 1 << place
    return number.to_bytes(len(data), "big")


def conversation(seed: int, frames: int) -> list[ConversationFrame]:
    """Return requests and replies; damaged requests and broadcasts, and one in twenty others, stay unanswered."""
    chance, found, at = Random(seed), list[ConversationFrame](), 0
    while len(found) < frames:
        request = some_request(chance)
        data = CODEC.encode_request(request)
        broken = chance.random() < 0.05
        found.append(
            ConversationFrame(
                at := at + chance.randint(30_000, 200_000), damaged(chance, data) if broken else data, not broken
            )
        )
        if broken or request.address == 0 or chance.random() < 0.05:
            continue
        asked_in, data = len(found), CODEC.encode_reply(some_reply(chance, request))
        broken = chance.random() < 0.05
        data = damaged(chance, data) if broken else data
        found.append(ConversationFrame(at := at + chance.randint(5_000, 100_000), data, not broken, request, asked_in))
    return found[:frames]


def recorded(path: Path, frames: list[ConversationFrame], seed: int) -> Path:
    """Write the capture of a conversation; half of the replies come in two pieces."""
    chance = Random(seed)
    writer = CaptureWriter(path, CaptureHeader(SerialSettings(115200), "generated", STARTED, "test"), now=0.0)
    for frame in frames:
        at = frame.time_us / 1e6
        if frame.request is None or chance.random() < 0.5:
            writer.write_bytes(at, "tx" if frame.request is None else "rx", frame.data)
        else:
            cut = chance.randrange(1, len(frame.data))
            writer.write_bytes(at, "rx", frame.data[:cut])
            writer.write_bytes(at + 0.004, "rx", frame.data[cut:])
    writer.close()
    return path


# decoding by tshark


def tshark(file: Path, home: Path, *options: str) -> str:
    """Return tshark's output, without the user's preferences."""
    command = [need_program("tshark", "tshark"), "-r", str(file), *options]
    env = os.environ | {"HOME": str(home), "XDG_CONFIG_HOME": str(home), "WIRESHARK_CONFIG_DIR": str(home)}
    return subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout


def tshark_fields(file: Path, home: Path) -> list[dict[str, str]]:
    """Return the fields of every packet, without absent ones; several values of one field are joined by commas."""
    wanted = [word for name in FIELDS for word in ("-e", name)]
    out = tshark(
        file,
        home,
        *WIRESHARK_OPTIONS.split(),
        *NO_OPENSAFETY,
        "-T",
        "fields",
        "-E",
        "separator=/t",
        "-E",
        "occurrence=a",
        *wanted,
    )
    rows = (line.split("\t") for line in out.splitlines())
    return [{name: value for name, value in zip(FIELDS, row, strict=True) if value} for row in rows]


def exported(capture: Path, *words: str) -> Path:
    out = capture.with_suffix(".pcapng")
    result = CliRunner().invoke(cli, ["capture", "export", str(capture), "-o", str(out), *words])
    assert result.exit_code == 0, result.output
    return out


def numbers(text: str) -> list[int]:
    return [int(number, 0) for number in text.split(",")]


def fields_of_tshark(row: dict[str, str]) -> dict[str, Any]:
    """Return the Modbus fields of a packet under drivebus's names."""
    names = {
        "mbrtu.unit_id": "address",
        "modbus.func_code": "function",
        "modbus.reference_num": "register",
        "modbus.word_cnt": "count",
        "modbus.bit_cnt": "count",
        "modbus.byte_cnt": "bytes",
        "modbus.exception_code": "exception",
        "modbus.diagnostic_code": "sub_function",
    }
    found: dict[str, Any] = {ours: int(row[name]) for name, ours in names.items() if name in row}
    for first, values in (("modbus.regnum16", "modbus.regval_uint16"), ("modbus.bitnum", "modbus.bitval")):
        if first in row:
            places = numbers(row[first])
            found["first"], found["values"] = places[0], numbers(row[values])
            assert places == [(found["first"] + at) % 0x10000 for at in range(len(found["values"]))]
    for name, ours in (("request", "asked"), ("echo", "echoed")):
        if (text := row.get(f"modbus.diagnostic.return_query_data.{name}")) is not None:
            found[ours] = text
    return found | ({"data": row["modbus.data"]} if "modbus.data" in row else {})


# decoding by drivebus


def fields_of_drivebus(frame: ConversationFrame) -> dict[str, Any]:
    """Return the same fields from drivebus's ``decode_request`` or ``decode_reply``."""
    message = decoded(frame)
    assert message is not None
    found: dict[str, Any] = {"address": message.address, "function": message.function}
    match message:
        case ReadBits() | ReadRegisters():
            return found | {"register": message.register, "count": message.count}
        case WriteBit(register=register, value=on):
            return found | {"register": register, "data": "ff00" if on else "0000"}
        case WriteRegister(register=register, value=value):
            return found | {"register": register, "data": f"{value:04x}"}
        case Diagnostics(data=data):
            return found | {"sub_function": 0, "asked": f"{data:04x}"}
        case WriteBits(register=register, values=values):
            packed = sum(1 << at for at, bit in enumerate(values) if bit).to_bytes(-(-len(values) // 8), "little")
            return found | {"register": register, "count": len(values), "bytes": len(packed), "data": packed.hex()}
        case WriteRegisters(register=register, values=values):
            count = len(values)
            return found | {"register": register, "count": count, "bytes": 2 * count} | listed(register, values)
        case BitValues(values=values):
            assert frame.request is not None and isinstance(frame.request, ReadBits)
            return found | {"bytes": -(-len(values) // 8)} | listed(frame.request.register, values)
        case RegisterValues(values=values):
            assert frame.request is not None and isinstance(frame.request, ReadRegisters)
            return found | {"bytes": 2 * len(values)} | listed(frame.request.register, values)
        case WriteAck(function=function, register=register, value=value):
            return found | {"register": register} | ({"count": value} if function > 8 else {"data": f"{value:04x}"})
        case DiagnosticsReply(data=data):
            return found | {"sub_function": 0, "echoed": f"{data:04x}"}
        case ExceptionReply(code=code):
            return found | {"exception": code}
        case _:
            raise AssertionError(message)


def listed(first: int, values: tuple[int, ...]) -> dict[str, Any]:
    return {"first": first, "values": [int(value) for value in values]}


def decoded(frame: ConversationFrame) -> Any:
    """Return the message, None where drivebus's decoder rejects the frame."""
    try:
        verdict = (
            CODEC.decode_request(frame.data) if frame.request is None else CODEC.decode_reply(frame.request, frame.data)
        )
    except ProtocolError:
        return None
    return verdict.message if isinstance(verdict, Complete) and verdict.size == len(frame.data) else None


@dataclass(frozen=True, slots=True)
class TsharkComparison:
    """A conversation and tshark's fields of it."""

    frames: list[ConversationFrame]
    rows: list[dict[str, str]]

    def __iter__(self) -> Iterator[tuple[ConversationFrame, dict[str, str]]]:
        return zip(self.frames, self.rows, strict=True)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> TsharkComparison:
    folder = tmp_path_factory.mktemp("tshark")
    frames = conversation(20261121, FRAMES)
    out = exported(recorded(folder / "generated.dbcap", frames, 7), "--all-modbus")
    return TsharkComparison(frames, tshark_fields(out, folder))


def test_the_generated_conversation_covers_all_functions_exceptions_and_damage(line: TsharkComparison) -> None:
    """Every function has requests, replies, exceptions, and damaged frames on both sides."""
    requests, replies, refusals = Counter[int](), Counter[int](), Counter[int]()
    for frame, _ in line:
        if frame.whole:
            refused = frame.data[1] & 0x80
            (requests if frame.request is None else refusals if refused else replies)[frame.data[1] & 0x7F] += 1
    for each in (requests, replies, refusals):
        assert set(each) == {1, 2, 3, 4, 5, 6, 8, 15, 16} and min(each.values()) > 40
    broken = Counter(frame.request is None for frame in line.frames if not frame.whole)
    assert min(broken[True], broken[False]) > 150
    assert sum(frame.data[0] == 0 for frame in line.frames) > 50


def padding(frame: ConversationFrame) -> int:
    """Return the number of padding bits that tshark 4.0 shows in a reply whose last bit is number 65,535.

    Its bit numbers wrap to 0 there. Padding is not data (Modbus Application Protocol V1.1b3, 6.1).
    """
    if not isinstance(frame.request, ReadBits) or frame.data[1] & 0x80:
        return 0
    return -frame.request.count % 8 if frame.request.register + frame.request.count == 0x10000 else 0


def test_every_intact_frame_has_the_same_fields_for_tshark_and_for_our_decoder(line: TsharkComparison) -> None:
    different, padded = [], Counter[bool]()
    for at, (frame, row) in enumerate(line):
        if frame.whole:
            shown, mine, more = fields_of_tshark(row), fields_of_drivebus(frame), padding(frame)
            if more:
                longer = shown["values"] == mine["values"] + [0] * more
                padded[longer] += 1
                shown["values"] = mine["values"] if longer else shown["values"]
            different += [(at, shown, mine)] * (shown != mine)
    assert different == []
    assert len(padded) == 1, "tshark shows padding always, or since a later version never"


def test_tshark_and_our_decoder_refuse_the_same_frames(line: TsharkComparison) -> None:
    """The CRC is good for tshark exactly where our strict decoder accepts the frame."""
    different = [frame for frame, row in line if (row["mbrtu.crc16.status"] == "1") != (decoded(frame) is not None)]
    assert different == []
    assert Counter(row["mbrtu.crc16.status"] for row in line.rows)["0"] == sum(not frame.whole for frame in line.frames)


def test_our_tolerant_reader_shows_the_same_station_and_function_of_a_damaged_frame(line: TsharkComparison) -> None:
    for frame, row in line:
        if not frame.whole:
            way = "request" if frame.request is None else "response"
            fields = describe(frame.data, "rtu", way).fields
            shown = {name: fields[name] for name in ("address", "function")}
            both = {"address": int(row["mbrtu.unit_id"]), "function": int(row["modbus.func_code"])}
            assert shown["address"] == both["address"]
            assert shown["function"] & 0x7F == both["function"]


def test_times_are_right_to_the_microsecond(line: TsharkComparison) -> None:
    assert [Decimal(row["frame.time_epoch"]) * 1_000_000 for row in line.rows] == [
        STARTED_US + frame.time_us for frame in line.frames
    ]


def test_tshark_shows_requests_as_sent_and_replies_as_received(line: TsharkComparison) -> None:
    """Both the direction of the packet and the ports by which the dissector distinguishes query and response."""
    ways = [(int(row["frame.packet_flags_direction"], 0), row["udp.srcport"], row["udp.dstport"]) for row in line.rows]
    assert ways == [(2, "50500", "50502") if frame.request is None else (1, "50502", "50500") for frame in line.frames]


def test_each_response_is_linked_to_the_request_that_it_answers(line: TsharkComparison) -> None:
    answers = [(frame.request_number, row) for frame, row in line if frame.request is not None and frame.whole]
    normal = [(request, row) for request, row in answers if "modbus.exception_code" not in row]
    assert len(normal) > 3000
    assert [(request, row) for request, row in normal if int(row["modbus.request_frame"]) != request] == []


def test_without_all_modbus_only_damaged_requests_are_not_modbus(tmp_path: Path) -> None:
    """drivebus sends no damaged request; a damaged reply is recognized by its request."""
    frames = conversation(1, 1000)
    capture = recorded(tmp_path / "one.dbcap", frames, 1)
    modbus = [frame.modbus for frame in split_frames(read_capture(capture))]
    assert modbus == [frame.whole or frame.request is not None for frame in frames]
    assert Counter(modbus)[False] > 10


# a real flow


def run(*words: str) -> None:
    result = CliRunner().invoke(cli, list(words))
    assert result.exit_code == 0, result.output


def test_a_recorded_status_and_stop_are_shown_as_queries_and_responses(tmp_path: Path) -> None:
    drive = ("sim://vc660@1", "--model", "vc660", "--address", "1", "--record")
    for verb in ("status", "stop"):
        run(verb, *drive, str(tmp_path / f"{verb}.dbcap"))
        capture = tmp_path / f"{verb}.dbcap"
        records = [record for record in read_capture(capture).records if isinstance(record, BytesRecord)]
        shown = tshark(exported(capture), tmp_path, *WIRESHARK_OPTIONS.split()).splitlines()
        assert len(shown) == len(records) > 2
        for row, record in zip(shown, records, strict=True):
            assert ("Query: Unit:   1" if record.direction == "tx" else "Response: Unit:   1") in row
            assert ("198.51.100.1 → 192.0.2.1 " if record.direction == "tx" else "192.0.2.1 → 198.51.100.1 ") in row
    assert any("Query: Unit:   1, Func:   6: Write Single Register" in row for row in shown)


@pytest.mark.parametrize("model", ["c320", "dzb100"])
def test_frames_of_another_protocol_are_shown_as_their_raw_bytes(tmp_path: Path, model: str) -> None:
    capture = tmp_path / "one.dbcap"
    run("status", f"sim://{model}@1", "--model", model, "--address", "1", "--record", str(capture))
    rows = tshark_fields(exported(capture), tmp_path)
    records = [record for record in read_capture(capture).records if isinstance(record, BytesRecord)]
    assert [row["data.data"] for row in rows] == [record.data.hex() for record in records]
    assert {row["frame.protocols"] for row in rows} == {"ip:udp:data"}


def test_events_echoes_and_bytes_that_the_hardware_marked_are_shown(tmp_path: Path) -> None:
    request, reply = CODEC.encode_request(ReadRegisters(1, 100)), CODEC.encode_reply(RegisterValues(1, 3, (7,)))
    writer = CaptureWriter(tmp_path / "one.dbcap", CaptureHeader(SerialSettings(), started=STARTED), now=0.0)
    writer.write_event(0.0, "opened", baud=9600)
    writer.write_bytes(0.1, "tx", request)
    writer.write_bytes(0.2, "rx", request + reply, 1)
    writer.write_event(0.3, "lost", reason="hang-up")
    writer.close()
    rows = tshark_fields(exported(tmp_path / "one.dbcap"), tmp_path)
    assert [row["udp.dstport"] for row in rows] == ["50502", "50502", "50500"], "the echo is the master's"
    assert [int(row["frame.packet_flags_direction"], 0) for row in rows] == [2, 1, 1], "but it was received"
    assert [row["frame.packet_flags_symbol_error"] for row in rows] == ["0", "1", "1"]
    assert '"event": "opened"' in rows[0]["frame.comment"] and '"reason": "hang-up"' in rows[1]["frame.comment"]
    assert rows[2]["modbus.regval_uint16"] == "7"
