"""Modbus codec: frames that it accepts and rejects."""

from __future__ import annotations

from dataclasses import dataclass
from struct import error as StructError
from typing import Any

import pytest

from drivebus.errors import (
    AddressError,
    AlphabetError,
    ChecksumError,
    CodeError,
    EchoError,
    HeaderError,
    LengthError,
    ProtocolError,
    TerminatorError,
)
from drivebus.protocols.checksum import lrc
from drivebus.protocols.codec import Complete, CompleteIfSilent, Incomplete
from drivebus.protocols.modbus import (
    BitValues,
    Diagnostics,
    DiagnosticsReply,
    ExceptionReply,
    IllegalRequest,
    ModbusAsciiCodec,
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
    parse_request_frame,
    registers_written,
)
from drivebus.protocols.modbus.ascii import build_frame as ascii_frame
from drivebus.protocols.modbus.rtu import build_frame as rtu_frame

CODECS = [ModbusRtuCodec(), ModbusAsciiCodec(), ModbusRtuCodec("short"), ModbusAsciiCodec("short")]
NAMES = ["rtu", "ascii", "rtu-short", "ascii-short"]
every_codec = pytest.mark.parametrize("codec", CODECS, ids=NAMES)
Codec = ModbusRtuCodec | ModbusAsciiCodec


def frame(codec: Codec, octets: str) -> bytes:
    """Octets with their proper check, whatever they say."""
    return (rtu_frame if codec.encoding == "rtu" else ascii_frame)(bytes.fromhex(octets))


REFUSED = [
    ("another byte count", ReadRegisters(1, 0, 2), "01 03 02 00 01", LengthError, 4, 2),
    ("another function", ReadRegisters(1, 0, 1), "01 04 02 00 01", EchoError, 3, 4),
    ("another function's exception", ReadRegisters(1, 0, 1), "01 86 02", EchoError, 3, 0x86),
    ("another register", WriteRegister(1, 2, 3), "01 06 00 12 00 03", EchoError, 2, 0x12),
    ("another value", WriteRegister(1, 2, 3), "01 06 00 02 00 04", EchoError, 3, 4),
    ("another coil", WriteBit(1, 2, True), "01 05 00 03 FF 00", EchoError, 2, 3),
    ("a coil left off", WriteBit(1, 2, True), "01 05 00 02 00 00", EchoError, 0xFF00, 0),
    ("another first register", WriteRegisters(1, 2, (1, 2)), "01 10 00 03 00 02", EchoError, 2, 3),
    ("another count of registers", WriteRegisters(1, 2, (1, 2)), "01 10 00 02 00 01", EchoError, 2, 1),
    ("another count of coils", WriteBits(1, 2, (True,)), "01 0F 00 02 00 02", EchoError, 1, 2),
    ("other loop-back data", Diagnostics(1, 0x5AA5), "01 08 00 00 5A A4", EchoError, 0x5AA5, 0x5AA4),
    ("another sub-function", Diagnostics(1, 0x5AA5), "01 08 00 01 5A A5", EchoError, 0, 1),
    ("an undocumented exception", ReadRegisters(1, 0, 1), "01 83 09", CodeError, ("1-8", "10", "11"), 9),
    ("padding that is not zero", ReadBits(1, 0, 3), "01 01 01 0D", CodeError, 0, 1),
]


@every_codec
@pytest.mark.parametrize(
    ("asked", "octets", "error", "expected", "found"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED]
)
def test_a_reply_that_differs_from_its_request_is_rejected_with_both_numbers(
    codec: Codec, asked: ModbusRequest, octets: str, error: type[ProtocolError], expected: object, found: object
) -> None:
    with pytest.raises(error) as caught:
        codec.decode_reply(asked, frame(codec, octets))
    assert type(caught.value) is error
    assert (caught.value.expected, caught.value.found, caught.value.size) == (expected, found, 0)


FOREIGN = [
    ("its read", ReadRegisters(1, 0, 2), "07 03 04 00 01 00 02"),
    ("a read of another size", ReadRegisters(1, 0, 2), "07 03 02 00 01"),
    ("its echo", WriteRegister(1, 0, 2), "07 06 00 00 00 02"),
    ("a read while a write is asked", WriteRegister(1, 0, 2), "07 03 02 00 01"),
    ("an exception", ReadRegisters(1, 0, 2), "07 83 02"),
    ("an exception of another function", ReadRegisters(1, 0, 2), "07 86 02"),
]


@every_codec
@pytest.mark.parametrize(("asked", "octets"), [row[1:] for row in FOREIGN], ids=[row[0] for row in FOREIGN])
def test_another_stations_whole_frame_carries_its_size(codec: Codec, asked: ModbusRequest, octets: str) -> None:
    data = frame(codec, octets)
    with pytest.raises(AddressError) as caught:
        codec.decode_reply(asked, data + b"\x01\x03")
    assert (caught.value.expected, caught.value.found, caught.value.size) == (1, 7, len(data))


@every_codec
@pytest.mark.parametrize(("asked", "octets"), [row[1:] for row in FOREIGN], ids=[row[0] for row in FOREIGN])
def test_another_stations_frame_with_a_bad_check_is_noise(codec: Codec, asked: ModbusRequest, octets: str) -> None:
    data = bytearray(frame(codec, octets))
    place = -4 if codec.encoding == "ascii" else -1
    data[place] = 0x31 if data[place] == 0x30 else 0x30
    with pytest.raises(ChecksumError) as caught:
        codec.decode_reply(asked, bytes(data))
    assert caught.value.size == 0


@pytest.mark.parametrize("codec", CODECS[2:], ids=NAMES[2:])
@pytest.mark.parametrize(("asked", "function"), [(WriteRegister(1, 2, 3), 16), (ReadRegisters(1, 0, 2), 6)])
def test_a_short_error_of_another_function_is_none(codec: Codec, asked: ModbusRequest, function: int) -> None:
    with pytest.raises(EchoError) as caught:
        codec.decode_reply(asked, frame(codec, f"01 {function:02X} 00") + b"000000")
    assert (caught.value.expected, caught.value.found) == (asked.function, function)


def test_an_unknown_function_ends_at_the_largest_frame_even_where_a_later_check_would_fit() -> None:
    """Serial Line V1.02, 2.5.1: 256 bytes."""
    for size in (256, 257, 300):
        octets = b"\x01\x2b" + b"\x55" * (size - 4)
        data = rtu_frame(octets)
        assert len(data) == size
        with pytest.raises(IllegalRequest if size == 256 else LengthError):
            ModbusRtuCodec().decode_request(data)
        assert ModbusRtuCodec().decode_request(data[:255]) == Incomplete(256)
    assert ModbusRtuCodec().decode_request(data[:5]) == Incomplete(6)


def test_a_codec_names_its_family_and_encoding() -> None:
    for codec, encoding in ((ModbusRtuCodec(), "rtu"), (ModbusAsciiCodec(), "ascii")):
        assert (codec.family, codec.encoding, codec.broadcast_address) == ("modbus", encoding, 0)
        assert (codec.error_form, codec.max_read) == ("exception", 125)
    assert (ModbusRtuCodec("short", 4).error_form, ModbusAsciiCodec("short", 4).max_read) == ("short", 4)


@pytest.mark.parametrize("third", ["01", "04", "FF"])
def test_a_short_rtu_error_is_00_and_nothing_else(third: str) -> None:
    codec = ModbusRtuCodec("short")
    assert codec.decode_reply(WriteRegister(1, 2, 3), frame(codec, f"01 06 {third}")) == Incomplete(8)


@pytest.mark.parametrize("third", ["01", "04", "FF"])
def test_a_short_error_is_00_and_nothing_else(third: str) -> None:
    codec = ModbusAsciiCodec("short")
    assert codec.decode_reply(WriteRegister(1, 2, 3), frame(codec, f"01 06 {third}")) == Incomplete(17)


@every_codec
def test_no_station_replies_for_the_broadcast_address(codec: Codec) -> None:
    """A frame from address 0 is never a reply; after a broadcast not even the echo is one."""
    echo = codec.encode_request(WriteRegister(0, 2, 3))
    with pytest.raises(HeaderError):
        codec.decode_reply(WriteRegister(0, 2, 3), echo)
    with pytest.raises(AddressError):
        codec.decode_reply(WriteRegister(1, 2, 3), echo)


@pytest.mark.parametrize("codec", CODECS[2:], ids=NAMES[2:])
@pytest.mark.parametrize("function", ["03", "06"])
def test_another_stations_short_error_carries_its_size(codec: Codec, function: str) -> None:
    asked = ReadRegisters(1, 0, 2) if function == "03" else WriteRegister(1, 0, 2)
    data = frame(codec, f"07 {function} 00")
    with pytest.raises(AddressError) as caught:
        codec.decode_reply(asked, data)
    assert (caught.value.key, caught.value.found, caught.value.size) == ("modbus.address", 7, len(data))


@pytest.mark.parametrize(
    "asked",
    [WriteRegister(1, 0x23, 0xA001), WriteRegisters(3, 0x8C, (1, 2)), WriteBits(225, 0x24, (True,) * 0x601)],
    ids=["06", "10H", "0FH"],
)
def test_a_short_error_that_is_the_beginning_of_an_echo_asks_for_silence(asked: Any) -> None:
    """Only these writes; the error's check has the bytes of register and value, or count."""
    codec = ModbusRtuCodec("short")
    error = codec.encode_reply(ExceptionReply(asked.address, asked.function, None))
    word = asked.value if isinstance(asked, WriteRegister) else len(asked.values)
    done = WriteAck(asked.address, asked.function, asked.register, word)
    echo = codec.encode_reply(done)
    assert echo.startswith(error)
    for end in (5, 6, 7):
        refused = CompleteIfSilent(ExceptionReply(asked.address, asked.function, None), 5, 8)
        assert codec.decode_reply(asked, echo[:end]) == refused
    assert codec.decode_reply(asked, echo) == Complete(done, 8)


def test_a_short_error_of_a_read_needs_no_silence_although_the_request_begins_like_it() -> None:
    """No read is answered by its own echo."""
    codec, asked = ModbusRtuCodec("short"), ReadRegisters(3, 0x83, 1, 4)
    error = codec.encode_reply(ExceptionReply(3, 4, None))
    assert codec.encode_request(asked).startswith(error)
    assert codec.decode_reply(asked, error) == Complete(ExceptionReply(3, 4, None), 5)


@every_codec
def test_a_foreign_frame_of_unknown_length_is_rejected_at_once(codec: Codec) -> None:
    with pytest.raises(AddressError) as caught:
        codec.decode_reply(ReadRegisters(1, 0, 2), frame(codec, "07 42 01 02 03 04"))
    assert caught.value.size == 0


@every_codec
@pytest.mark.parametrize("function", [1, 2, 3, 4, 5, 6, 8, 15, 16])
def test_exceptions_are_replies_in_both_error_forms(codec: Codec, function: int) -> None:
    asked = next(each for each in REQUESTS if each.function == function)
    reply = ExceptionReply(asked.address, function, 2)
    data = codec.encode_reply(reply)
    assert codec.decode_reply(asked, data) == Complete(reply, len(data))


@pytest.mark.parametrize("codec", CODECS[2:], ids=NAMES[2:])
@pytest.mark.parametrize("function", [1, 2, 3, 4, 5, 6, 8, 15, 16])
def test_short_errors_are_replies_to_every_function(codec: Codec, function: int) -> None:
    asked = next(each for each in REQUESTS if each.function == function)
    reply = ExceptionReply(asked.address, function, None)
    data = codec.encode_reply(reply)
    assert codec.decode_reply(asked, data) == Complete(reply, len(data))
    assert len(data) == (5 if codec.encoding == "rtu" else 11)


@pytest.mark.parametrize("codec", CODECS[:2], ids=NAMES[:2])
def test_short_errors_are_no_replies_of_a_standard_station(codec: Codec) -> None:
    with pytest.raises(LengthError):
        codec.decode_reply(ReadRegisters(1, 0, 1), codec.encode_reply(ExceptionReply(1, 3, None)))
    verdict = codec.decode_reply(WriteRegister(1, 0, 1), codec.encode_reply(ExceptionReply(1, 6, None)))
    assert verdict == Incomplete(codec.reply_size(WriteRegister(1, 0, 1)))


REQUESTS: list[ModbusRequest] = [
    ReadBits(3, 0x13, 19),
    ReadBits(3, 0xFFFF, 1, 2),
    ReadRegisters(3, 0x6B, 3),
    ReadRegisters(3, 8, 1, 4),
    WriteBit(3, 0xAC, True),
    WriteRegister(3, 1, 3),
    Diagnostics(3, 0xA537),
    WriteBits(3, 0x13, (True, False, True, True, False, False, True, True, True, False)),
    WriteRegisters(3, 1, (10, 258)),
]
REPLIES = [
    BitValues(3, 1, (True,) * 19),
    BitValues(3, 2, (False,)),
    RegisterValues(3, 3, (0, 1, 0xFFFF)),
    RegisterValues(3, 4, (10,)),
    WriteAck(3, 5, 0xAC, 0xFF00),
    WriteAck(3, 6, 1, 3),
    DiagnosticsReply(3, 0xA537),
    WriteAck(3, 15, 0x13, 10),
    WriteAck(3, 16, 1, 2),
]


@every_codec
@pytest.mark.parametrize("asked", REQUESTS, ids=str)
def test_every_function_goes_there_and_back(codec: Codec, asked: ModbusRequest) -> None:
    sent = codec.encode_request(asked)
    assert codec.decode_request(sent) == Complete(asked, len(sent))
    reply = REPLIES[REQUESTS.index(asked)]
    data = codec.encode_reply(reply)
    assert codec.decode_reply(asked, data) == Complete(reply, len(data))
    assert codec.reply_size(asked) == codec.largest_reply(asked) == len(data)
    assert codec.address_of(asked) == 3


def test_requests_of_two_kinds_are_never_equal() -> None:
    """The bus finds the bytes of a request by its value: of two equal ones, the second would send the first's frame."""
    requests = [
        ReadRegisters(3, 1, 1, 3),
        ReadBits(3, 1, 1, 3),
        WriteRegister(3, 1, 1),
        WriteBit(3, 1, True),
        WriteRegisters(3, 1, (1,)),
        WriteBits(3, 1, (True,)),
        Diagnostics(3, 1),
    ]
    assert len(set(requests)) == len(requests)


def test_ascii_lengths_are_those_of_the_df800_table() -> None:
    codec = ModbusAsciiCodec("short")
    assert len(codec.encode_request(ReadRegisters(1, 0, 4))) == len(codec.encode_request(WriteRegister(1, 0, 4))) == 17
    assert [codec.reply_size(ReadRegisters(1, 0, count)) for count in (1, 2, 3, 4)] == [15, 19, 23, 27]


@every_codec
def test_no_station_answers_a_broadcast(codec: Codec) -> None:
    stop = WriteRegister(0, 0x2000, 2)
    assert codec.reply_size(stop) == codec.largest_reply(stop) == 0
    assert codec.broadcast_address == 0
    with pytest.raises(HeaderError) as caught:
        codec.decode_reply(stop, frame(codec, "07 06 20 00 00 02"))
    with pytest.raises(ProtocolError):
        codec.decode_reply(ReadRegisters(0, 0, 1), frame(codec, "00 03 02 00 01"))
    assert caught.value.found == 7


@every_codec
def test_a_short_error_is_no_reply_to_a_broadcast(codec: Codec) -> None:
    for octets in ("00 06 00", "00 86 02", "00 06 20 00 00 02"):
        with pytest.raises(HeaderError):
            codec.decode_reply(WriteRegister(0, 0x2000, 2), frame(codec, octets))


OUT_OF_RANGE: list[ModbusRequest] = [
    ReadRegisters(0, 0, 1),
    ReadRegisters(248, 0, 1),
    ReadRegisters(1, 0, 0),
    ReadRegisters(1, 0, 5),
    ReadRegisters(1, 0xFFFF, 2),
    ReadRegisters(1, -1, 1),
    ReadRegisters(1, 0, 1, 6),
    ReadBits(0, 0, 1),
    ReadBits(1, 0, 2001),
    ReadBits(1, 0, 1, 3),
    WriteRegister(1, 0x10000, 0),
    WriteRegister(1, 0, 0x10000),
    WriteRegister(1, 0, -1),
    WriteRegister(-1, 0, 0),
    WriteRegisters(1, 0, ()),
    WriteRegisters(1, 0, (0,) * 124),
    WriteRegisters(1, 0xFFFF, (0, 0)),
    WriteRegisters(1, 0, (0x10000,)),
    WriteBits(1, 0, ()),
    WriteBits(1, 0, (True,) * 1969),
    WriteBit(1, 0x10000, True),
    Diagnostics(0, 1),
    Diagnostics(1, 0x10000),
]


SENTENCES: list[tuple[Any, str]] = [
    (ReadRegisters(0, 0, 1), "address 0: expected 1 to 247"),
    (WriteRegister(248, 0, 1), "address 248: expected 0 to 247"),
    (ReadRegisters(1, 0, 1, 2), "function 2: expected 3 to 4"),
    (ReadRegisters(1, 0, 1, 5), "function 5: expected 3 to 4"),
    (ReadBits(1, 0, 1, 0), "function 0: expected 1 to 2"),
    (ReadBits(1, 0, 1, 3), "function 3: expected 1 to 2"),
    (ReadRegisters(1, 0, 126), "count 126: expected 1 to 125"),
    (ReadBits(1, 0, 2001), "count 2001: expected 1 to 2000"),
    (WriteRegisters(1, 0, ()), "count 0: expected 1 to 123"),
    (WriteBits(1, 0, ()), "count 0: expected 1 to 1968"),
    (WriteRegister(1, 0, 0x10000), "value 65536: expected 0 to 65535"),
    (WriteRegisters(1, 0, (0, 0xFFFF, -1)), "value -1: expected 0 to 65535"),
    (Diagnostics(1, -1), "data -1: expected 0 to 65535"),
    (WriteBit(1, 0x10000, True), "register 65536: expected 0 to 65535"),
    (WriteRegisters(1, 0xFFFF, (0, 0)), "register 65535: expected 0 to 65534"),
    (RegisterValues(0, 3, (1,)), "address 0: expected 1 to 247"),
    (RegisterValues(1, 5, (1,)), "function 5: expected 3 to 4"),
    (RegisterValues(1, 3, ()), "count 0: expected 1 to 125"),
    (BitValues(1, 3, (True,)), "function 3: expected 1 to 2"),
    (BitValues(1, 1, ()), "count 0: expected 1 to 2000"),
    (WriteAck(1, 6, 0x10000, 0), "register 65536: expected 0 to 65535"),
    (WriteAck(1, 6, 0, 0x10000), "value 65536: expected 0 to 65535"),
    (DiagnosticsReply(1, -1), "data -1: expected 0 to 65535"),
    (ExceptionReply(1, 0, 1), "function 0: expected 1 to 127"),
    (ExceptionReply(1, 1, 256), "code 256: expected 1 to 255"),
]


@pytest.mark.parametrize(("message", "sentence"), SENTENCES, ids=str)
def test_a_field_out_of_range_is_named_with_its_limits(message: Any, sentence: str) -> None:
    codec = ModbusRtuCodec()
    encode = (
        codec.encode_reply
        if isinstance(message, RegisterValues | BitValues | WriteAck | DiagnosticsReply | ExceptionReply)
        else None
    )
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        (encode or codec.encode_request)(message)


def test_only_a_whole_read_of_its_own_encoding_is_harmless() -> None:
    read = ModbusRtuCodec().encode_request(ReadRegisters(1, 2, 3))
    assert registers_written(read) == ()
    for data, encoding in ((read[:7], "rtu"), (read + b"\x00", "rtu"), (read, "ascii"), (b":" + read[1:], "ascii")):
        with pytest.raises(ProtocolError):
            registers_written(data, encoding)


@pytest.mark.parametrize("high", range(1, 5))
def test_a_write_to_any_register_is_never_taken_for_a_read(high: int) -> None:
    """The high byte of its register looks like a function that only reads."""
    asked = WriteRegister(1, high << 8 | 3, 0x0304)
    assert registers_written(ModbusRtuCodec().encode_request(asked)) == (("holding", high << 8 | 3, 0x0304),)
    assert registers_written(ModbusRtuCodec().encode_request(WriteRegister(high, 3, 4))) == (("holding", 3, 4),)


@pytest.mark.parametrize("request_", OUT_OF_RANGE, ids=str)
@pytest.mark.parametrize("codec", [ModbusRtuCodec(max_read=4), ModbusAsciiCodec(max_read=4)], ids=NAMES[:2])
def test_a_request_out_of_range_is_never_encoded(codec: Codec, request_: ModbusRequest) -> None:
    with pytest.raises(ValueError, match=r"-?\d+.*expected -?\d+ to \d+"):
        codec.encode_request(request_)


AT_THE_LIMIT: list[ModbusRequest] = [
    *(ReadRegisters(address, 0, 1) for address in (1, 247)),
    *(ReadRegisters(1, 0x10000 - count, count, function) for count in (1, 125) for function in (3, 4)),
    *(ReadBits(1, 0x10000 - count, count, function) for count in (1, 2000) for function in (1, 2)),
    *(WriteRegister(address, register, 0xFFFF - register) for address in (0, 247) for register in (0, 0xFFFF)),
    *(WriteRegisters(1, 0x10000 - count, (0xFFFF,) * count) for count in (1, 123)),
    *(WriteBits(1, 0x10000 - count, (True,) * count) for count in (1, 1968)),
    *(WriteBit(0, register, True) for register in (0, 0xFFFF)),
    *(Diagnostics(247, data) for data in (0, 0xFFFF)),
]


@every_codec
@pytest.mark.parametrize("asked", AT_THE_LIMIT, ids=lambda asked: str(asked)[:60])
def test_the_last_valid_value_of_every_field_goes_there_and_back(codec: Codec, asked: ModbusRequest) -> None:
    data = codec.encode_request(asked)
    assert codec.decode_request(data) == Complete(asked, len(data))


def test_values_of_a_register_are_whole_numbers() -> None:
    values: tuple[int, ...] = (1.5,)  # type: ignore[assignment]
    with pytest.raises(StructError):
        ModbusRtuCodec().encode_request(WriteRegisters(1, 0, values))


def test_what_is_no_message_of_modbus_is_not_encoded() -> None:
    with pytest.raises(ValueError, match="no Modbus reply"):
        ModbusRtuCodec().encode_reply(Wrong(1))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="no Modbus request"):
        ModbusRtuCodec().encode_request(Wrong(1))  # type: ignore[arg-type]


@dataclass(frozen=True)
class Wrong:
    address: int


LAST_REPLIES: list[Any] = [
    *(RegisterValues(address, 3, (0, 0xFFFF)) for address in (1, 247)),
    *(RegisterValues(1, 4, (5,) * count) for count in (1, 125)),
    *(BitValues(1, function, (True,) * count) for function in (1, 2) for count in (1, 2000)),
    *(WriteAck(1, function, word, 0xFFFF - word) for function in (5, 6, 15, 16) for word in (0, 0xFFFF)),
    *(DiagnosticsReply(1, data) for data in (0, 0xFFFF)),
    *(ExceptionReply(1, function, code) for function in (1, 0x7F) for code in (1, 0xFF)),
]


@pytest.mark.parametrize("reply", LAST_REPLIES, ids=lambda reply: str(reply)[:60])
def test_the_last_valid_value_of_every_field_of_a_reply_is_written(reply: Any) -> None:
    octets = ModbusRtuCodec().encode_reply(reply)[:-2]
    fields = {
        RegisterValues: lambda: (
            len(reply.values) * 2,
            *(byte for value in reply.values for byte in divmod(value, 256)),
        ),
        BitValues: lambda: (octets[2], *octets[3:]),
        WriteAck: lambda: (*divmod(reply.register, 256), *divmod(reply.value, 256)),
        DiagnosticsReply: lambda: (0, 0, *divmod(reply.data, 256)),
        ExceptionReply: lambda: (reply.code,),
    }[type(reply)]()
    function = reply.function | 0x80 if isinstance(reply, ExceptionReply) else reply.function
    assert octets == bytes((reply.address, function, *fields))
    if isinstance(reply, BitValues):
        assert octets[2] == len(octets) - 3 == (len(reply.values) + 7) // 8


@pytest.mark.parametrize(
    "reply",
    [
        RegisterValues(0, 3, (1,)),
        RegisterValues(248, 3, (1,)),
        RegisterValues(1, 2, (1,)),
        RegisterValues(1, 5, (1,)),
        RegisterValues(1, 3, (0x10000,)),
        BitValues(1, 0, (True,)),
        BitValues(1, 1, ()),
        BitValues(1, 1, (True,) * 2001),
        WriteAck(1, 8, 0, 0),
        WriteAck(1, 6, -1, 0),
        WriteAck(1, 6, 0x10000, 0),
        WriteAck(1, 6, 0, -1),
        DiagnosticsReply(1, -1),
        ExceptionReply(1, 0, 1),
        ExceptionReply(1, 3, 256),
        RegisterValues(1, 3, ()),
        RegisterValues(1, 3, (0,) * 126),
        RegisterValues(1, 3, (-1,)),
        RegisterValues(1, 6, (1,)),
        BitValues(1, 3, (True,)),
        WriteAck(1, 3, 0, 0),
        WriteAck(1, 6, 0, 65536),
        DiagnosticsReply(1, 65536),
        ExceptionReply(1, 3, 0),
        ExceptionReply(1, 0x83, 1),
    ],
    ids=str,
)
def test_a_reply_out_of_range_is_never_encoded(
    reply: RegisterValues | BitValues | WriteAck | DiagnosticsReply | ExceptionReply,
) -> None:
    with pytest.raises(ValueError, match=r"\d"):
        ModbusRtuCodec().encode_reply(reply)


BAD_REQUESTS = [
    ("unknown function", "05 2B 0E 01 00", 1),
    ("function 16H, the manual's own example of an exception", "05 16 00 00", 1),
    ("a sub-function other than 0000", "05 08 00 01 12 34", 1),
    ("no registers at all", "05 03 00 00 00 00", 3),
    ("too many registers", "05 03 00 00 00 7E", 3),
    ("beyond the last register", "05 03 FF FF 00 02", 2),
    ("a coil neither on nor off", "05 05 00 00 12 34", 3),
    ("a byte count that does not fit", "05 10 00 00 00 02 02 00 01", 3),
    ("coils with padding", "05 0F 00 00 00 03 01 0F", 3),
]


@every_codec
@pytest.mark.parametrize(("octets", "code"), [row[1:] for row in BAD_REQUESTS], ids=[row[0] for row in BAD_REQUESTS])
def test_a_bad_request_carries_the_exception_of_the_station(codec: Codec, octets: str, code: int) -> None:
    data = frame(codec, octets)
    with pytest.raises(IllegalRequest) as caught:
        codec.decode_request(data)
    error = caught.value
    assert (error.address, error.function, error.code, error.size) == (5, data_function(octets), code, len(data))
    for end in range(len(data)):
        assert isinstance(codec.decode_request(data[:end]), Incomplete)


def data_function(octets: str) -> int:
    return bytes.fromhex(octets)[1]


REFUSED_NUMBERS = [
    ("05 03 00 00 00 00", "modbus.count", 125, 0),
    ("05 04 00 00 00 7E", "modbus.count", 125, 126),
    ("05 01 00 00 07 D1", "modbus.count", 2000, 2001),
    ("05 02 00 00 00 00", "modbus.count", 2000, 0),
    ("05 10 00 00 00 7C F8" + " 00" * 248, "modbus.count", 123, 124),
    ("05 0F 00 00 07 B1 F7" + " 00" * 247, "modbus.count", 1968, 1969),
    ("05 03 FF FF 00 02", "modbus.range", 0xFFFF, 0x10000),
    ("05 01 FF FF 00 02", "modbus.range", 0xFFFF, 0x10000),
    ("05 10 FF FF 00 02 04 00 00 00 00", "modbus.range", 0xFFFF, 0x10000),
    ("05 10 00 00 00 02 03 00 00 00", "modbus.byte_count", 4, 3),
    ("05 0F 00 00 00 09 01 00", "modbus.byte_count", 2, 1),
    ("05 0F 00 00 00 08 02 00 00", "modbus.byte_count", 1, 2),
    ("05 0F 00 00 00 03 01 0F", "modbus.padding", 0, 1),
    ("05 05 00 00 00 01", "modbus.coil", ("0000H", "FF00H"), 1),
    ("05 08 00 01 12 34", "modbus.sub_function", 0, 1),
    ("05 07 00 00", "modbus.unknown_function", ("1-6", "8", "15", "16"), 7),
    ("05 00 00 00", "modbus.unknown_function", ("1-6", "8", "15", "16"), 0),
]


@every_codec
@pytest.mark.parametrize(("octets", "key", "expected", "found"), REFUSED_NUMBERS, ids=lambda value: str(value)[:24])
def test_a_bad_request_reports_both_numbers(
    codec: Codec, octets: str, key: str, expected: object, found: object
) -> None:
    data = frame(codec, octets)
    with pytest.raises(IllegalRequest) as caught:
        codec.decode_request(data)
    error = caught.value
    assert (error.key, error.expected, error.found, error.size) == (key, expected, found, len(data))
    assert (error.params["address"], error.params["function"]) == (5, data_function(octets))
    assert error.params["code"] == error.code


FOREIGN_EXTENTS = [
    ("07 01 01 05", 6, 6),
    ("07 02 02 05 06", 7, 7),
    ("07 02 01 05", 6, 6),
    ("07 03 02 00 05", 7, 7),
    ("07 03 03 00 05 06", None, None),
    ("07 04 01 05", None, None),
    ("07 01 00", None, 5),
    ("07 03 00", None, 5),
    ("07 2B 02 00 05", None, None),
    ("07 00 02 00 05", None, None),
    ("07 AB 02", 5, 5),
]


@pytest.mark.parametrize(("octets", "exception", "short"), FOREIGN_EXTENTS, ids=lambda value: str(value))
def test_another_stations_frame_has_a_size_only_where_its_function_decides_one(
    octets: str, exception: int | None, short: int | None
) -> None:
    for codec, size in ((ModbusRtuCodec(), exception), (ModbusRtuCodec("short"), short)):
        with pytest.raises(AddressError) as caught:
            codec.decode_reply(ReadRegisters(1, 0, 2), frame(codec, octets))
        assert (caught.value.expected, caught.value.found, caught.value.size) == (1, 7, size or 0)
        assert caught.value.key == ("modbus.address" if size else "modbus.first_byte"), "no station is named unchecked"


@every_codec
@pytest.mark.parametrize("address", [0, 1, 247, 248, 255])
def test_a_request_addresses_a_station_or_all(codec: Codec, address: int) -> None:
    data = frame(codec, f"{address:02X} 06 00 01 00 02")
    if address < 248:
        assert codec.decode_request(data) == Complete(WriteRegister(address, 1, 2), len(data))
        return
    with pytest.raises(AddressError) as caught:
        codec.decode_request(data)
    assert (caught.value.key, caught.value.expected, caught.value.found) == ("modbus.address_range", 247, address)
    assert caught.value.size == len(data)


def test_ascii_has_an_even_number_of_digits_whatever_the_function() -> None:
    """Nothing else tells the length of a request with an unknown function."""
    with pytest.raises(LengthError) as caught:
        ModbusAsciiCodec().decode_request(b":012B000\r\n")
    assert (caught.value.key, caught.value.expected, caught.value.found) == ("modbus.odd_digits", 8, 7)


def test_the_exception_to_an_unknown_function_is_the_manuals() -> None:
    """vc660-exception: 01 96 01 8E 60."""
    with pytest.raises(IllegalRequest) as caught:
        ModbusRtuCodec().decode_request(rtu_frame(bytes.fromhex("01 16 00 00")))
    refusal = ExceptionReply(caught.value.address, caught.value.function, caught.value.code)
    assert ModbusRtuCodec().encode_reply(refusal) == bytes.fromhex("01 96 01 8E 60")


def test_an_unknown_function_without_an_end_is_rejected_at_the_largest_frame() -> None:
    rtu, ascii_ = b"\x01\x2b" + b"\x55" * 300, b":012B" + b"0" * 600
    assert isinstance(ModbusRtuCodec().decode_request(rtu[:255]), Incomplete)
    for codec, data, largest in ((ModbusRtuCodec(), rtu, 256), (ModbusAsciiCodec(), ascii_, 513)):
        with pytest.raises(LengthError) as caught:
            codec.decode_request(data)
        assert caught.value.expected == largest


@every_codec
def test_a_reserved_address_is_no_station(codec: Codec) -> None:
    with pytest.raises(AddressError) as caught:
        codec.decode_request(frame(codec, "F8 03 00 00 00 01"))
    assert (caught.value.expected, caught.value.found) == (247, 248)


@pytest.mark.parametrize("place", range(1, 15))
def test_every_byte_that_is_no_upper_case_digit_is_rejected_in_every_place(place: int) -> None:
    codec, asked = ModbusAsciiCodec(), ReadRegisters(1, 0, 1)
    whole = codec.encode_reply(RegisterValues(1, 3, (0xAB,)))
    if place >= len(whole) - 2:
        error: type[ProtocolError] = TerminatorError
    else:
        error = AlphabetError
    for byte in range(256):
        if byte in b"0123456789ABCDEF" or byte == whole[place]:
            continue
        data = whole[:place] + bytes((byte,)) + whole[place + 1 :]
        with pytest.raises(error) as caught:
            codec.decode_reply(asked, data)
        if error is AlphabetError:
            assert (caught.value.found, caught.value.params["position"]) == (byte, place)


@pytest.mark.parametrize("place", range(1, 21))
def test_a_station_reports_which_byte_of_a_request_is_no_digit(place: int) -> None:
    whole = ModbusAsciiCodec().encode_request(WriteRegisters(1, 2, (0xAB,)))
    data = whole[:place] + b"g" + whole[place + 1 :]
    with pytest.raises(AlphabetError) as caught:
        ModbusAsciiCodec().decode_request(data)
    assert (caught.value.found, caught.value.params["position"]) == (ord("g"), place)


def test_the_length_of_a_counted_request_is_known_with_its_byte_count_and_not_before() -> None:
    """``need`` must be honest: a reader sleeps until then."""
    asked = WriteRegisters(1, 2, (3, 4))
    rtu, ascii_ = ModbusRtuCodec().encode_request(asked), ModbusAsciiCodec().encode_request(asked)
    for codec, data, known in ((ModbusRtuCodec(), rtu, 7), (ModbusAsciiCodec(), ascii_, 15)):
        assert codec.decode_request(data[:known]) == Incomplete(len(data))
        assert codec.decode_request(data[: known - 1]) == Incomplete({7: 9, 15: 19}[known])
    many = ModbusAsciiCodec().encode_request(WriteRegisters(1, 2, (5,) * 10))
    assert ModbusAsciiCodec().decode_request(many[:14]) == Incomplete(19), "half a byte count tells nothing"
    assert ModbusAsciiCodec().decode_request(many[:15]) == Incomplete(len(many))


def test_ascii_is_strict_at_offset_0() -> None:
    data = ModbusAsciiCodec().encode_reply(RegisterValues(1, 3, (7,)))
    with pytest.raises(HeaderError) as caught:
        ModbusAsciiCodec().decode_reply(ReadRegisters(1, 0, 1), b"\xff" + data)
    assert (caught.value.expected, caught.value.found) == (0x3A, 0xFF)


@pytest.mark.parametrize("junk", [b"", b"\x00", b"\xff\xfe", b"01\r\n"])
def test_resync_forgives_a_little_junk_once_when_it_is_switched_on(junk: bytes) -> None:
    codec, asked = ModbusAsciiCodec(tolerate_leading_noise=True), ReadRegisters(1, 0, 1)
    reply = codec.encode_reply(RegisterValues(1, 3, (7,)))
    assert codec.decode_reply(asked, junk + reply) == Complete(RegisterValues(1, 3, (7,)), len(junk + reply))
    for end in range(len(junk + reply)):
        verdict = codec.decode_reply(asked, (junk + reply)[:end])
        assert isinstance(verdict, Incomplete) and end < verdict.need <= len(junk + reply)
    request = codec.encode_request(asked)
    assert codec.decode_request(junk + request) == Complete(asked, len(junk + request))
    for end in range(len(junk + request)):
        verdict = codec.decode_request((junk + request)[:end])
        assert isinstance(verdict, Incomplete) and end < verdict.need <= len(junk + request)
    assert codec.largest_reply(asked) >= len(junk + reply)


def test_resync_ends_after_four_bytes_and_at_the_first_colon() -> None:
    codec, asked = ModbusAsciiCodec(tolerate_leading_noise=True), ReadRegisters(1, 0, 1)
    reply = codec.encode_reply(RegisterValues(1, 3, (7,)))
    with pytest.raises(HeaderError):
        codec.decode_reply(asked, b"\x00" * 5 + reply)
    with pytest.raises(AlphabetError):
        codec.decode_reply(asked, b"::" + reply)


def test_no_station_answers_a_broadcast_with_or_without_noise() -> None:
    assert ModbusAsciiCodec(tolerate_leading_noise=True).largest_reply(WriteRegister(0, 1, 2)) == 0
    assert ModbusAsciiCodec(tolerate_leading_noise=True).largest_reply(WriteRegister(1, 1, 2)) == 17 + 4
    assert ModbusAsciiCodec().largest_reply(WriteRegister(1, 1, 2)) == 17


def test_a_request_of_an_unknown_function_ends_at_its_first_cr_lf_and_asks_for_one_byte_more_until_then() -> None:
    shortest = ascii_frame(bytes.fromhex("012B"))
    assert len(shortest) == 9
    with pytest.raises(IllegalRequest) as caught:
        ModbusAsciiCodec().decode_request(shortest + b"\r\n")
    assert caught.value.size == 9
    for end in (9, 10, 100):
        assert ModbusAsciiCodec().decode_request(b":012B" + b"0" * (end - 5)) == Incomplete(end + 1)
    with pytest.raises(LengthError):
        ModbusAsciiCodec().decode_request(b":012B0\r\n0")
    assert ModbusAsciiCodec().decode_request(b":01FF\r\n00") == Incomplete(10), "too short to be a frame with a check"


def test_lrc_is_over_the_decoded_bytes() -> None:
    assert lrc(bytes.fromhex("01 06 20 00 00 02")) == 0xD7


CHANGES = [
    (ReadRegisters(1, 0, 2), ()),
    (ReadBits(1, 0, 2), ()),
    (Diagnostics(1, 0x5AA5), ()),
    (WriteRegister(1, 0x2000, 1), (("holding", 0x2000, 1),)),
    (WriteRegisters(1, 0x2000, (1, 2)), (("holding", 0x2000, 1), ("holding", 0x2001, 2))),
    (WriteBit(1, 5, True), (("coil", 5, 1),)),
    (WriteBits(1, 5, (True, False)), (("coil", 5, 1), ("coil", 6, 0))),
]


@pytest.mark.parametrize("codec", CODECS[:2], ids=NAMES[:2])
@pytest.mark.parametrize(("asked", "changes"), CHANGES, ids=[str(row[0]) for row in CHANGES])
def test_the_registers_written_follow_from_the_bytes(codec: Codec, asked: ModbusRequest, changes: object) -> None:
    assert registers_written(codec.encode_request(asked), codec.encoding) == changes
    assert parse_request_frame(codec.encode_request(asked), codec.encoding) == asked


@pytest.mark.parametrize("codec", CODECS[:2], ids=NAMES[:2])
def test_bytes_that_are_not_one_whole_request_are_never_called_harmless(codec: Codec) -> None:
    start = codec.encode_request(WriteRegister(1, 0x2000, 1))
    read = codec.encode_request(ReadRegisters(1, 0, 1))
    for data in (start[:-1], start + b"\x00", read + start, start[:-3] + b"\x00" + start[-2:], b""):
        with pytest.raises(ProtocolError):
            registers_written(data, codec.encoding)


def test_one_sentence_of_each_error_is_pinned() -> None:
    rtu, ascii_, asked = ModbusRtuCodec(), ModbusAsciiCodec(), ReadRegisters(1, 0, 1)
    cases: list[tuple[Codec, bytes, str]] = [
        (rtu, frame(rtu, "07 03 02 00 01"), "reply from station 7, expected 1"),
        (rtu, frame(rtu, "01 03 04 00 01 00 02"), "byte count 4 received, 2 expected"),
        (rtu, frame(rtu, "01 04 02 00 01"), "reply with function 4, expected 3"),
        (rtu, bytes.fromhex("01 03 02 00 01 00 00"), "CRC 0000H received, 8479H computed"),
        (ascii_, b":0103020001F8\r\n", "LRC F8H received, F9H computed"),
        (ascii_, b":0103020001F9\n\r", "the frame ends with 0A 0D, 0D 0A expected"),
        (ascii_, b"*0103020001F9\r\n", "the frame begins with 2AH, 3AH (':') expected"),
    ]
    for codec, data, sentence in cases:
        with pytest.raises(ProtocolError) as caught:
            codec.decode_reply(asked, data)
        assert str(caught.value) == sentence
        assert caught.value.text("zh") not in ("", sentence)


@pytest.mark.parametrize("codec", CODECS[:2], ids=NAMES[:2])
def test_an_exception_has_a_code_that_the_standard_knows(codec: Codec) -> None:
    """V1.1b3, 7: 9 is none, and neither is what a damaged byte leaves."""
    asked, known = ReadRegisters(5, 0), {1, 2, 3, 4, 5, 6, 7, 8, 10, 11}
    for code in range(256):
        data = frame(codec, f"05 83 {code:02X}")
        if code in known:
            assert codec.decode_reply(asked, data).message == ExceptionReply(5, 3, code)  # type: ignore[union-attr]
            continue
        with pytest.raises(CodeError) as caught:
            codec.decode_reply(asked, data)
        assert (caught.value.key, caught.value.found) == ("modbus.exception_code", code)


def test_a_read_without_a_count_reads_one_register() -> None:
    assert (ReadRegisters(5, 0).count, ReadRegisters(5, 0).function) == (1, 3)
    assert (ReadBits(5, 0).count, ReadBits(5, 0).function) == (1, 1)


# --- replies that deviate from the standard, as the profile of a model states them ----------------------------------

LONG_COUNT = ModbusRtuCodec(count_bytes=2)
"""Byte count of two bytes in replies to reads (Huanyang H2A with F9.05 = 0)."""


@pytest.mark.parametrize(
    ("asked", "octets", "reply"),
    [
        (ReadRegisters(1, 0x3000, 1), "01 03 00 02 00 02", RegisterValues(1, 3, (2,))),
        (ReadRegisters(1, 0xB005, 2), "01 03 00 04 5D C0 03 F6", RegisterValues(1, 3, (24000, 1014))),
        (ReadRegisters(1, 0, 125, 4), "01 04 00 FA" + " 00 07" * 125, RegisterValues(1, 4, (7,) * 125)),
        (ReadBits(1, 0, 9), "01 01 00 02 81 01", BitValues(1, 1, (True, *(False,) * 6, True, True))),
        (ReadRegisters(1, 0, 1), "01 83 02", ExceptionReply(1, 3, 2)),
        (WriteRegister(1, 0x2000, 1), "01 06 20 00 00 01", WriteAck(1, 6, 0x2000, 1)),
    ],
)
def test_a_byte_count_of_two_bytes_is_read_and_written(asked: ModbusRequest, octets: str, reply: Any) -> None:
    data = frame(LONG_COUNT, octets)
    assert LONG_COUNT.decode_reply(asked, data) == Complete(reply, len(data))
    assert LONG_COUNT.encode_reply(reply) == data
    assert isinstance(reply, ExceptionReply) or LONG_COUNT.reply_size(asked) == LONG_COUNT.largest_reply(asked) == len(
        data
    )
    assert isinstance(LONG_COUNT.decode_reply(asked, data[:-1]), Incomplete)


@pytest.mark.parametrize("count", [1, 2, 12])
def test_neither_form_of_the_byte_count_passes_for_the_other(count: int) -> None:
    asked, reply = ReadRegisters(1, 0x3000, count), RegisterValues(1, 3, (0x0200,) * count)
    for sender, receiver in ((ModbusRtuCodec(), LONG_COUNT), (LONG_COUNT, ModbusRtuCodec())):
        with pytest.raises(LengthError):
            receiver.decode_reply(asked, sender.encode_reply(reply))


@pytest.mark.parametrize("octets", ["01 03 00 04 00 01", "01 03 01 02 00 01", "01 03 02 00 01 00", "01 03 00 00 00 01"])
def test_a_byte_count_of_two_bytes_is_exactly_that_of_the_request(octets: str) -> None:
    with pytest.raises(LengthError) as caught:
        LONG_COUNT.decode_reply(ReadRegisters(1, 0, 1), frame(LONG_COUNT, octets))
    assert caught.value.expected == 2


def test_frames_of_other_stations_beside_a_long_byte_count_are_dropped_whole() -> None:
    """A bus may have stations of both forms."""
    for octets in ("02 03 00 02 00 07", "02 03 02 00 07"):
        data = frame(LONG_COUNT, octets)
        with pytest.raises(AddressError) as caught:
            LONG_COUNT.decode_reply(ReadRegisters(1, 0, 1), data)
        assert caught.value.size == len(data)


REJECTING = ModbusRtuCodec(max_read=1, rejected_read=2)
"""Reads one register at a time, and rejects reads of two with exception 03 (Toshiba VF-S11)."""
PROBE = ReadRegisters(1, 0xFD00, 2)


def test_exception_03_is_the_whole_reply_to_a_rejected_read() -> None:
    """Toshiba E6581913 page 26 prints both frames."""
    assert REJECTING.encode_request(PROBE) == bytes.fromhex("01 03 FD 00 00 02 F5 A7")
    assert REJECTING.decode_reply(PROBE, bytes.fromhex("01 83 03 01 31")) == Complete(ExceptionReply(1, 3, 3), 5)
    assert REJECTING.reply_size(PROBE) == REJECTING.largest_reply(PROBE) == 5
    assert REJECTING.reply_size(ReadRegisters(1, 0xFD00, 1)) == 7


@pytest.mark.parametrize(
    ("octets", "key", "expected", "found"),
    [
        ("01 83 01", "modbus.exception_code", 3, 1),
        ("01 83 02", "modbus.exception_code", 3, 2),
        ("01 83 04", "modbus.exception_code", 3, 4),
        ("01 03 02 17 70", "modbus.byte_count", 4, 2),
        ("01 03 04 17 70 00 00", "modbus.exception_code", 3, 0),
    ],
)
def test_nothing_else_is_a_reply_to_a_rejected_read(octets: str, key: str, expected: int, found: int) -> None:
    with pytest.raises((CodeError, LengthError)) as caught:
        REJECTING.decode_reply(PROBE, frame(REJECTING, octets))
    assert (caught.value.key, caught.value.expected, caught.value.found) == (key, expected, found)


def test_exception_03_is_no_reply_to_any_other_read() -> None:
    """It would be the late reply to a rejected read."""
    late, asked = frame(REJECTING, "01 83 03"), ReadRegisters(1, 0xFD00, 1)
    with pytest.raises(CodeError) as caught:
        REJECTING.decode_reply(asked, late)
    assert (caught.value.key, caught.value.found) == ("modbus.exception_code", 3)
    assert caught.value.expected == ("1-2", "4-8", "10", "11")
    for code in (1, 2, 4):
        assert REJECTING.decode_reply(asked, frame(REJECTING, f"01 83 0{code}")) == Complete(
            ExceptionReply(1, 3, code), 5
        )
    assert ModbusRtuCodec(max_read=1).decode_reply(asked, late) == Complete(ExceptionReply(1, 3, 3), 5)
    assert REJECTING.decode_reply(WriteRegister(1, 2, 3), frame(REJECTING, "01 86 03")) == Complete(
        ExceptionReply(1, 6, 3), 5
    )


def test_only_the_count_of_a_rejected_read_may_be_more_than_the_drive_reads() -> None:
    for codec, count in (
        (REJECTING, 3),
        (ModbusRtuCodec(max_read=1, rejected_read=9), 2),
        (ModbusRtuCodec(max_read=1), 2),
    ):
        with pytest.raises(ValueError, match="count"):
            codec.encode_request(ReadRegisters(1, 0, count))
