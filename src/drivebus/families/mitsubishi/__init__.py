"""Mitsubishi computer link: ASCII frames of FR-A500, E500, A700, E700, F700 and D700 inverters.

Sources: FR-E500 manual, pages 102 and 103 (marine.manualsonline.com/manuals/mfg/mitsubishi/fre500.html?p=117 and 118),
FR-F500 manual, page 114 (manualshive.com/en/manual/mitsubishi/fr-f500/1809263?page=127), FR-F700-NA manual, page 231
(marine.manualsonline.com/manuals/mfg/mitsubishi/frf700na.html?p=242), FR-A800 manual, page 578
(easymanua.ls/mitsubishi/fr-a800/manual?p=579); a program that runs A500, E500 and E700: LinuxCNC
src/hal/user_comps/mitsub_vfd.py at 076f45c8.

codec      messages to frames and back, effect of a request frame
describe   frames for people
dialect    operations to requests, replies to readings
station    simulated drive
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from drivebus.families.mitsubishi.codec import ENQ, LAST_STATION, READ_DIGITS, MitsubishiCodec
from drivebus.protocols.family import Locator, NotationStyle, ProtocolFamily

_CODE = re.compile(r"H([0-9A-F]{2})", re.ASCII)
_FOLDER = Path(__file__).parent


def _parse(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Return the locator of ``H6F``, instruction code 6FH; None for any other text."""
    match = _CODE.fullmatch(text)
    return ("monitor", int(match[1], 16)) if match and int(match[1], 16) in READ_DIGITS else None


def _format(locator: Locator, highest: int) -> str:
    return f"H{locator[1]:02X}"


FAMILY: Final = ProtocolFamily(
    name="mitsubishi",
    codecs={"ascii": MitsubishiCodec},
    first_bytes={ENQ: "ascii"},
    addresses=(0, LAST_STATION),
    broadcast=None,
    gap_characters=0.0,
    jog_frequency="drive",
    notations={"mitsubishi": NotationStyle(examples=("H6F", "H7A"), parse=_parse, format=_format)},
    describe="drivebus.families.mitsubishi.describe:describe",
    dialect="drivebus.families.mitsubishi.dialect:MitsubishiDialect",
    simulated_models=("drivebus.families.mitsubishi.station:MODELS",),
    scan_models=("fr_e500", "fr_a500", "fr_a700", "fr_e700", "fr_f700", "fr_d700"),
    profiles=_FOLDER / "profiles",
    catalogues=_FOLDER / "texts",
)
