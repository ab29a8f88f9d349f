"""Huanyang HY: frames with function, length and CRC that look like Modbus RTU and are not.

Sources: Holip HLP-C+ manual, pages 73 and 74 (easymanua.ls/holip/hlp-cplus/manual?p=77 and 78) and Dema D5M manual,
pages 68 to 72 (easymanua.ls/dema/d5m-series/manual?p=72 to 76), related models with the same protocol; frames recorded
from a HY01D523B (unininu.tistory.com/288); programs that run HY drives: LinuxCNC
src/hal/user_comps/huanyang-vfd/hy_comm.c at 056edd9a, FluidNC FluidNC/src/Spindles/VFD/Huanyang.cpp at
e952f33f, grblHAL Plugins_spindle vfd/huanyang.c at 9581591f.

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

from drivebus.families.huanyang.codec import BROADCAST, LAST_ADDRESS, LAST_ITEM, HuanyangCodec
from drivebus.protocols.family import Locator, NotationStyle, ProtocolFamily

_PARAMETER = re.compile(r"(?:PD)?([0-9]{1,3})", re.ASCII)
_ITEM = re.compile(r"CFG([0-9])", re.ASCII)
_FOLDER = Path(__file__).parent


def _parse(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Return parameter 5 for ``PD005``, status item 1 for ``CFG1``; None for another notation."""
    if item := _ITEM.fullmatch(text):
        return ("item", int(item[1])) if int(item[1]) <= LAST_ITEM else None
    match = _PARAMETER.fullmatch(text)
    return ("parameter", int(match[1])) if match and int(match[1]) <= highest else None


def _format(locator: Locator, highest: int) -> str:
    space, index = locator
    return f"CFG{index}" if space == "item" else f"PD{index:03d}"


FAMILY: Final = ProtocolFamily(
    name="huanyang",
    codecs={"rtu": HuanyangCodec},
    addresses=(1, LAST_ADDRESS),
    broadcast=BROADCAST,
    gap_characters=3.5,
    jog_frequency="drive",
    notations={
        "huanyang": NotationStyle(examples=("PD005 (PD000-PD255)", "CFG1 (CFG0-CFG7)"), parse=_parse, format=_format)
    },
    describe="drivebus.families.huanyang.describe:describe",
    dialect="drivebus.families.huanyang.dialect:HuanyangDialect",
    simulated_models=("drivebus.families.huanyang.station:MODELS",),
    scan_models=("huanyang_hy",),
    binary_encodings=frozenset({"rtu"}),
    profiles=_FOLDER / "profiles",
    catalogues=_FOLDER / "texts",
)
