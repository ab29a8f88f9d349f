"""The Modbus family: every drive with Modbus RTU or ASCII on a serial line; models differ by profile only."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Final

from drivebus.errors import ProfileError
from drivebus.protocols.family import Locator, NotationStyle, ProtocolFamily
from drivebus.protocols.modbus.ascii import START_MARK, ModbusAsciiCodec
from drivebus.protocols.modbus.messages import ADDRESSES, BROADCAST
from drivebus.protocols.modbus.rtu import ModbusRtuCodec
from drivebus.user_input import HEX_WORD, parse_hex_word

_PARAMETER = re.compile(r"F([0-9]{1,2})[.\-]([0-9]{1,3})", re.ASCII)
_DECIMAL = re.compile(r"[0-9]{1,5}", re.ASCII)
_IN_SPACE = re.compile(r"(HOLDING|INPUT|COIL|DISCRETE):(.+)", re.ASCII)
_LAST_ITEM = 99

_Parse = Callable[[str, int, Mapping[str, int]], Locator | None]


def _with_space(parse: _Parse) -> _Parse:
    """Return a parser that also reads ``coil:0049H``; without its space an address is one of holding registers."""

    def parse_in_space(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
        match = _IN_SPACE.fullmatch(text)
        locator = parse(match[2] if match else text, highest, group_sizes)
        return (match[1].lower(), locator[1]) if match and locator else locator

    return parse_in_space


def _parse_hundreds(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Parse ``F1.07`` as group x 100 + item."""
    return _parse_grouped(text, highest, lambda group, item: group * 100 + item)


def _parse_consecutive(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Parse ``F00.02`` as an index over all groups, from the sizes of the groups before it."""
    return _parse_grouped(text, highest, lambda group, item: _consecutive_index(group, item, group_sizes))


def _parse_grouped(text: str, highest: int, index_of: Callable[[int, int], int]) -> Locator | None:
    if _is_hexadecimal(text):
        return _parse_hexadecimal(text)
    match = _PARAMETER.fullmatch(text)
    if not match:
        return None
    item = int(match[2])
    index = index_of(int(match[1]), item)
    return ("holding", index) if item <= _LAST_ITEM and index <= highest else None


def _parse_register(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Parse ``3002H``, ``0x3002`` or ``12290``."""
    if _is_hexadecimal(text):
        return _parse_hexadecimal(text)
    return ("holding", int(text)) if _DECIMAL.fullmatch(text) and int(text) <= highest else None


def _parse_hexadecimal(text: str) -> Locator | None:
    register = parse_hex_word(text)
    return None if register is None else ("holding", register)


def _consecutive_index(group: int, item: int, sizes: Mapping[str, int]) -> int:
    """Return the index of an item. Raises ProfileError where it is not known to be in its group; item 0 always is."""
    known = {int(name[1:]): size for name, size in sizes.items()}
    lacking = [each for each in range(group) if each not in known]
    if group not in known and item > 0:
        lacking.append(group)
    name = f"F{group:02d}.{item:02d}"
    if lacking:
        groups = tuple(f"F{each:02d}" for each in lacking)
        raise ProfileError("profiles.unplaced", notation=name, groups=groups)
    if item >= known.get(group, 1):
        raise ProfileError("profiles.beyond_group", notation=name, group=f"F{group:02d}", size=known[group])
    return sum(known[each] for each in range(group)) + item


def _format_hundreds(locator: Locator, highest: int) -> str:
    space, index = locator
    is_parameter = space == "holding" and index <= highest
    return f"F{index // 100}.{index % 100:02d}" if is_parameter else _format_register(locator, highest)


def _format_register(locator: Locator, highest: int) -> str:
    space, index = locator
    return f"{index:04X}H" if space == "holding" else f"{space}:{index:04X}H"


def _is_hexadecimal(text: str) -> bool:
    return HEX_WORD.fullmatch(text) is not None


def _is_raw_address(text: str) -> bool:
    return _is_hexadecimal(text) or _IN_SPACE.fullmatch(text) is not None


FAMILY: Final = ProtocolFamily(
    name="modbus",
    codecs={"rtu": ModbusRtuCodec, "ascii": ModbusAsciiCodec},
    first_bytes={START_MARK: "ascii"},
    addresses=(ADDRESSES.start, ADDRESSES.stop - 1),
    broadcast=BROADCAST,
    gap_characters=3.5,  # Serial Line V1.02, 2.5.1.1
    jog_frequency="drive",
    notations={
        "consecutive": NotationStyle(
            examples=("F00.02", "3002H", "0x3002"),
            parse=_with_space(_parse_consecutive),
            format=_format_register,
            is_raw_address=_is_raw_address,
        ),
        "hundreds": NotationStyle(
            examples=("F1.07 (F0.00-F9.99)", "2001H", "0x2001"),
            parse=_with_space(_parse_hundreds),
            format=_format_hundreds,
            is_raw_address=_is_raw_address,
        ),
        "register": NotationStyle(
            examples=("3002H", "0x3002", "12290"),
            parse=_with_space(_parse_register),
            format=_format_register,
            is_raw_address=lambda text: True,
        ),
    },
    register_based=True,
    describe="drivebus.commissioning.decode.modbus:describe",
    dialect="drivebus.drives.dialects.modbus:ModbusDialect",
    calibrations="drivebus.drives.operations.direction_calibration:STEPS",
    simulated_models=("drivebus.simulator.models.vc660:MODELS", "drivebus.simulator.models.df800:MODELS"),
    profile_simulator="drivebus.commissioning.profile_simulator:simulated_model",
    similar_models="drivebus.profiles.load:similar_models",
    scan_models=("vc660", "df800"),
    binary_encodings=frozenset({"rtu"}),
)
