"""``describe`` names the fields of the golden frames and never raises."""

from __future__ import annotations

import random
from types import ModuleType
from typing import Any

import pytest

from drivebus import i18n
from drivebus.protocols import dzb100, sunfar
from drivebus.protocols.checksum import STRICT_HEX_DIGITS
from drivebus.protocols.describe import FrameDescription
from drivebus.protocols.sunfar.frame import CONTROL_LAYOUT, READ_LAYOUT, WRITE_LAYOUT, AsciiFormat
from drivebus.values import Text
from fixtures.vectors import Vector, vectors_by_id

C320, DZB100 = vectors_by_id("c320"), vectors_by_id("dzb100")
VECTORS = [*C320.values(), *DZB100.values()]
ASCII = AsciiFormat(STRICT_HEX_DIGITS)
MODULES: dict[str, ModuleType] = {"sunfar": sunfar, "dzb100": dzb100}


def described(vector: Vector, **options: Any) -> FrameDescription:
    request = vector.request.data if vector.request else None
    found = MODULES[vector.family].describe(vector.data, request=request, **options)
    assert isinstance(found, FrameDescription)
    return found


def sentences(found: FrameDescription, language: str = "en") -> list[str]:
    notes = [*found.problems, *found.errata, *found.hazards, *(reading.note for reading in found.interpretations)]
    return [i18n.text(key, language, **params) for key, params in notes]


@pytest.mark.parametrize("vector", VECTORS, ids=repr)
def test_every_golden_frame_is_described_with_its_fields_and_verdict(vector: Vector) -> None:
    found = described(vector)
    assert found.problems == ()
    assert (found.valid, found.family, found.encoding) == (True, vector.family, vector.encoding)
    assert found.direction == vector.direction
    fields = {name: value for name, value in vector.fields.items() if name != "value"}  # "value" needs a profile
    assert fields.items() <= dict(found.fields).items()
    assert (bool(found.errata), bool(found.hazards)) == (vector.misprinted, vector.hazardous)


@pytest.mark.parametrize("vector", VECTORS, ids=repr)
def test_canonical_is_what_a_correct_sender_emits(vector: Vector) -> None:
    assert described(vector).canonical == vector.correct


@pytest.mark.parametrize("vector", [v for v in VECTORS if v.request], ids=repr)
def test_a_reply_without_its_request_is_valid_and_its_meanings_are_candidates(vector: Vector) -> None:
    found = MODULES[vector.family].describe(vector.data)
    assert found.valid
    assert found.direction == "response"
    if vector.model == "c320":
        message = [dict(found.fields), *({**found.fields, **reading.fields} for reading in found.interpretations)]
        assert any(vector.fields.items() <= fields.items() for fields in message)


def test_a_reply_of_group_0_may_be_the_model_or_item_40h() -> None:
    found = sunfar.describe(C320["c320-4.1-response-ascii"].data)
    assert [dict(reading.fields) for reading in found.interpretations] == [
        {"monitor": "d.64", "data": 34},
        {"parameter": "F0.64", "data": 34},
        {"info": "400022", "voltage_class": 380, "power_kw": 2.2},
    ]


def test_an_operation_in_a_read_is_reported_to_start_the_motor() -> None:
    found = described(C320["c320-4.2-request-ascii"])
    assert [key for key, _ in found.hazards] == ["protocols.sunfar.hazard.starts"]
    assert found.hazards[0][1] == {"operation": 1, "name": Text("run forward", "正转运行"), "kind": 1}
    stop = sunfar.describe(b"*001030000184\r")
    assert [key for key, _ in stop.hazards] == ["protocols.sunfar.hazard.acts"]


def test_the_ambiguous_frame_has_both_numbers() -> None:
    found = described(C320["c320-4.5-response-hex"])
    assert found.fields["data"] == 256
    assert [dict(reading.fields) for reading in found.interpretations] == [{"data": 16}]
    assert ("protocols.sunfar.erratum.ambiguous", {"packed": 256, "nibbles": 16}) in found.errata


def test_a_reply_that_may_be_an_echo_is_described_as_such() -> None:
    echo = sunfar.SunfarCodec().encode_request(sunfar.SunfarWriteParameter(5, 1, 2, 0))
    assert sunfar.describe(echo).direction == "request"
    found = sunfar.describe(echo, direction="response")
    assert found.interpretations[-1].note[0] == "protocols.sunfar.reading.echo"
    written = sunfar.SunfarCodec().encode_request(sunfar.SunfarWriteParameter(5, 1, 2, 7))
    assert [key for key, _ in sunfar.describe(written, request=written).problems] == ["protocols.sunfar.own_echo"]


def test_a_run_above_the_mains_frequency_names_every_coding() -> None:
    found = described(DZB100["dzb100-1-request"])
    key, params = found.hazards[0]
    assert key == "protocols.dzb100.hazard.tenfold"
    assert params["readings"] == ("100 (hex-0.1)", "10 (hex-0.01)", "1000 (hex-1)")
    assert (
        described(DZB100["dzb100-1-request"], options=dzb100.Dzb100DecodeOptions("hex-0.01")).fields["frequency_hz"]
        == 10.0
    )
    assert (
        described(DZB100["dzb100-1-request"], options=dzb100.Dzb100DecodeOptions(setpoint_coding_known=True)).hazards
        == ()
    )


def test_a_p_frame_with_zeros_is_reported_to_write() -> None:
    found = dzb100.describe(b"P\x03\x0103230000")
    assert [key for key, _ in found.hazards] == ["protocols.dzb100.hazard.write_of_zero"]


def test_a_stop_with_a_frequency_is_a_hazard_and_its_canonical_form_has_none() -> None:
    found = dzb100.describe(b"C\x03\x01010003E8")
    assert [key for key, _ in found.hazards] == ["protocols.dzb100.hazard.carries_frequency"]
    assert found.canonical == b"C\x03\x0101000000"


@pytest.mark.parametrize("name", ["c320-4.3-response-ascii", "c320-4.3-response-hex", "c320-4.1-response-ascii"])
def test_a_reply_with_a_stray_byte_behind_it_is_still_shown_as_a_reply(name: str) -> None:
    found = sunfar.describe(C320[name].data + b"\x00")
    assert (found.direction, found.valid) == ("response", False)
    assert [key for key, _ in found.problems] == ["protocols.trailing"]
    asked = sunfar.describe(C320["c320-4.3-request-ascii"].data + b"\x00")
    assert (asked.direction, asked.valid) == ("request", False)


def test_a_frame_that_no_drive_obeys_is_no_hazard() -> None:
    frame = C320["c320-4.1-request-ascii"].data
    assert sunfar.describe(frame).hazards != ()
    assert sunfar.describe(frame[:-2] + b"7\r").hazards == ()


def test_a_dzb100_command_may_be_a_reply_with_a_state_digit_where_the_direction_is_not_given() -> None:
    frame = DZB100["dzb100-run-10hz"].data
    (reading,) = dzb100.describe(frame).interpretations
    assert dict(reading.fields) == {"accepted": None, "digit": 1}
    assert dzb100.describe(frame, direction="request").interpretations == ()
    assert dzb100.describe(DZB100["dzb100-stop-all"].data).interpretations == ()
    assert dzb100.describe(DZB100["dzb100-2-request"].data).interpretations == ()


@pytest.mark.parametrize(
    "operation", [each for each in sunfar.SunfarOperation if each is not sunfar.SunfarOperation.NONE]
)
def test_the_hazard_names_the_operation_in_each_language(operation: sunfar.SunfarOperation) -> None:
    body = b"001%02X0" % operation + b"00"
    (hazard,) = sunfar.describe(b"*%b%04X\r" % (body, sum(body))).hazards
    english, chinese = (i18n.text(hazard[0], language, **hazard[1]) for language in i18n.LANGUAGES)
    assert f"({operation.name.lower().replace('_at', ' at a frequency').replace('_', ' ')})" in english
    assert not any(character.isalpha() and character.isascii() for character in chinese.split("（")[1].split("）")[0])


@pytest.mark.parametrize("vector", VECTORS, ids=repr)
def test_a_broken_frame_is_shown_with_its_problem(vector: Vector) -> None:
    for data in (vector.data[:-1], vector.data + b"\r", b"x" + vector.data[1:]):
        found = MODULES[vector.family].describe(data, direction=vector.direction)
        assert not found.valid
        assert len(found.problems) == 1
        assert found.canonical is None or (vector.model == "c320" and found.direction == "request")


def test_the_fields_of_a_frame_with_a_wrong_sum_are_still_shown() -> None:
    found = sunfar.describe(b"*0000100003E70261\r", request=C320["c320-4.2-request-ascii"].data)
    assert (found.valid, found.fields["frequency_hz"], found.canonical) == (False, 9.99, None)
    assert found.problems == (("protocols.checksum", {"expected": 0x260, "found": 0x261}),)


def test_what_a_host_would_never_send_has_no_canonical_form() -> None:
    read_of_everybody = ASCII.build(READ_LAYOUT, 31, 1, 0, 0, 0)
    start_with_data_that_it_cannot_have = ASCII.build(CONTROL_LAYOUT, 5, 4, 1, 999)
    for frame in (read_of_everybody, start_with_data_that_it_cannot_have):
        found = sunfar.describe(frame)
        assert (found.valid, found.canonical) == (True, None)


def test_an_ambiguous_write_shows_both_numbers_and_the_meant_frame() -> None:
    frame = sunfar.SunfarCodec("hex").encode_request(sunfar.SunfarWriteParameter(5, 2, 1, 0x0106))
    found = sunfar.describe(frame)
    assert (found.fields["data"], [dict(reading.fields) for reading in found.interpretations]) == (
        0x0106,
        [{"data": 0x16}],
    )
    assert found.canonical == sunfar.SunfarCodec("hex").encode_request(sunfar.SunfarWriteParameter(5, 2, 1, 0x16))


def test_a_reply_with_an_unlisted_state_is_not_valid_in_any_interpretation() -> None:
    found = sunfar.describe(ASCII.build(WRITE_LAYOUT, 5, 0, 0x07, 0, 1, 7))
    assert [key for key, _ in found.problems] == ["protocols.sunfar.state"]
    assert found.fields["state"] == 7


def test_a_queried_frequency_follows_the_query_coding() -> None:
    frame = b"Q\x03\x060701007B"
    assert dzb100.describe(frame).fields["frequency_hz"] == 12.3
    assert (
        dzb100.describe(frame, options=dzb100.Dzb100DecodeOptions(query_coding="hex-1")).fields["frequency_hz"] == 123.0
    )
    assert (
        "frequency_hz"
        not in dzb100.describe(frame, options=dzb100.Dzb100DecodeOptions(query_coding="decimal-0.1")).fields
    )


def test_a_state_word_that_is_rejected_is_the_problem_of_its_reply() -> None:
    found = dzb100.describe(b"Q\x03\x0607039000")
    assert [key for key, _ in found.problems] == ["protocols.dzb100.command_digit"]
    assert (found.fields["data"], "state" in found.fields) == (0x9000, False)


def test_a_wrong_request_is_the_problem_of_its_reply() -> None:
    found = sunfar.describe(C320["c320-4.2-response-ascii"].data, request=b"*00")
    assert [key for key, _ in found.problems] == ["protocols.request", "protocols.length"]


def test_the_settings_of_a_profile_give_numbers_their_meaning() -> None:
    e500 = sunfar.SunfarDecodeOptions(frequency_step_hz=0.1, frequency_monitors=(0, 6))
    asked = sunfar.SunfarCodec("hex").encode_request(sunfar.ReadMonitor(0, 6))
    found = sunfar.describe(C320["c320-sib-reply-hex"].data, request=asked, options=e500)
    assert (found.fields["monitor"], found.fields["frequency_hz"]) == ("d.6", 50.0)
    bcd = sunfar.SunfarDecodeOptions(monitor_index="bcd")
    assert sunfar.describe(b"*001000150187\r", options=bcd).fields["monitor"] == "d.15"


def test_every_sentence_stands_in_both_languages() -> None:
    for vector in VECTORS:
        found = described(vector)
        for english, chinese in zip(sentences(found), sentences(found, "zh"), strict=True):
            assert english != chinese
            assert "{" not in english + chinese


@pytest.mark.parametrize("family", ["sunfar", "dzb100"])
def test_describe_never_raises(family: str) -> None:
    chance = random.Random(8)
    known = [vector.data for vector in VECTORS if vector.family == family]
    for _ in range(6_000):
        data = bytearray(chance.choice(known))
        for _ in range(chance.randrange(4)):
            data[chance.randrange(len(data))] = chance.choice(
                (chance.randrange(256), chance.choice(b"0123456789ABCDEF"))
            )
        cut = bytes(data[: chance.randrange(len(data) + 1)] if chance.random() < 0.3 else data)
        options = {"direction": chance.choice(("request", "response", None))}
        request = chance.choice([None, chance.choice(known)])
        found = MODULES[family].describe(cut, request=request, **options)
        assert found.valid is (not found.problems)
        sentences(found)
        sentences(found, "zh")


@pytest.mark.parametrize(
    ("kind", "state", "data", "direction"),
    [
        (3, 3, 0, "response"),
        (3, 1, 0, "response"),
        (3, 0x21, 0, "response"),
        (3, 0, 0, "request"),
        (3, 7, 0, "request"),
        (3, 3, 5, "request"),
        (3, 0, 5, "request"),
        (5, 3, 0, "request"),
        (5, 0, 5, "request"),
        (0, 3, 0, "response"),
        (2, 3, 5, "response"),
    ],
)
def test_an_18_byte_frame_is_a_write_unless_it_reads_as_a_rejection(
    kind: int, state: int, data: int, direction: str
) -> None:
    assert sunfar.describe(ASCII.build(WRITE_LAYOUT, 5, kind, state, 1, 2, data)).direction == direction


def test_given_facts_of_a_frame_take_precedence_over_its_shape() -> None:
    read = ASCII.build(READ_LAYOUT, 5, 2, 0, 1, 2)
    assert sunfar.describe(read).direction == "request"
    assert sunfar.describe(read, direction="response").direction == "response"
    assert sunfar.describe(read, request=read).direction == "response"
    assert sunfar.describe(read, request=read, direction="request").direction == "request"
    assert sunfar.describe(read, "hex").problems[0] == ("protocols.header", {"expected": 0x5A, "found": 0x2A})
    assert (sunfar.describe(read).encoding, sunfar.describe(b"Z").encoding) == ("ascii", "hex")
