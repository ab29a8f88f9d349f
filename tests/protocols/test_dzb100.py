"""DZB100 frames: worked vectors, traps of the manual, and random bytes."""

from __future__ import annotations

import math
import random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivebus import i18n
from drivebus.errors import AddressError, AlphabetError, ChecksumError, CodeError, EchoError, HeaderError, ProtocolError
from drivebus.protocols import dzb100
from drivebus.protocols.codec import Complete, Effect, Incomplete
from drivebus.protocols.dzb100 import Dzb100Codec, Dzb100Command
from fixtures.vectors import Vector, vectors_by_id

VECTORS = vectors_by_id("dzb100")
REQUESTS = [v for v in VECTORS.values() if v.direction == "request"]
REPLIES = [v for v in VECTORS.values() if v.direction == "response"]
CODEC = Dzb100Codec()
RUN = dzb100.Dzb100Control(1, Dzb100Command.FORWARD, 0x64)

addresses = st.integers(1, 31)
words = st.integers(0, 0xFFFF)
moving = st.sampled_from([c for c in Dzb100Command if not c.is_stop and c is not Dzb100Command.RESET])
requests = st.one_of(
    st.builds(dzb100.Dzb100Control, addresses, moving, words),
    st.builds(
        dzb100.Dzb100Control,
        addresses,
        st.sampled_from([Dzb100Command.STOP, Dzb100Command.STOP_2, Dzb100Command.RESET]),
    ),
    st.builds(dzb100.Dzb100Control, st.just(0), moving, words, st.just(True)),
    st.builds(dzb100.Dzb100WriteParameter, addresses, st.integers(0, 80), words),
    st.builds(dzb100.Dzb100ReadParameter, addresses, st.integers(0, 80)),
    st.builds(dzb100.Dzb100Query, addresses, st.integers(0, 3)),
)


def request_of(reply: Vector) -> dzb100.Dzb100Request:
    if reply.request:
        return CODEC.decode_request(reply.request.data).message
    address = reply.fields["address"]
    return (
        dzb100.Dzb100Query(address, 3) if reply.fields["head"] == "Q" else dzb100.Dzb100WriteParameter(address, 99, 5)
    )


def fields_of(message: Any) -> dict[str, Any]:
    head = message.head if isinstance(message.head, str) else chr(message.head)
    word = dzb100.StateWord.parse(message.data) if head == "Q" else None
    return {
        "head": head,
        "address": message.address,
        "data": message.data,
        "broadcast": getattr(message, "broadcast", False),
        "accepted": getattr(message, "accepted", None),
        {"C": "command", "Q": "item"}.get(head, "parameter"): message.index,
        **({"command": word.command, "state": word.state, "fault_code": word.fault_code} if word else {}),
    }


def stated(vector: Vector) -> dict[str, Any]:
    return {name: value for name, value in vector.fields.items() if name not in ("value", "frequency_hz")}


@pytest.mark.parametrize("vector", REQUESTS, ids=repr)
def test_a_station_decodes_every_request(vector: Vector) -> None:
    verdict = CODEC.decode_request(vector.data)
    assert verdict.size == 11
    assert stated(vector).items() <= fields_of(verdict.message).items()
    assert CODEC.encode_request(verdict.message) == vector.correct


@pytest.mark.parametrize("vector", REPLIES, ids=repr)
def test_a_reply_is_read_against_its_request(vector: Vector) -> None:
    verdict = CODEC.decode_reply(request_of(vector), vector.data)
    assert stated(vector).items() <= fields_of(verdict.message).items()
    assert CODEC.encode_reply(verdict.message) == vector.correct


@given(requests)
def test_every_request_comes_back(request: dzb100.Dzb100Request) -> None:
    frame = CODEC.encode_request(request)
    assert CODEC.decode_request(frame) == Complete(request, 11)
    assert frame[1] == 3


@given(requests, words, st.booleans())
def test_every_answer_comes_back_against_its_request(request: dzb100.Dzb100Request, word: int, accepted: bool) -> None:
    """Done echoes what was sent; a read answers its own data; refused may carry any."""
    echoes = isinstance(request, dzb100.Dzb100Control | dzb100.Dzb100WriteParameter) and accepted
    reply = dzb100.Dzb100Reply(
        head=chr(request.head),
        address=request.address,
        index=request.index,
        data=request.data if echoes else word,
        accepted=accepted,
    )
    frame = CODEC.encode_reply(reply)
    if request.address == 0:  # a broadcast has no reply
        with pytest.raises(AddressError):
            CODEC.decode_reply(request, frame)
    else:
        assert CODEC.decode_reply(request, frame) == Complete(reply, 11)


@given(st.sampled_from(range(9)))
def test_a_state_digit_comes_back(digit: int) -> None:
    reply = dzb100.Dzb100Reply(head="C", address=1, index=1, data=0x64, accepted=None, digit=digit)
    assert CODEC.decode_reply(RUN, CODEC.encode_reply(reply)) == Complete(reply, 11)


@pytest.mark.parametrize("vector", VECTORS.values(), ids=repr)
def test_byte_by_byte_is_the_same_as_whole_and_a_frame_ends_at_eleven_bytes(vector: Vector) -> None:
    def decode(data: bytes) -> Any:
        if vector.direction == "request":
            return CODEC.decode_request(data)
        return CODEC.decode_reply(request_of(vector), data)

    assert [decode(vector.data[:end]) for end in range(11)] == [Incomplete(11)] * 11
    assert decode(vector.data + b"C\x03") == decode(vector.data)


@pytest.mark.parametrize("command", [Dzb100Command.STOP, Dzb100Command.STOP_2])
@given(data=words, everyone=st.booleans())
def test_a_stop_leaves_with_0000_whatever_it_is_given(command: Dzb100Command, data: int, everyone: bool) -> None:
    frame = CODEC.encode_request(dzb100.Dzb100Control(0 if everyone else 9, command, data, everyone))
    assert frame[7:] == b"0000"
    assert dzb100.frame_effect(frame) is Effect.STOP


@pytest.mark.parametrize("command", [Dzb100Command.STOP, Dzb100Command.STOP_2])
def test_a_single_flip_of_a_stop_that_a_drive_obeys_as_a_run_runs_at_zero(command: Dzb100Command) -> None:
    frame = CODEC.encode_request(dzb100.Dzb100Control(1, command))
    runs = [
        received
        for received in map(decode_or_none, flips(frame))
        if isinstance(received, dzb100.Dzb100Control)
        and not received.command.is_stop
        and received.command is not Dzb100Command.RESET
    ]
    assert {received.data for received in runs} == {0}
    assert len(runs) == {Dzb100Command.STOP: 2, Dzb100Command.STOP_2: 2}[command]


def flips(frame: bytes) -> list[bytes]:
    number = int.from_bytes(frame, "big")
    return [(number ^ 1 << bit).to_bytes(len(frame), "big") for bit in range(8 * len(frame))]


def decode_or_none(frame: bytes) -> Any:
    try:
        return CODEC.decode_request(frame).message
    except ProtocolError:
        return None


@given(addresses, st.integers(0, 80))
def test_a_parameter_is_read_with_r_never_with_p(address: int, parameter: int) -> None:
    frame = CODEC.encode_request(dzb100.Dzb100ReadParameter(address, parameter))
    assert frame[:1] == b"R"
    assert frame[7:] == b"0000"
    assert dzb100.frame_effect(frame) is Effect.NONE


def test_the_manuals_seven_byte_p_read_is_the_beginning_of_a_write_never_a_read() -> None:
    read = b"P\x03\x010323"
    assert CODEC.decode_request(read) == Incomplete(11)
    assert CODEC.decode_request(read + b"0000").message == dzb100.Dzb100WriteParameter(3, 23, 0)
    assert dzb100.frame_effect(read + b"0000") is Effect.SETTING
    assert dzb100.frame_effect(read) is Effect.MOTION


@pytest.mark.parametrize(
    "request_",
    [
        dzb100.Dzb100Control(0, Dzb100Command.STOP),
        dzb100.Dzb100Control(3, Dzb100Command.STOP, broadcast=True),
        dzb100.Dzb100WriteParameter(0, 10, 1),
        dzb100.Dzb100ReadParameter(0, 10),
        dzb100.Dzb100Query(0, 3),
        dzb100.Dzb100Control(32, Dzb100Command.FORWARD),
        dzb100.Dzb100ReadParameter(1, 81),
        dzb100.Dzb100Query(1, 4),
        dzb100.Dzb100WriteParameter(1, 10, 0x10000),
        dzb100.Dzb100Control(1, Dzb100Command.RESET, 100),
        dzb100.Dzb100Control(1, 9),  # type: ignore[arg-type]
    ],
    ids=repr,
)
def test_what_no_drive_can_answer_or_obey_is_not_emitted(request_: dzb100.Dzb100Request) -> None:
    with pytest.raises(ValueError, match=r"expected|takes no|does not fit"):
        CODEC.encode_request(request_)


@pytest.mark.parametrize(
    "reply",
    [
        dzb100.Dzb100Reply(head="X", address=1, index=1, data=0, accepted=True),
        dzb100.Dzb100Reply(head="P", address=1, index=1, data=0, accepted=None, digit=1),
        dzb100.Dzb100Reply(head="C", address=1, index=1, data=0, accepted=None, digit=9),
    ],
    ids=repr,
)
def test_a_reply_that_is_no_reply_is_not_emitted(reply: dzb100.Dzb100Reply) -> None:
    with pytest.raises(ValueError, match=r"expected C|0 to 8"):
        CODEC.encode_reply(reply)


@pytest.mark.parametrize("address", [32, 64, 99])
def test_no_station_has_an_address_above_31(address: int) -> None:
    with pytest.raises(AddressError) as caught:
        CODEC.decode_request(b"C\x03\x01%02d000000" % address)
    assert (caught.value.expected, caught.value.found) == (31, address)


def test_the_echo_of_a_c_request_reads_as_a_state_digit_and_never_as_done() -> None:
    """A 01 reads as B = X1: position and time tell them apart, and neither counts as accepted or refused."""
    reply = CODEC.decode_reply(RUN, CODEC.encode_request(RUN)).message  # type: ignore[union-attr]
    assert (reply.accepted, reply.digit) == (None, 1)


@pytest.mark.parametrize(
    "request_", [dzb100.Dzb100WriteParameter(1, 10, 5), dzb100.Dzb100ReadParameter(1, 10), dzb100.Dzb100Query(1, 3)]
)
def test_the_echo_of_any_other_request_is_no_reply(request_: dzb100.Dzb100Request) -> None:
    with pytest.raises(CodeError):
        CODEC.decode_reply(request_, CODEC.encode_request(request_))


def test_a_command_digit_that_is_not_listed_is_rejected() -> None:
    with pytest.raises(CodeError) as caught:
        CODEC.decode_request(b"C\x03\x0101090000")
    assert (caught.value.expected, caught.value.found) == ("0-8", 9)
    assert (
        CODEC.decode_request(b"C\x03\x0101380000").message.command is Dzb100Command.RESET
    )  # the high digit is undefined


@given(requests)
def test_a_request_has_the_address_of_its_station(request: dzb100.Dzb100Request) -> None:
    assert CODEC.address_of(request) == request.address


def test_only_commands_can_be_broadcast() -> None:
    with pytest.raises(CodeError) as caught:
        CODEC.decode_request(b"P\x03\x0200100000")
    assert caught.value.found == 2
    assert CODEC.decode_request(b"C\x03\x0200000000").message.broadcast
    assert CODEC.reply_size(dzb100.Dzb100Control(0, Dzb100Command.STOP, broadcast=True)) == 0
    assert CODEC.reply_size(dzb100.Dzb100Query(1, 0)) == CODEC.largest_reply(dzb100.Dzb100Query(1, 0)) == 11


@pytest.mark.parametrize(("mark", "digit"), [(0x01, 1), (0x31, 1), (0x36, 6), (0x38, 8), (0x00, 0)])
def test_a_state_digit_in_a_control_reply_is_neither_yes_nor_no(mark: int, digit: int) -> None:
    reply = CODEC.decode_reply(RUN, b"C\x03" + bytes((mark,)) + b"01010064").message
    assert (reply.accepted, reply.digit) == (None, digit)


def test_06_and_07_are_done_and_rejected_although_the_text_lists_them_as_digits() -> None:
    assert CODEC.decode_reply(RUN, b"C\x03\x0601010064").message.accepted is True
    assert CODEC.decode_reply(RUN, b"C\x03\x0701010000").message.accepted is False


@pytest.mark.parametrize("head", ["P", "R", "Q"])
def test_only_a_control_reply_has_a_state_digit(head: str) -> None:
    request = {
        "P": dzb100.Dzb100WriteParameter(1, 1, 0x64),
        "R": dzb100.Dzb100ReadParameter(1, 1),
        "Q": dzb100.Dzb100Query(1, 1),
    }[head]
    with pytest.raises(CodeError) as caught:
        CODEC.decode_reply(request, head.encode() + b"\x03\x3101010064")
    assert caught.value.found == 0x31


@pytest.mark.parametrize(
    ("frame", "error", "expected", "found"),
    [
        (b"X\x03\x0601010064", HeaderError, ("C", "P", "R", "Q"), 0x58),
        (b"Q\x03\x0601010064", EchoError, "C", "Q"),
        (b"C\x02\x0601010064", ChecksumError, 3, 2),
        (b"C\x03\x0501010064", None, None, None),
        (b"C\x03\x0901010064", CodeError, ("06", "07"), 9),
        (b"C\x03\x0602010064", AddressError, 1, 2),
        (b"C\x03\x0600010064", AddressError, 31, 0),
        (b"C\x03\x0601030064", EchoError, 1, 3),
        (b"C\x03\x0601010065", EchoError, 0x64, 0x65),
        (b"C\x03\x060101006a", AlphabetError, "0-9 A-F", 0x61),
        (b"C\x03\x060A010064", AlphabetError, "0-9", 0x41),
    ],
)
def test_a_reply_must_fit_its_request_in_every_byte(frame: bytes, error: Any, expected: Any, found: Any) -> None:
    if error is None:
        assert CODEC.decode_reply(RUN, frame).message.digit == 5
        return
    with pytest.raises(error) as caught:
        CODEC.decode_reply(RUN, frame)
    assert (caught.value.expected, caught.value.found) == (expected, found)
    assert caught.value.text("en") != caught.value.key
    assert caught.value.text("zh") not in (caught.value.key, caught.value.text("en"))


def test_another_stations_whole_reply_can_be_dropped_by_its_size() -> None:
    with pytest.raises(AddressError) as caught:
        CODEC.decode_reply(RUN, b"C\x03\x0602010064")
    assert caught.value.size == 11


@pytest.mark.parametrize("vector", REPLIES, ids=repr)
def test_every_byte_value_in_every_position_raises_nothing_but_protocol_errors(vector: Vector) -> None:
    """And what passes differs only in B of a control reply, or in data that no request foretells."""
    request, frame = request_of(vector), bytearray(vector.data)
    free = range(7, 11) if vector.fields["head"] in "RQ" or vector.fields["accepted"] is False else range(0)
    for position, original in enumerate(vector.data):
        for byte in set(range(256)) - {original}:
            frame[position] = byte
            try:
                verdict = CODEC.decode_reply(request, bytes(frame))
            except ProtocolError:
                continue
            assert position in free or position == 2, verdict
        frame[position] = original


@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("dzb100-1-response", 3),  # B: 06 as 07, 02, 04
        ("dzb100-2-response", 1),  # B: 06 as 07
        ("dzb100-3-response", 1 + 4 + 4 + 3 + 3),  # B, and the digits 0, 0, 6, 4 that stay digits
    ],
)
def test_the_single_flips_that_a_host_cannot_see_are_these_of_88(name: str, count: int) -> None:
    vector = VECTORS[name]

    def passes(frame: bytes) -> bool:
        try:
            return isinstance(CODEC.decode_reply(request_of(vector), frame), Complete)
        except ProtocolError:
            return False

    assert sum(map(passes, flips(vector.data))) == count


def test_random_bytes_raise_nothing_but_protocol_errors() -> None:
    chance = random.Random(100)
    asked = [RUN, dzb100.Dzb100WriteParameter(2, 10, 150), dzb100.Dzb100ReadParameter(3, 23), dzb100.Dzb100Query(7, 3)]
    for _ in range(20_000):
        start = chance.choice((b"", b"C\x03", b"P\x03\x06", b"Q\x03\x0607"))
        rest = bytes(chance.choice(b"0123456789ABCDEF") for _ in range(9)) if chance.random() < 0.5 else b""
        data = start + (rest or chance.randbytes(chance.randrange(12)))
        for decode in (CODEC.decode_request, lambda d: CODEC.decode_reply(chance.choice(asked), d)):
            try:
                decode(data)
            except ProtocolError as error:
                assert str(error) != error.key
        dzb100.frame_effect(data)


# -- values --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("coding", "word"), [("hex-0.1", 0x007B), ("hex-0.01", 0x04CE), ("decimal-0.1", 0x0123), ("hex-1", 0x000C)]
)
def test_one_frequency_reads_as_four_words(coding: dzb100.FrequencyCoding, word: int) -> None:
    assert dzb100.encode_frequency(12.3, coding) == word
    assert dzb100.decode_frequency(word, coding) == (12.0 if coding == "hex-1" else 12.3)


def test_the_manuals_example_is_ten_times_too_fast_under_the_default_coding() -> None:
    word = VECTORS["dzb100-1-request"].fields["data"]
    assert dzb100.decode_frequency(word, "hex-0.1") == 100.0
    assert dzb100.decode_frequency(word, "hex-0.01") == 10.0


@given(st.sampled_from(dzb100.FREQUENCY_CODINGS), st.integers(0, 9999))
def test_every_step_of_a_coding_comes_back(coding: dzb100.FrequencyCoding, step: int) -> None:
    hz = step / {"hex-0.1": 10, "hex-0.01": 100, "decimal-0.1": 10, "hex-1": 1}[coding]
    assert dzb100.decode_frequency(dzb100.encode_frequency(hz, coding), coding) == hz


@pytest.mark.parametrize("hz", [-0.1, 65536.0, math.nan, math.inf])
@pytest.mark.parametrize("coding", dzb100.FREQUENCY_CODINGS)
def test_a_frequency_that_is_no_word_is_rejected(hz: float, coding: dzb100.FrequencyCoding) -> None:
    with pytest.raises(ValueError, match="does not fit"):
        dzb100.encode_frequency(hz, coding)


def test_a_decimal_frequency_has_four_digits() -> None:
    """Above 999.9 Hz the word would be five digits long, and 1000.0 Hz would leave as 0000."""
    assert dzb100.encode_frequency(999.9, "decimal-0.1") == 0x9999
    with pytest.raises(ValueError, match="does not fit"):
        dzb100.encode_frequency(1000.0, "decimal-0.1")


def test_a_word_with_letters_is_no_decimal_frequency() -> None:
    with pytest.raises(ValueError, match="007B"):
        dzb100.decode_frequency(0x007B, "decimal-0.1")


def test_the_state_word_names_command_state_bits_and_fault() -> None:
    assert dzb100.StateWord.parse(0x0201) == dzb100.StateWord(command=0, state=2, fault_code=1)
    assert dzb100.StateWord.parse(0x1F14) == dzb100.StateWord(command=1, state=15, fault_code=14)
    assert dzb100.StateWord.parse(0x1F14, "hex") == dzb100.StateWord(command=1, state=15, fault_code=20)


@pytest.mark.parametrize(
    ("word", "coding", "found"),
    [(0x9000, "decimal", 9), (0x000A, "decimal", "0A"), (0x21, "decimal", 21), (21, "hex", 21)],
)
def test_a_state_word_with_an_unlisted_digit_is_rejected(
    word: int, coding: dzb100.FaultCoding, found: int | str
) -> None:
    with pytest.raises(CodeError) as caught:
        dzb100.StateWord.parse(word, coding)
    assert caught.value.found == found
    assert caught.value.text("zh") != caught.value.key


@given(st.builds(dzb100.StateWord, st.integers(0, 8), st.integers(0, 15), st.integers(0, 20)))
def test_a_state_word_comes_back(word: dzb100.StateWord) -> None:
    assert dzb100.StateWord.parse(word.encode("decimal"), "decimal") == word
    assert word.encode() == word.encode("decimal")
    assert dzb100.StateWord.parse(word.encode("hex"), "hex") == word


# -- effects -------------------------------------------------------------------------------------------------------


@given(requests)
def test_the_effect_of_a_request_is_read_from_its_bytes(request: dzb100.Dzb100Request) -> None:
    found = dzb100.frame_effect(CODEC.encode_request(request))
    if isinstance(request, dzb100.Dzb100Control):
        setting = Effect.SETTING if request.command is Dzb100Command.RESET else Effect.MOTION
        assert found is (Effect.STOP if request.command.is_stop else setting)
    else:
        assert found is (Effect.SETTING if isinstance(request, dzb100.Dzb100WriteParameter) else Effect.NONE)


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        b"C",
        b"C\x03\x0101000064",
        b"C\x03\x0101100000",
        b"C\x03\x0101000000\r",
        b"C\x04\x0101000000",
        b"Q\x03\x0100000000",
    ],
    ids=["nothing", "cut", "stop with a frequency", "odd command digit", "trailing", "bad S", "query of everybody"],
)
def test_what_is_not_one_canonical_frame_counts_as_motion(frame: bytes) -> None:
    assert dzb100.frame_effect(frame) is Effect.MOTION


@pytest.mark.parametrize(
    ("word", "coding", "key", "expected", "found"),
    [
        (0x9000, "decimal", "protocols.dzb100.command_digit", 8, 9),
        (0x101F, "decimal", "protocols.dzb100.fault_digits", "00-20", "1F"),
        (0x1021, "decimal", "protocols.dzb100.fault_code", 20, 21),
        (0x1015, "hex", "protocols.dzb100.fault_code", 20, 21),
    ],
)
def test_a_state_word_is_rejected_with_both_numbers(
    word: int, coding: dzb100.FaultCoding, key: str, expected: object, found: object
) -> None:
    with pytest.raises(CodeError) as caught:
        dzb100.StateWord.parse(word, coding)
    assert (caught.value.key, caught.value.expected, caught.value.found) == (key, expected, found)


def test_the_last_word_of_a_coding_is_a_frequency() -> None:
    assert dzb100.encode_frequency(65535.0, "hex-1") == 0xFFFF
    assert dzb100.encode_frequency(999.9, "decimal-0.1") == 0x9999
    assert dzb100.StateWord.parse(0x8F20) == dzb100.StateWord(8, 15, 20)


LAST: list[dzb100.Dzb100Request] = [
    *(dzb100.Dzb100Query(address, 0) for address in (1, 31)),
    *(dzb100.Dzb100Query(1, item) for item in (0, 3)),
    *(dzb100.Dzb100ReadParameter(1, parameter) for parameter in (0, 80)),
    *(dzb100.Dzb100WriteParameter(31, 80, word) for word in (0, 0xFFFF)),
    dzb100.Dzb100Control(31, Dzb100Command.FORWARD, 0xFFFF),
    dzb100.Dzb100Control(0, Dzb100Command.STOP, broadcast=True),
]


@pytest.mark.parametrize("asked", LAST, ids=str)
def test_the_last_valid_value_of_every_field_is_sent_and_answered(asked: dzb100.Dzb100Request) -> None:
    frame = CODEC.encode_request(asked)
    assert CODEC.decode_request(frame) == Complete(asked, 11)
    if asked.address:
        reply = dzb100.Dzb100Reply(
            head=chr(asked.head), address=asked.address, index=asked.index, data=asked.data, accepted=True
        )
        assert CODEC.decode_reply(asked, CODEC.encode_reply(reply)) == Complete(reply, 11)


NAMED = [
    (dzb100.Dzb100Query(0, 0), "address 0: expected 1 to 31"),
    (dzb100.Dzb100Query(32, 0), "address 32: expected 1 to 31"),
    (dzb100.Dzb100Control(1, Dzb100Command.STOP, broadcast=True), "address 1: expected 0 to 0"),
    (dzb100.Dzb100Query(1, 4), "item 4: expected 0 to 3"),
    (dzb100.Dzb100Query(1, -1), "item -1: expected 0 to 3"),
    (dzb100.Dzb100ReadParameter(1, 81), "parameter 81: expected 0 to 80"),
    (dzb100.Dzb100WriteParameter(1, -1, 0), "parameter -1: expected 0 to 80"),
]


@pytest.mark.parametrize(("wrong", "sentence"), NAMED, ids=str)
def test_a_field_out_of_range_is_named_with_its_limits(wrong: dzb100.Dzb100Request, sentence: str) -> None:
    with pytest.raises(ValueError, match=f"^{sentence}$"):
        CODEC.encode_request(wrong)


UNHEARD = [
    (b"Q\x03\x013200000000", AddressError, "protocols.dzb100.address_range", 31, 32, None),
    (b"Q\x03\x020100000000", CodeError, "protocols.dzb100.mark", ("01", "02"), 2, None),
    (b"C\x03\x030101000000", CodeError, "protocols.dzb100.mark", ("01", "02"), 3, None),
    (b"C\x03\x010119000000", CodeError, "protocols.dzb100.command", "0-8", 9, None),
    (b"Q\x03\x010A00000000", AlphabetError, "protocols.alphabet", "0-9", ord("A"), 4),
    (b"Q\x03\x0101x0000000", AlphabetError, "protocols.alphabet", "0-9", ord("x"), 5),
    (b"Q\x03\x01010000a000", AlphabetError, "protocols.alphabet", "0-9 A-F", ord("a"), 9),
    (b"C\x04", ChecksumError, "protocols.dzb100.checksum", 3, 4, None),
    (b"X", HeaderError, "protocols.dzb100.header", ("C", "P", "R", "Q"), ord("X"), None),
]


@pytest.mark.parametrize(("frame", "kind", "key", "expected", "found", "position"), UNHEARD, ids=repr)
def test_a_station_rejects_a_frame_with_both_numbers_and_the_place(
    frame: bytes, kind: type[ProtocolError], key: str, expected: object, found: object, position: int | None
) -> None:
    """Its first bytes alone are refused at once: no later byte can make them valid."""
    with pytest.raises(kind) as caught:
        CODEC.decode_request(frame)
    error = caught.value
    assert (error.key, error.expected, error.found, error.params.get("position")) == (key, expected, found, position)


@pytest.mark.parametrize("address", [0, 1, 31, 32])
def test_a_reply_comes_from_one_of_31_drives(address: int) -> None:
    frame = b"Q\x03\x06%02d000000" % address
    asked = dzb100.Dzb100Query(address, 0)
    if 1 <= address <= 31:
        assert CODEC.decode_reply(asked, frame).size == 11
        return
    with pytest.raises(AddressError) as caught:
        CODEC.decode_reply(asked, frame)
    assert (caught.value.key, caught.value.expected) == ("protocols.dzb100.address_range", 31)


@pytest.mark.parametrize("digit", [None, -1, 9])
def test_a_state_digit_is_one_of_nine(digit: int | None) -> None:
    with pytest.raises(ValueError, match="only a C reply has one, 0 to 8"):
        CODEC.encode_reply(dzb100.Dzb100Reply(head="C", address=1, index=0, data=0, accepted=None, digit=digit))
    for valid in (0, 8):
        assert (
            CODEC.encode_reply(dzb100.Dzb100Reply(head="C", address=1, index=0, data=0, accepted=None, digit=valid))[2]
            == ord("0") + valid
        )


def test_only_a_broadcast_has_the_mark_of_one() -> None:
    """A read with 02 in byte 2 addresses no single drive."""
    for head in b"PRQ":
        with pytest.raises(CodeError):
            CODEC.decode_request(bytes((head, 3, 2)) + b"00010000")
    assert CODEC.decode_request(b"C\x03\x0200010000").message == dzb100.Dzb100Control(
        0, Dzb100Command.FORWARD, 0, broadcast=True
    )


FIELDS: list[tuple[bytes, str | None, dict[str, Any]]] = [
    (
        b"C\x03\x01031100C8",
        None,
        {"broadcast": False, "address": 3, "command": 1, "command_name": "forward", "data": 200, "frequency_hz": 20.0},
    ),
    (
        b"C\x03\x020005FFFF",
        None,
        {
            "broadcast": True,
            "address": 0,
            "command": 5,
            "command_name": "jog_forward",
            "data": 65535,
            "frequency_hz": 6553.5,
        },
    ),
    (b"C\x03\x0103020000", None, {"broadcast": False, "address": 3, "command": 2, "command_name": "stop", "data": 0}),
    (b"C\x03\x0103080000", None, {"broadcast": False, "address": 3, "command": 8, "command_name": "reset", "data": 0}),
    (b"C\x03\x0103190064", "request", {"broadcast": False, "address": 3, "command": 9, "data": 100}),
    (b"C\x03\x0503020000", "request", {"address": 3, "command": 2, "command_name": "stop", "data": 0}),
    (
        b"C\x03\x0603010064",
        None,
        {"accepted": True, "address": 3, "command": 1, "command_name": "forward", "data": 100, "frequency_hz": 10.0},
    ),
    (
        b"C\x03\x3503010064",
        None,
        {
            "accepted": None,
            "digit": 5,
            "address": 3,
            "command": 1,
            "command_name": "forward",
            "data": 100,
            "frequency_hz": 10.0,
        },
    ),
    (b"P\x03\x0103070005", None, {"address": 3, "parameter": 7, "data": 5}),
    (b"P\x03\x0703070005", None, {"accepted": False, "address": 3, "parameter": 7, "data": 5}),
    (b"R\x03\x0103070000", None, {"address": 3, "parameter": 7}),
    (b"R\x03\x0603070005", None, {"accepted": True, "address": 3, "parameter": 7, "data": 5}),
    (b"Q\x03\x0103010000", None, {"address": 3, "item": 1}),
    (b"Q\x03\x06030001F4", None, {"accepted": True, "address": 3, "item": 0, "data": 500, "frequency_hz": 50.0}),
    (b"Q\x03\x06030101F4", None, {"accepted": True, "address": 3, "item": 1, "data": 500, "frequency_hz": 50.0}),
    (b"Q\x03\x06030201F4", None, {"accepted": True, "address": 3, "item": 2, "data": 500}),
    (
        b"Q\x03\x0603031212",
        None,
        {"accepted": True, "address": 3, "item": 3, "data": 0x1212, "command": 1, "state": 2, "fault_code": 12},
    ),
    (b"Q\x03\x060303121F", None, {"accepted": True, "address": 3, "item": 3, "data": 0x121F}),
    (b"Q\x03\x06030\xff0000", None, {}),
    (b"Q\x03\x0603", None, {}),
]


@pytest.mark.parametrize(("frame", "direction", "fields"), FIELDS, ids=repr)
def test_a_frame_is_shown_with_these_fields_and_no_others(frame: bytes, direction: Any, fields: dict[str, Any]) -> None:
    assert dict(dzb100.describe(frame, direction=direction).fields) == {"head": chr(frame[0])} | fields


def test_what_is_no_frame_at_all_is_shown_with_nothing() -> None:
    for data in (b"", b"X\x03\x0103010000"):
        found = dzb100.describe(data)
        assert (dict(found.fields), found.valid, found.canonical) == ({}, False, None)


def test_the_direction_is_the_given_one_else_byte_2_decides() -> None:
    control = b"C\x03\x0103010064"
    assert dzb100.describe(control, direction="response").direction == "response"
    assert dzb100.describe(control, request=control).direction == "response"
    assert dzb100.describe(control).direction == "request"
    assert dzb100.describe(b"C\x03\x0203010064").direction == "request"
    assert dzb100.describe(b"C\x03\x0303010064").direction == "response"


def test_a_control_request_may_also_be_a_reply_with_a_state_digit() -> None:
    """Only without a given direction, and only for a complete frame that a drive could have sent."""
    control = b"C\x03\x0103010064"
    (reading,) = dzb100.describe(control).interpretations
    assert reading.note == ("protocols.dzb100.reading.state_digit", {"digit": 1})
    assert dict(reading.fields) == {"accepted": None, "digit": 1}
    for data, options in (
        (control, {"direction": "request"}),
        (control, {"direction": "response"}),
        (b"C\x03\x01031900C8", {}),
        (b"C\x03\x0200010064", {}),
        (b"Q\x03\x0103010000", {}),
    ):
        assert dzb100.describe(data, **options).interpretations == (), data  # type: ignore[arg-type]


def test_a_state_word_that_can_not_be_is_a_problem_of_a_done_answer_to_q03_only() -> None:
    for frame, key in (
        (b"Q\x03\x060303121F", "protocols.dzb100.fault_digits"),
        (b"Q\x03\x070303121F", None),
        (b"Q\x03\x060302121F", None),
        (b"R\x03\x060303121F", None),
    ):
        found = dzb100.describe(frame)
        assert [name for name, _ in found.problems] == [key][: key is not None], frame
        assert found.canonical == (None if key else frame)
    assert dzb100.describe(b"Q\x03\x010303121F").valid, "a request has no state"


def test_a_reply_is_described_against_a_whole_request() -> None:
    reply, asked = b"Q\x03\x06030001F4", b"Q\x03\x0103000000"
    assert dzb100.describe(reply, request=asked).valid
    assert [key for key, _ in dzb100.describe(reply, request=asked + b"0").problems] == ["protocols.trailing"]
    assert [key for key, _ in dzb100.describe(reply, request=asked[:-1]).problems] == ["protocols.length"]
    assert [key for key, _ in dzb100.describe(reply + b"0", request=asked).problems] == ["protocols.trailing"]


def test_a_reset_of_another_sender_with_a_frequency_raises_nothing_in_its_reply() -> None:
    """We never send one, but a recording may hold it."""
    asked, reply = b"C\x03\x0101089000", b"C\x03\x0601089000"
    assert dzb100.describe(reply, request=asked).valid
    assert CODEC.decode_reply(CODEC.decode_request(asked).message, reply).message.accepted
    found = dzb100.describe(b"C\x03\x0601080000", request=asked)
    assert [key for key, _ in found.problems] == ["protocols.dzb100.data"]


def test_only_a_setpoint_above_the_mains_frequency_deserves_a_second_look() -> None:
    at, above = b"C\x03\x01010101F4", b"C\x03\x01010101F5"
    assert dzb100.describe(at).fields["frequency_hz"] == 50.0 and dzb100.describe(at).hazards == ()
    assert [key for key, _ in dzb100.describe(above).hazards] == ["protocols.dzb100.hazard.tenfold"]


def test_a_codec_names_its_family_and_encoding() -> None:
    assert (CODEC.family, CODEC.encoding, CODEC.broadcast_address) == ("dzb100", "ascii", 0)


def test_each_command_has_the_digit_of_the_manual() -> None:
    """MM: one moved digit and a stop is a run."""
    named = ["STOP", "FORWARD", "STOP_2", "REVERSE", "JOG_FORWARD", "JOG_FORWARD_2", "JOG_REVERSE", "JOG_REVERSE_2"]
    assert {name: int(command) for name, command in Dzb100Command.__members__.items()} == {
        **{name: digit for digit, name in enumerate(named)},
        "RESET": 8,
    }


@pytest.mark.parametrize(
    ("frame", "errata"),
    [
        (b"C\x03\x0101000100", ["data 0100H: a correct sender writes 0000 in a stop or reset"]),
        (b"C\x03\x0101810064", ["command 81: the manual has X0 to X8, and a correct sender writes 00 to 08"]),
        (b"C\x03\x0201010064", ["a broadcast (A = 02) to address 01: a correct sender writes 00"]),
        (
            b"C\x03\x0100010064",
            ["address 00 without A = 02: only a broadcast has it, and a correct sender writes 01 to 31"],
        ),
        (b"R\x03\x0101100258", ["data 0258H: a correct sender writes 0000 in a read"]),
    ],
)
def test_what_a_correct_sender_writes_otherwise_is_named_and_nothing_else(frame: bytes, errata: list[str]) -> None:
    """The same sentence with four reasons stood for each of them, and for others."""
    found = dzb100.describe(frame)
    assert [i18n.text(key, "en", **params) for key, params in found.errata] == errata


@given(
    head=st.sampled_from([b"C", b"P", b"R", b"Q"]),
    mark=st.sampled_from([b"\x01", b"\x02"]),
    address=st.integers(0, 31),
    index=st.integers(0, 99),
    word=st.sampled_from([0, 0x64]),
)
def test_every_frame_that_a_correct_sender_writes_otherwise_has_a_reason(
    head: bytes, mark: bytes, address: int, index: int, word: int
) -> None:
    frame = head + b"\x03" + mark + b"%02d%02d%04X" % (address, index, word)
    found = dzb100.describe(frame, direction="request")
    assert not found.valid or (found.canonical != frame) == bool(found.errata)
