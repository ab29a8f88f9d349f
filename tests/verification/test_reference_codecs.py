"""The reference codecs build and read the manuals' worked frames (C320 section 4, DZB100 section 3)."""

from __future__ import annotations

import pytest

from verification.reference.dzb100 import Dzb100Reference
from verification.reference.sunfar import SunfarReference

# (section, fields, request, reply, data of the reply); the misprinted forms of 4.5 and 4.6 are left out.
C320 = [
    ("4.1", {"kind": 0}, "2A30303030313030303031 38310D", "2A 30303030313034303030323230323439 0D", 0x22),
    ("4.1", {"kind": 0}, "5A00000000010000000000 00010D", "5A 00000000010004000000002200000027 0D", 0x22),
    ("4.2", {"kind": 1}, "2A30303130313030303031 38320D", "2A 30303030313030303033453730323630 0D", 999),
    ("4.2", {"kind": 1}, "5A00000100010000000000 00020D", "5A 0000000001000000000003E7000000EB 0D", 999),
    ("4.3", {"kind": 2, "item": 1}, "2A30303230313030313031 38340D", "2A 30303030313030313030303230323434 0D", 2),
    ("4.3", {"kind": 2, "item": 1}, "5A00000200010000010000 00040D", "5A 00000000010000010000000200000004 0D", 2),
    (
        "4.4",
        {"kind": 3, "group": 4, "data": 1},
        "2A 30303330313430303030303130323439 0D",
        "2A 30303030313430303030303130323436 0D",
        1,
    ),
    (
        "4.4",
        {"kind": 3, "group": 4, "data": 1},
        "5A 00000300010400000000000100000009 0D",
        "5A 00000000010400000000000100000006 0D",
        1,
    ),
]


@pytest.mark.parametrize(("section", "fields", "request_hex", "reply_hex", "data"), C320)
def test_the_reference_c320_builds_and_reads_the_manuals_frames(
    section: str, fields: dict[str, int], request_hex: str, reply_hex: str, data: int
) -> None:
    request, reply = bytes.fromhex(request_hex), bytes.fromhex(reply_hex)
    encoding = "ascii" if request[0] == 0x2A else "hex"
    assert SunfarReference(encoding).build(0, operation=1, **fields) == request, section
    read = SunfarReference(encoding).decode_reply(request, reply)
    assert read is not None
    assert (read["address"], read["response"], read["state"], read["data"]) == (0, 0, 1, data), section


def test_the_reference_c320_builds_example_4_6() -> None:
    request = bytes.fromhex("2A 30 30 34 31 31 30 33 45 37 30 31 44 35 0D")
    assert SunfarReference("ascii").build(0, 4, operation=0x11, data=999) == request


DZB100 = [
    ("1", ("control", 1, 1, 1000), "43030130313031 30334538", "43030630313031 30334538", 1000),
    ("2", ("write", 2, 10, 0x96), "50030130323130 30303936", "50030630323130 30303936", 0x96),
    ("3", ("read", 3, 23, 0), "52030130333233 30303030", "52030630333233 30303634", 100),
]


@pytest.mark.parametrize(("example", "fields", "request_hex", "reply_hex", "data"), DZB100)
def test_the_reference_dzb100_builds_and_reads_the_manuals_frames(
    example: str, fields: tuple[str, int, int, int], request_hex: str, reply_hex: str, data: int
) -> None:
    request, reply = bytes.fromhex(request_hex), bytes.fromhex(reply_hex)
    assert Dzb100Reference().build(*fields) == request, example
    read = Dzb100Reference().decode_reply(request, reply)
    assert read is not None
    assert (read["result"], read["data"]) == ("right", data), example
