"""Frames as the page, the cases and the API tell them: words of the catalogues, in both languages."""

from __future__ import annotations

import re
import typing

import pytest

from drivebus import i18n, profiles
from drivebus.bus.trace import TraceKind
from drivebus.commissioning.decode import labels
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError
from drivebus.profiles.schema import CommandName
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.dzb100.messages import COMMAND_BY_CODE
from drivebus.protocols.sunfar.messages import SunfarOperation, SunfarResponse, SunfarState
from drivebus.service.api.frames import _decode
from fixtures.drives import dialect_for
from fixtures.vectors import all_vectors

NUMBER = re.compile(r"[0-9A-F]+H\b")
CODING = re.compile(r"[（(](?:hex|decimal)-[\d.]+[）)]")
"""The name of a setting, beside its words."""
LATIN = re.compile(r"(?<![0-9A-Za-z])[A-Za-z][A-Za-z_]+")
UNITS = {"Hz", "kW", "CRC", "LRC", "EEPROM", "xxH", "MM", "Fu"}
"""And Fu, which the C320's keypad shows."""


def commanded() -> list[tuple[str, bytes]]:
    """What a plant sends to each family, and a write that is saved."""
    c320 = sunfar.SunfarCodec("ascii")
    found = [
        ("c320", c320.encode_request(sunfar.SunfarControl(1, each, 500 * each.sets_frequency)))
        for each in SunfarOperation
    ]
    rtu = modbus.ModbusRtuCodec()
    for model in ("vc660", "df800"):
        dialect = dialect_for(model, **({"direction_calibrated": True} if model == "df800" else {}))
        frames = [*dialect.start(Direction.REVERSE, 500), *dialect.jog(Direction.FORWARD, None), *dialect.reset()]
        asked = [frame.request for frame in frames]
        for how in StopMode:
            try:
                asked += dialect.stop(how)
            except CapabilityError:
                continue
        found += [(model, rtu.encode_request(request)) for request in asked]
    saved = profiles.load("vc660").write_support.eeprom_address_bit
    found.append(("vc660", rtu.encode_request(modbus.WriteRegister(1, 0x0002 | saved, 3000))))
    words = [(each, 0 if each.is_stop or each is dzb100.Dzb100Command.RESET else 1000) for each in dzb100.Dzb100Command]
    return found + [("dzb100", dzb100.Dzb100Codec().encode_request(dzb100.Dzb100Control(1, *word))) for word in words]


TOLD = [(each.model, each.data, each.direction == "request") for each in all_vectors()]
TOLD += [(model, data, True) for model, data in commanded()]
TOLD += [(model, data[:-1] + b"?", True) for model, data in commanded()]  # with something wrong


def test_a_frame_is_told_in_words_in_both_languages() -> None:
    for model, data, asked in TOLD:
        message = _decode(model, data, asked)
        assert set(LATIN.findall(CODING.sub("", NUMBER.sub("", message["zh"])))) <= UNITS, message["zh"]
        assert not re.search(r"[a-z]_[a-z]|\b(?:decode|protocols|modbus)\.", message["en"]), message["en"]


def test_a_saved_write_and_its_commands_are_among_them() -> None:
    every = " ".join(_decode(*one)["zh"] for one in TOLD)
    wanted = ("decode.field.saves", "decode.word.start", "decode.word.coast", "decode.word.emergency_stop")
    assert [key for key in wanted if i18n.text(key, "zh") not in every] == []


NAMES = {
    "operation_name": {each.name.lower() for each in SunfarOperation},
    "response_name": {each.name.lower() for each in SunfarResponse},
    "state_name": {each.name.lower() for each in SunfarState},
    "command_name": {each.name.removesuffix("_2").lower() for each in COMMAND_BY_CODE.values()},
    "commands": set(typing.get_args(CommandName)),
}


@pytest.mark.parametrize("field", NAMES)
def test_every_name_that_a_frame_can_have_has_its_word(field: str) -> None:
    for language in i18n.LANGUAGES:
        assert {name for name in NAMES[field] if labels.value_text(field, name, language) is None} == set()


def test_every_coding_has_its_word() -> None:
    for language in i18n.LANGUAGES:
        assert {
            coding for coding in dzb100.FREQUENCY_CODINGS if labels.field_label(coding, language) == coding
        } == set()


def test_whatever_became_of_some_bytes_has_its_word() -> None:
    keys = {f"{prefix}_{kind.value}" for prefix in ("plant.frame", "page.frame_kind") for kind in TraceKind}
    assert keys - i18n.catalogue("zh").keys() == set()
