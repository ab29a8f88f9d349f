"""The Sunfar family: C320 and the models that share its frames (C300, E300, E350, E500, E550)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from drivebus.protocols.family import Locator, NotationStyle, ProtocolFamily
from drivebus.protocols.sunfar.codec import SunfarCodec
from drivebus.protocols.sunfar.frame import ASCII_HEAD, HEX_HEAD
from drivebus.protocols.sunfar.messages import BROADCAST, GROUP_LETTERS, parameter_name

_PARAMETER = re.compile(r"F([0-9A-Z])[.\-]([0-9]{1,3})", re.ASCII)
_MONITOR = re.compile(r"D[.\-]([0-9]{1,3})", re.ASCII)


def _parse(text: str, highest: int, group_sizes: Mapping[str, int]) -> Locator | None:
    """Return group << 8 | item for ``F1.10`` and ``FC.03`` (manual section 3 (4)), monitor 15 for ``d.15``."""
    monitor = _MONITOR.fullmatch(text)
    if monitor:
        return ("monitor", int(monitor[1])) if int(monitor[1]) <= 0xFF else None
    match = _PARAMETER.fullmatch(text)
    if not match or match[1] not in GROUP_LETTERS or int(match[2]) > 0xFF:
        return None
    return "parameter", GROUP_LETTERS.index(match[1]) << 8 | int(match[2])


def _format(locator: Locator, highest: int) -> str:
    space, index = locator
    return f"d.{index}" if space == "monitor" else parameter_name(index >> 8, index & 0xFF)


FAMILY: Final = ProtocolFamily(
    name="sunfar",
    codecs={"ascii": lambda: SunfarCodec("ascii"), "hex": lambda: SunfarCodec("hex")},
    first_bytes={ASCII_HEAD: "ascii", HEX_HEAD: "hex"},
    addresses=(0, BROADCAST - 1),
    broadcast=BROADCAST,
    gap_characters=5.0,  # manual section 2.2.4
    jog_frequency="either",
    notations={
        "sunfar": NotationStyle(
            examples=("F0.1", "F1.10 (F1.0-F1.255)", "FC.03", "d.0 (d.0-d.255)"), parse=_parse, format=_format
        )
    },
    describe="drivebus.commissioning.decode.sunfar:describe",
    dialect="drivebus.drives.dialects.sunfar:SunfarDialect",
    simulated_models=("drivebus.simulator.models.c320:MODELS",),
    scan_models=("c320", "c300", "e300", "e350", "e500", "e550"),
)
