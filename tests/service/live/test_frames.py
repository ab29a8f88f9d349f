"""Texts of decoded frames: words of the catalogues in both languages."""

from __future__ import annotations

import re
import typing
from pathlib import Path
from types import SimpleNamespace

import pytest

from drivebus import i18n, profiles
from drivebus.bus.trace import TraceEvent, TraceKind
from drivebus.cli.commands.decode import field_text
from drivebus.commissioning.decode import labels
from drivebus.drives.dialects.base import StopMode
from drivebus.drives.state import Direction
from drivebus.errors import CapabilityError
from drivebus.profiles.schema import CommandName
from drivebus.protocols import dzb100, modbus, sunfar
from drivebus.protocols.dzb100.messages import COMMAND_BY_CODE
from drivebus.protocols.sunfar.messages import SunfarOperation, SunfarResponse, SunfarState
from drivebus.service.api.frames import _decode, frame_json
from drivebus.service.runtime.bus import TracedFrame
from fixtures.drives import dialect_for
from fixtures.vectors import all_vectors

NUMBER = re.compile(r"[0-9A-F]+H\b")
CODING = re.compile(r"[（(](?:hex|decimal)-[\d.]+[）)]")
"""Value of a setting beside its words."""
LATIN = re.compile(r"(?<![0-9A-Za-z])[A-Za-z][A-Za-z_]+")
UNITS = {"Hz", "kW", "CRC", "LRC", "EEPROM", "xxH", "MM", "Fu"}
"""Units, and ``Fu`` as shown by the keypad of a C320."""


def sent_frames() -> list[tuple[str, bytes]]:
    """Return the frames that commands send to each family, and a write to EEPROM."""
    c320 = sunfar.SunfarCodec("ascii")
    found = [
        ("c320", c320.encode_request(sunfar.SunfarControl(1, each, 500 * each.sets_frequency)))
        for each in SunfarOperation
    ]
    rtu = modbus.ModbusRtuCodec()
    for model in ("vc660", "df800"):
        dialect = dialect_for(model, **({"direction_calibrated": True} if model == "df800" else {}))
        frames = [*dialect.start(Direction.REVERSE, 500), *dialect.jog(Direction.FORWARD, None), *dialect.reset()]
        requests = [frame.request for frame in frames]
        for how in StopMode:
            try:
                requests += dialect.stop(how)
            except CapabilityError:
                continue
        found += [(model, rtu.encode_request(request)) for request in requests]
    saved = profiles.load("vc660").write_support.eeprom_address_bit
    found.append(("vc660", rtu.encode_request(modbus.WriteRegister(1, 0x0002 | saved, 3000))))
    words = [(each, 0 if each.is_stop or each is dzb100.Dzb100Command.RESET else 1000) for each in dzb100.Dzb100Command]
    return found + [("dzb100", dzb100.Dzb100Codec().encode_request(dzb100.Dzb100Control(1, *word))) for word in words]


FRAMES = [(each.model, each.data, each.direction == "request") for each in all_vectors()]
FRAMES += [(model, data, True) for model, data in sent_frames()]
FRAMES += [(model, data[:-1] + b"?", True) for model, data in sent_frames()]  # damaged


def test_a_frame_is_described_in_words_of_each_language() -> None:
    for model, data, is_request in FRAMES:
        text = _decode(profiles.load(model), data, is_request=is_request)
        assert set(LATIN.findall(CODING.sub("", NUMBER.sub("", text["zh"])))) <= UNITS, text["zh"]
        assert not re.search(r"[a-z]_[a-z]|\b(?:decode|protocols|modbus)\.", text["en"]), text["en"]


def test_the_frames_contain_each_kind_of_command() -> None:
    texts = " ".join(
        _decode(profiles.load(model), data, is_request=is_request)["zh"] for model, data, is_request in FRAMES
    )
    wanted = ("decode.field.saves", "decode.word.start", "decode.word.coast", "decode.word.emergency_stop")
    assert [key for key in wanted if i18n.text(key, "zh") not in texts] == []


NAMES = {
    "operation_name": {each.name.lower() for each in SunfarOperation},
    "response_name": {each.name.lower() for each in SunfarResponse},
    "state_name": {each.name.lower() for each in SunfarState},
    "command_name": {each.name.removesuffix("_2").lower() for each in COMMAND_BY_CODE.values()},
    "commands": set(typing.get_args(CommandName)),
}


@pytest.mark.parametrize(("register", "value"), [(0x2000, 1), (0x0002, 3000)])
def test_a_word_on_the_page_has_the_notation_of_the_manuals_as_in_decode(register: int, value: int) -> None:
    """Trap: the log shows register 8192, which no manual prints, and ``decode`` shows 2000H."""
    data = modbus.ModbusRtuCodec().encode_request(modbus.WriteRegister(1, register, value))
    words = ((register, "register"), (value, "value"))
    for language in i18n.LANGUAGES:
        shown = _decode(profiles.load("vc660"), data, is_request=True)[language]
        for word, name in words:
            label = i18n.text(f"decode.field.{name}", language)
            assert f"{label} {word} ({word:04X}H)" in shown
            assert field_text(name, word) == f"{word} ({word:04X}H)"


@pytest.mark.parametrize("field", NAMES)
def test_every_name_in_a_frame_has_its_word(field: str) -> None:
    for language in i18n.LANGUAGES:
        assert {name for name in NAMES[field] if labels.value_text(field, name, language) is None} == set()


def test_every_coding_has_its_word() -> None:
    for language in i18n.LANGUAGES:
        assert {
            coding for coding in dzb100.FREQUENCY_CODINGS if labels.field_label(coding, language) == coding
        } == set()


def test_every_kind_of_traced_bytes_has_its_word() -> None:
    keys = {f"{prefix}_{kind.value}" for prefix in ("plant.frame", "page.frame_kind") for kind in TraceKind}
    assert keys - i18n.catalogue("zh").keys() == set()


def test_a_frame_is_described_by_the_profile_in_force_and_no_file_is_read_for_it(tmp_path: Path) -> None:
    """Trap: the frame log reads the file of a user's profile again, changed or deleted since, in the process of the
    buses."""
    file = tmp_path / "pump.toml"
    file.write_text('format = 1\nextends = "vc660"\n')
    drive = SimpleNamespace(profile=profiles.load(file), config=SimpleNamespace(address=1))
    bus = typing.cast(typing.Any, SimpleNamespace(drives={"pump": drive}))
    request = modbus.ModbusRtuCodec().encode_request(modbus.WriteRegister(1, 0x2000, 1))
    frame = TracedFrame(1, 0, TraceEvent(time=0.0, kind=TraceKind.SENT, station=1, data=request))
    text = frame_json(bus, frame)["text"]
    file.unlink()
    _decode.cache_clear()
    assert frame_json(bus, frame)["text"] == text
    assert i18n.text("decode.field.register", "en") in text["en"]
