"""Every golden frame explained, with its request and without; and any bytes at all."""

from __future__ import annotations

import random
from typing import Any

import pytest

from drivebus import i18n, profiles
from drivebus.commissioning.decode import labels
from drivebus.commissioning.decode.describe import alternative_fields, describe_frame
from drivebus.errors import ConfigurationError, ProfileError
from drivebus.protocols import modbus
from drivebus.protocols.describe import FrameDescription
from fixtures.vectors import Vector, all_vectors, load_vectors

VECTORS = all_vectors()
MODELS = ("c320", "dzb100", "vc660", "df800", "c300", "e300", "e350", "e500", "e550")


def explained(vector: Vector, **options: Any) -> FrameDescription:
    return describe_frame(vector.model, vector.data, encoding=vector.encoding, direction=vector.direction, **options)


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector.id)
def test_a_vector_is_explained_against_its_request(vector: Vector) -> None:
    asked = vector.request
    found = explained(vector, request=asked.data if asked else None)
    assert {name: found.fields.get(name) for name in vector.fields} == vector.fields
    assert found.valid is vector.line.get("decodable", True)
    assert bool(found.problems) is not found.valid
    assert bool(found.errata) is ("erratum" in vector.line)
    assert bool(found.hazards) is ("hazard" in vector.line)
    if vector.canonical is not None:
        assert found.canonical == vector.canonical
    elif vector.plain:
        assert found.canonical == vector.data


AMBIGUOUS = [vector for vector in VECTORS if "ambiguous" in vector.line]


@pytest.mark.parametrize("vector", AMBIGUOUS, ids=lambda vector: vector.id)
def test_an_ambiguous_frame_shows_what_the_manual_meant_as_well(vector: Vector) -> None:
    found = explained(vector, request=vector.request.data if vector.request else None)
    assert alternative_fields(found) == vector.line["meant"]
    assert all(alternative_fields(explained(each)) is None for each in VECTORS if each not in AMBIGUOUS)


ANSWERS = [vector for vector in VECTORS if vector.request is not None]


@pytest.mark.parametrize("vector", ANSWERS, ids=lambda vector: vector.id)
def test_a_reply_without_its_request_is_still_read_and_lists_what_it_may_be(vector: Vector) -> None:
    found = explained(vector)
    assert found.valid is vector.line.get("decodable", True)
    assert {"address"} < set(found.fields)
    if vector.model in ("c320", "vc660", "df800") and found.valid:
        assert found.interpretations


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector.id)
def test_a_frame_needs_neither_encoding_nor_direction(vector: Vector) -> None:
    """Bytes that are both a request and its echo are called a request unless a request is given."""
    asked = vector.request
    found = describe_frame(vector.model, vector.data, request=asked.data if asked else None)
    assert found.encoding == vector.encoding
    if vector.direction == "request" or asked is not None:
        assert found.direction == vector.direction


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector.id)
def test_every_sentence_exists_in_both_languages(vector: Vector) -> None:
    found = explained(vector)
    notes = [*found.problems, *found.errata, *found.hazards, *(reading.note for reading in found.interpretations)]
    for key, params in notes:
        sentences = [i18n.text(key, language, **params) for language in ("en", "zh")]
        assert sentences[0] != sentences[1]
        assert not any("{" in sentence or key in sentence for sentence in sentences)


def keys(found: FrameDescription, kind: str) -> list[str]:
    return [key for key, _ in getattr(found, kind)]


def test_the_misprinted_read_of_vc660_shows_what_it_meant_and_stays_invalid() -> None:
    vector = next(each for each in load_vectors("vc660") if not each.line.get("decodable", True))
    found = explained(vector)
    assert not found.valid
    assert keys(found, "problems") == ["modbus.crc"]
    assert keys(found, "errata") == ["explain.misprint.vc660_c3"]
    assert found.fields["registers"] == [5000, 2, 5000, 0]


@pytest.mark.parametrize(("text", "register"), [("01 03 20 0B 00 01", 0x3001), ("01 06 20 0B 00 02", 0x2000)])
def test_register_200bh_belongs_to_no_table_of_vc660(text: str, register: int) -> None:
    from drivebus.protocols.modbus.rtu import build_frame

    found = describe_frame("vc660", build_frame(bytes.fromhex(text)))
    assert keys(found, "errata") == ["explain.no_table"]
    assert found.canonical is not None
    assert int.from_bytes(found.canonical[2:4], "big") == register


def rtu(text: str) -> bytes:
    from drivebus.protocols.modbus.rtu import build_frame

    return build_frame(bytes.fromhex(text))


@pytest.mark.parametrize("word", ["00 0C", "00 0E", "FF FF"])
def test_df800_toggle_is_a_hazard(word: str) -> None:
    found = describe_frame("df800", rtu(f"01 06 20 00 {word}"))
    assert keys(found, "hazards") == ["explain.toggle"]


@pytest.mark.parametrize("word", ["00 02", "00 06", "00 0A", "00 0B", "00 10"])
def test_an_absolute_direction_is_no_toggle(word: str) -> None:
    assert keys(describe_frame("df800", rtu(f"01 06 20 00 {word}")), "hazards") == []


@pytest.mark.parametrize(
    ("word", "hazards"),
    [(0x01F4, []), (0x01F5, ["protocols.dzb100.hazard.tenfold"]), (0x03E8, ["protocols.dzb100.hazard.tenfold"])],
)
def test_dzb100_start_above_50_hz_under_the_default_coding_is_the_tenfold_trap(word: int, hazards: list[str]) -> None:
    found = describe_frame("dzb100", b"C\x03\x010101" + b"%04X" % word)
    assert keys(found, "hazards") == hazards
    assert found.fields["frequency_hz"] == word / 10
    assert found.fields["frequency_hz_by_coding"]["hex-0.01"] == word / 100
    stop = describe_frame("dzb100", b"C\x03\x010100" + b"%04X" % word)
    assert keys(stop, "hazards") == ["protocols.dzb100.hazard.carries_frequency"]


def test_the_tenfold_trap_names_both_frequencies() -> None:
    key, params = describe_frame("dzb100", bytes.fromhex("43 03 01 30 31 30 31 30 33 45 38")).hazards[0]
    sentence = i18n.text(key, "en", **params)
    assert "100" in sentence
    assert "10 (hex-0.01)" in sentence


def test_registers_of_a_read_are_named_and_scaled() -> None:
    asked, answer = rtu("01 03 30 01 00 03"), rtu("01 03 06 13 88 0F 9E 00 80")
    found = describe_frame("vc660", answer, request=asked)
    assert found.fields["values"] == [
        {"notation": "3001H", "raw": 5000, "name": "set_frequency", "value": 50.0, "unit": "Hz"},
        {"notation": "3002H", "raw": 3998, "name": "output_frequency", "value": 39.98, "unit": "Hz"},
        {"notation": "3003H", "raw": 128, "name": "output_current", "value": 12.8, "unit": "A"},
    ]


@pytest.mark.parametrize(
    ("model", "frame", "fields"),
    [
        ("vc660", rtu("01 06 20 00 00 05"), {"commands": ["start", "reverse"]}),
        ("vc660", rtu("01 06 20 01 13 88"), {"frequency_hz": 50.0}),
        ("vc660", rtu("01 06 80 02 0B B8"), {"parameter": "F00.02", "saves": True, "frequency_hz": 30.0}),
        ("df800", rtu("01 06 20 00 00 12"), {"commands": ["start", "reset"]}),
        ("df800", rtu("01 06 00 6B 00 C8"), {"parameter": "F1.07", "scaled": "20.0 s"}),
        ("e550", bytes.fromhex("5A 00 00 04 00 11 00 00 00 64 00 00 00 79 0D"), {"frequency_hz": 10.0}),
        ("c320", bytes.fromhex("5A 00 00 04 00 11 00 00 00 64 00 00 00 79 0D"), {"frequency_hz": 1.0}),
    ],
    ids=str,
)
def test_the_profile_gives_notation_and_quantities(model: str, frame: bytes, fields: dict[str, Any]) -> None:
    found = describe_frame(model, frame)
    assert {name: found.fields.get(name) for name in fields} == fields


@pytest.mark.parametrize(
    ("frame", "key"),
    [
        (rtu("01 03 30 00 00 05"), "explain.too_many"),
        (rtu("01 10 20 00 00 01 02 00 01"), "explain.function"),
        (rtu("01 03 40 00 00 01"), "explain.no_table"),
    ],
)
def test_what_the_model_does_not_have_is_an_erratum(frame: bytes, key: str) -> None:
    found = describe_frame("vc660", frame)
    assert found.valid
    assert key in keys(found, "errata")


def test_a_fault_is_named_by_its_keypad_label() -> None:
    vector = next(each for each in load_vectors("dzb100") if each.id == "dzb100-status-fault")
    assert explained(vector).fields["fault"] == "E009"
    fault = next(each for each in load_vectors("c320") if each.id == "c320-fault-12-ascii")
    assert explained(fault).fields["fault"] == "Fu.12"


@pytest.mark.parametrize("vector", [each for each in all_vectors() if not each.fields.get("fault_code")])
def test_a_frame_without_a_fault_names_none(vector: Vector) -> None:
    assert "fault" not in explained(vector).fields


@pytest.mark.parametrize("model", MODELS)
def test_any_bytes_are_explained(model: str) -> None:
    """No bytes crash the reader, whatever frame and request are."""
    rng = random.Random(3)
    family = [each for each in VECTORS if each.model == model] or list(load_vectors("c320"))
    for turn in range(700):
        data = bytearray(rng.choice(family).data)
        for _ in range(rng.randrange(4)):
            data[rng.randrange(len(data))] = rng.randrange(256)
        cut = bytes(data[: rng.randrange(len(data) + 1)] if turn % 3 == 0 else data)
        frame = rng.randbytes(rng.randrange(30)) if turn % 7 == 0 else cut
        request = None if turn % 2 else rng.choice(family).data
        found = describe_frame(model, frame, request=request)
        assert found.valid or found.problems
        for direction in ("request", "response"):
            assert describe_frame(model, frame, direction=direction, request=request).direction == direction


def test_what_the_caller_gets_wrong_is_named() -> None:
    with pytest.raises(ProfileError):
        describe_frame("no-such-model", b"")
    with pytest.raises(ConfigurationError) as caught:
        describe_frame("c320", b"", encoding="rtu")
    assert str(caught.value) == "c320 has no encoding rtu: expected ascii, hex"
    with pytest.raises(ConfigurationError) as caught:
        describe_frame("c320", b"", direction="sideways")
    assert caught.value.params["found"] == "sideways"


def test_an_exception_of_vc660_has_the_words_of_the_manual() -> None:
    from drivebus.protocols.modbus.rtu import build_frame

    found = describe_frame("vc660", build_frame(bytes.fromhex("01 86 04")), direction="response")
    assert found.valid and (found.fields["exception"], found.fields["exception_name"]) == (4, "failed")
    assert i18n.text("decode.word.failed", "zh") == "命令执行失败"


def rtu(octets: str) -> bytes:
    from drivebus.protocols.modbus.rtu import build_frame

    return build_frame(bytes.fromhex(octets))


def test_a_jog_start_of_df800_without_a_direction_is_named_and_a_hazard() -> None:
    found = describe_frame("df800", rtu("01 06 20 00 00 03"))
    assert (found.fields["commands"], keys(found, "hazards")) == (["jog"], ["explain.jog_direction"])
    with_direction = describe_frame("df800", rtu("01 06 20 00 00 0B"))
    assert with_direction.fields["commands"] == ["forward", "jog_forward"] and not with_direction.hazards
    assert keys(describe_frame("df800", rtu("01 06 20 00 00 0F")), "hazards") == ["explain.toggle"]


@pytest.mark.parametrize(
    ("model", "octets"),
    [("ms300", "01 06 20 00 00 03"), ("gd10", "01 06 20 00 00 0A"), ("ms300", "01 10 20 00 00 02 04 00 13 01 F4")],
)
def test_a_command_word_that_the_profile_does_not_list_is_a_hazard(model: str, octets: str) -> None:
    """0003H jogs an MS300; it was explained as a frame without commands."""
    found = describe_frame(model, rtu(octets), encoding="rtu")
    assert found.valid and keys(found, "hazards") == ["explain.unlisted_command"]


@pytest.mark.parametrize("octets", ["01 06 20 00 00 12", "01 10 20 00 00 02 04 00 12 01 F4", "01 03 21 00 00 04"])
def test_a_listed_command_word_and_a_read_are_no_hazard(octets: str) -> None:
    assert not describe_frame("ms300", rtu(octets), encoding="rtu").hazards


@pytest.mark.parametrize(
    ("model", "octets", "kind", "key"),
    [
        ("vc660", "01 06 30 00 00 01", "errata", "explain.read_only"),
        ("vc660", "01 03 20 00 00 01", "errata", "explain.write_only"),
        ("vc660", "01 03 20 06 00 01", "errata", "explain.write_only"),
        ("vc660", "00 03 30 00 00 01", "errata", "explain.broadcast_read"),
        ("vc660", "01 06 20 00 00 03", "hazards", "explain.start_and_stop"),
        ("df800", "00 06 20 00 00 01", "errata", "explain.no_broadcast"),
        ("df800", "01 06 20 01 9C 41", "errata", "explain.setpoint_range"),
    ],
)
def test_a_request_that_the_manual_does_not_allow_says_why(model: str, octets: str, kind: str, key: str) -> None:
    assert keys(describe_frame(model, rtu(octets)), kind) == [key]


def test_the_highest_setpoint_of_the_manual_is_in_range() -> None:
    assert not describe_frame("df800", rtu("01 06 20 01 9C 40")).errata


@pytest.mark.parametrize(
    ("octets", "key", "number"),
    [
        (b"R\x03\x0101810000", "protocols.dzb100.erratum.parameter", "00 to 80"),
        (b"Q\x03\x0101040000", "protocols.dzb100.erratum.item", "X0 to X3"),
    ],
)
def test_a_number_outside_the_ranges_of_dzb100_is_the_reason_that_is_given(
    octets: bytes, key: str, number: str
) -> None:
    found = describe_frame("dzb100", octets, direction="request")
    assert keys(found, "errata") == [key]
    assert number in i18n.text(key, "en", **found.errata[0][1])


@pytest.mark.parametrize(
    ("model", "data"),
    [("vc660", rtu("00 06 00 02 0F A0")), ("c320", b"*1F4030000" + b"01CE\r")],
)
def test_a_broadcast_is_called_one(model: str, data: bytes) -> None:
    assert describe_frame(model, data).fields["broadcast"] is True
    assert "broadcast" not in describe_frame("vc660", rtu("01 06 00 02 0F A0")).fields


@pytest.mark.parametrize("frame", [b"*1F0000000197\r", b"*1F1000000198\r", b"*1F200001019A\r"])
def test_a_read_of_the_broadcast_address_of_c320_has_an_erratum(frame: bytes) -> None:
    """Only the read of address 0 of a VC660 was."""
    found = describe_frame("c320", frame)
    assert found.valid and keys(found, "errata") == ["explain.broadcast_read"]
    assert keys(describe_frame("c320", b"*1F403000001CE\r"), "errata") == []


@pytest.mark.parametrize(
    ("model", "start", "stop"),
    [
        ("vc660", rtu("00 06 20 00 00 01"), rtu("00 06 20 00 00 02")),
        ("c320", b"*1F411000001CD\r", b"*1F403000001CE\r"),
        ("dzb100", b"C\x03\x0200010000", b"C\x03\x0200000000"),
    ],
)
def test_a_broadcast_that_may_start_every_motor_is_a_hazard_and_a_broadcast_stop_is_none(
    model: str, start: bytes, stop: bytes
) -> None:
    found = describe_frame(model, start)
    assert found.valid and keys(found, "hazards") == ["explain.broadcast_motion"]
    assert keys(describe_frame(model, stop), "hazards") == []


@pytest.mark.parametrize("word", ["02", "0B", "07"])
def test_a_start_to_address_0_is_a_hazard_where_the_manual_has_no_broadcast(word: str) -> None:
    """By the Modbus specification a DF800 may execute it, and decode showed an erratum only."""
    start = modbus.WriteRegister(0, 0x2000, int(word, 16))
    for codec in (modbus.ModbusRtuCodec(), modbus.ModbusAsciiCodec()):
        found = describe_frame("df800", codec.encode_request(start))
        assert found.valid and keys(found, "hazards") == ["explain.possible_broadcast_motion"]
    assert keys(describe_frame("df800", rtu("00 06 20 00 00 01")), "hazards") == []
    assert keys(describe_frame("df800", rtu("01 06 20 00 00 02")), "hazards") == []


def test_a_start_of_one_drive_is_no_broadcast_hazard() -> None:
    assert keys(describe_frame("vc660", rtu("03 06 20 00 00 01")), "hazards") == []
    assert keys(describe_frame("vc660", rtu("00 06 20 00 00 01"), direction="response"), "hazards") == []


def test_a_fault_of_dzb100_has_its_text_and_signals_their_names_in_chinese() -> None:
    found = describe_frame("dzb100", b"Q\x03\x0601030001", direction="response")
    assert found.fields["fault"] == "E009"
    assert labels.value_text("fault_text", found.fields["fault_text"], "zh") == "过电流"
    names = {name for model in MODELS for name in profiles.load(model).signals}
    assert all(i18n.known(f"signal.{name}") for name in names)


def test_a_signal_that_only_its_profile_names_has_the_text_of_the_profile() -> None:
    """In Chinese it had an English name and nothing else."""
    profile = profiles.load("yl600")
    signal = profile.signals["error_code"]
    read = modbus.ModbusRtuCodec().encode_request(modbus.ReadRegisters(1, signal.locator[1], 1))
    reply = modbus.ModbusRtuCodec().encode_reply(modbus.RegisterValues(1, 3, (5,)))
    [row] = describe_frame(profile, reply, request=read).fields["values"]
    assert (row["name"], row["meaning"]) == ("error_code", signal.text)
    assert labels.value_text("meaning", row["meaning"], "zh") == signal.text.zh != "error_code"
    request = modbus.ModbusRtuCodec().encode_request(modbus.ReadRegisters(1, 0x3001, 1))
    [known] = describe_frame("vc660", reply, request=request).fields["values"]
    assert known["name"] == "set_frequency" and "meaning" not in known


def test_a_misspelt_broadcast_stop_has_no_hazard_of_a_start() -> None:
    """A = 02 and address 02 (DZB100): only a broadcast that moves has that hazard."""
    stop = describe_frame("dzb100", b"C\x03\x0202000000")
    assert (stop.hazards, stop.canonical) == ((), b"C\x03\x0200000000")
    run = describe_frame("dzb100", b"C\x03\x0202010001")
    assert [key for key, _ in run.hazards] == ["explain.broadcast_motion"] and run.canonical is None


def test_an_operation_in_a_broadcast_read_of_c320_keeps_its_hazard() -> None:
    frame = b"*1F101000"
    shown = describe_frame("c320", frame + b"%04X\r" % sum(frame[1:]))
    assert "explain.broadcast_motion" in [key for key, _ in shown.hazards]


def test_the_current_of_dzb100_is_shown_under_each_coding() -> None:
    reply = describe_frame("dzb100", b"Q\x03\x0601020063", request=b"Q\x03\x0101020000")
    expected = ["9.9 A (hex-0.1)", "0.99 A (hex-0.01)", "6.3 A (decimal-0.1)", "99 A (hex-1)"]
    assert reply.fields["current_by_coding"] == expected
