"""Damaged frames that no check detects: enumerated once, recorded, and compared in every run.

A case is a frame of ``vectors/`` and its receiver: a station, the master whose request it answers, or a master that
receives its own echo. ``data/flips.json`` holds, for one, two and three flipped bits, the number of accepted frames and
their list (or its SHA-256). ``python -m verification.codec_fuzz.bit_flips VECTORS`` records it again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from hashlib import sha256
from itertools import combinations
from math import comb
from pathlib import Path
from typing import Any

from verification.campaign import map_in_order
from verification.codec_fuzz.fuzz_block import accepted_size, decode_outcome
from verification.codec_fuzz.registry import FUZZED_CODECS

FLIPS_FILE = Path(__file__).parent / "data" / "flips.json"
FLIP_COUNTS = (1, 2, 3)
MAX_LISTED_FLIPS = 20
"""Largest number of accepted flips that are listed in full."""
CODECS_OF_VECTORS = {
    ("c320", "ascii"): ("c320-ascii", "c320-ascii-tolerant"),
    ("c320", "hex"): ("c320-hex", "c320-hex-nibble"),
    ("dzb100", "ascii"): ("dzb100",),
    ("vc660", "rtu"): ("modbus-rtu",),
    ("df800", "rtu"): ("df800-rtu",),
    ("df800", "ascii"): ("df800-ascii",),
}
MISSING_REQUESTS = {
    "c320-sib-reply-hex": "5A 00 00 01 00 00 00 00 06 00 00 00 07 0D",
    "c320-short-bad-item-ascii": "2A 30 35 31 30 30 30 30 30 30 31 38 36 0D",
    "c320-short-bad-item-hex": "5A 00 05 01 00 00 00 00 00 00 00 00 06 0D",
    "c320-fault-12-ascii": "2A 30 33 31 30 30 30 30 30 30 31 38 34 0D",
    "dzb100-status-fault": "51 03 01 30 37 30 33 30 30 30 30",
    "dzb100-refused": "50 03 01 30 32 39 39 30 30 30 30",
    "vc660-exception": "01 06 20 00 00 01 43 CA",
    "df800-read-error-ascii": "3A 30 31 30 33 30 30 36 34 30 30 30 31 39 37 0D 0A",
    "df800-write-error-ascii": "3A 30 31 30 36 32 30 30 30 30 30 30 31 44 38 0D 0A",
    "df800-read-error-rtu": "01 03 00 64 00 01 C5 D5",
    "df800-write-error-rtu": "01 06 20 00 00 01 43 CA",
}
"""Requests of the replies that name none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlipCase:
    """Frame and its receiver."""

    vector: str
    printed: bool
    """Whether the frame is as printed; else as a correct sender writes it."""
    role: str
    """"request" at a station, "reply" or "echo" at a master."""
    codec: str
    sent: bytes
    """Outstanding request of the master; empty at a station."""
    frame: bytes

    @property
    def name(self) -> str:
        return f"{self.vector}{'' if self.printed else ' (canonical)'} as {self.role} by {self.codec}"

    def pattern_count(self, bits: int) -> int:
        """Return the number of patterns of this many flipped bits."""
        return comb(8 * len(self.frame), bits)


FlipSets = dict[str, dict[str, Any]]
"""Number of flipped bits → number of accepted frames, and their list or its SHA-256."""


def accepted_flips(case: FlipCase, bits: int) -> tuple[list[str], list[str]]:
    """Return the flips that the codec accepts, and those where the reference disagrees. "3.0 17.6": bit 0 of byte 3,
    bit 6 of 17."""
    entry, size, found, disputed = FUZZED_CODECS[case.codec], len(case.frame), [], []
    decode = partial(entry.codec.decode_reply, entry.request_of(case.sent)) if case.sent else entry.codec.decode_request
    number = int.from_bytes(case.frame, "little")
    for places in combinations(range(8 * size), bits):
        flipped = number
        for place in places:
            flipped ^= 1 << place
        data = flipped.to_bytes(size, "little")
        size_taken = accepted_size(decode_outcome(decode, data), data)
        if size_taken != entry.reference.accepted_size(case.sent, data):
            disputed.append(_flip_text(places))
        if size_taken is not None:
            found.append(_flip_text(places))
    return found, disputed


def _flip_text(places: tuple[int, ...]) -> str:
    return " ".join(f"{place // 8}.{place % 8}" for place in places)


def flips_digest(flips: list[str]) -> dict[str, Any]:
    """Return a set of flips in its recorded form."""
    if len(flips) <= MAX_LISTED_FLIPS:
        return {"accepted": len(flips), "flips": flips}
    return {"accepted": len(flips), "sha256": sha256("\n".join(flips).encode()).hexdigest()}


@cache
def recorded_cases() -> dict[FlipCase, FlipSets]:
    """Return all recorded cases, in order."""
    rows = json.loads(FLIPS_FILE.read_text(encoding="utf-8"))["cases"]
    return {_read_case(row): row["sets"] for row in rows}


def _read_case(row: dict[str, Any]) -> FlipCase:
    sent, frame = bytes.fromhex(row["sent"]), bytes.fromhex(row["frame"])
    return FlipCase(
        vector=row["vector"], printed=row["printed"], role=row["as"], codec=row["codec"], sent=sent, frame=frame
    )


def vector_cases(folder: Path) -> Iterator[FlipCase]:
    """Yield every frame of ``vectors/``, as printed and as correct, with every possible receiver."""
    lines = [json.loads(line) for path in sorted(folder.glob("*.jsonl")) for line in path.open(encoding="utf-8")]
    right = {line["id"]: bytes.fromhex(line.get("canonical_hex", line["hex"])) for line in lines}
    for line in lines:
        printed = bytes.fromhex(line["hex"])
        for frame in dict.fromkeys((printed, right[line["id"]])):
            for codec in CODECS_OF_VECTORS[line["model"], line["encoding"]]:
                if line["direction"] == "request":
                    yield FlipCase(
                        vector=line["id"], printed=frame == printed, role="request", codec=codec, sent=b"", frame=frame
                    )
                    if frame == right[line["id"]]:
                        yield FlipCase(
                            vector=line["id"],
                            printed=frame == printed,
                            role="echo",
                            codec=codec,
                            sent=frame,
                            frame=frame,
                        )
                else:
                    sent = (
                        bytes.fromhex(MISSING_REQUESTS[line["id"]])
                        if "reply_to" not in line
                        else right[line["reply_to"]]
                    )
                    yield FlipCase(
                        vector=line["id"], printed=frame == printed, role="reply", codec=codec, sent=sent, frame=frame
                    )


def write_record(folder: Path) -> None:
    """Enumerate all cases and write the record. Raises ValueError where codec and reference disagree."""
    rows = []
    every = list(vector_cases(folder))
    for case, sets in zip(every, map_in_order(_sets, every, in_process=False), strict=True):
        head = {"vector": case.vector, "printed": case.printed, "as": case.role, "codec": case.codec}
        rows.append(head | {"sent": case.sent.hex(" "), "frame": case.frame.hex(" "), "sets": sets})
        print(case.name, *(found["accepted"] for found in sets.values()), flush=True)
    FLIPS_FILE.parent.mkdir(exist_ok=True)
    text = ",\n".join(json.dumps(row) for row in rows)
    FLIPS_FILE.write_text(f'{{"cases": [\n{text}\n]}}\n', encoding="utf-8")


def _sets(case: FlipCase) -> FlipSets:
    sets = {}
    for bits in FLIP_COUNTS:
        found, disputed = accepted_flips(case, bits)
        if disputed:
            raise ValueError(f"{case.name}: codec and reference disagree on {disputed[:9]}")
        sets[str(bits)] = flips_digest(found)
    return sets


if __name__ == "__main__":
    write_record(Path(sys.argv[1]))


# --- strength of the checks -------------------------------------------------------------------------------------------

FlipMask = tuple[tuple[int, int], ...]
"""Pairs of a byte's place and its flipped bits."""


@dataclass(frozen=True, slots=True)
class StrengthCase:
    """Reply to a read or write, and its request."""

    name: str
    codec: str
    sent: str
    frame: str


STRENGTH_CASES = (
    StrengthCase("Modbus RTU, 03, one register", "modbus-rtu", "01 03 30 01 00 01 DA CA", "01 03 02 13 88 B5 12"),
    StrengthCase("Modbus RTU, 06", "modbus-rtu", "01 06 00 02 0B B8 2F 48", "01 06 00 02 0B B8 2F 48"),
    StrengthCase(
        "Modbus ASCII, 03, one register",
        "df800-ascii",
        "3A 30 31 30 33 32 30 30 30 30 30 30 31 44 42 0D 0A",
        "3A 30 31 30 33 30 32 30 31 32 30 44 39 0D 0A",
    ),
    StrengthCase(
        "Modbus ASCII, 06",
        "df800-ascii",
        "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
        "3A 30 31 30 36 32 30 30 31 31 33 38 38 33 44 0D 0A",
    ),
    StrengthCase(
        "C320 ASCII",
        "c320-ascii",
        "2A 30 30 31 30 30 30 30 30 30 31 38 31 0D",
        "2A 30 30 30 30 31 30 30 30 30 33 45 37 30 32 36 30 0D",
    ),
    StrengthCase(
        "C320 hex",
        "c320-hex",
        "5A 00 00 01 00 00 00 00 00 00 00 00 01 0D",
        "5A 00 00 00 00 01 00 00 00 00 00 03 E7 00 00 00 EB 0D",
    ),
    StrengthCase("DZB100", "dzb100", "52 03 01 30 33 32 33 30 30 30 30", "52 03 06 30 33 32 33 30 30 36 34"),
)


def undetected_shares(most: int) -> dict[str, dict[str, object]]:
    """Return for each row the undetected share of all patterns of 1 … ``most`` flipped bits, and of 2 and 4 with
    parity.

    "check": end mark, digits and checksum; "echo": also address, function and the other fields that repeat the request;
    "parity": also the parity bit of each character, which only an even number of flips in every character passes.
    """
    return {row.name: _case_shares(row, most) for row in STRENGTH_CASES}


def _case_shares(row: StrengthCase, most: int) -> dict[str, object]:
    sent, frame = bytes.fromhex(row.sent), bytes.fromhex(row.frame)
    judge = FUZZED_CODECS[row.codec].reference
    tests: dict[str, Callable[[bytes], bool]] = {
        "check": judge.is_well_formed,
        "echo": lambda data: judge.accepted_size(sent, data) == len(frame),
    }
    found: dict[str, object] = {"frame": row.frame, "request": row.sent, "acceptor": row.codec}
    for name, test in tests.items():
        for bits in range(1, most + 1):
            passed = sum(test(_flipped(frame, mask)) for mask in _flip_patterns(frame, bits))
            found[f"{name}_{bits}_bit"] = _share(passed, comb(8 * len(frame), bits))
        for bits in (2, 4)[: most - 1]:
            passed = sum(test(_flipped(frame, mask)) for mask in _parity_preserving_patterns(frame, bits))
            found[f"{name}_{bits}_bit_parity"] = _share(passed, comb(9 * len(frame), bits))
    return found


def _share(passed: int, tried: int) -> dict[str, float]:
    return {"passed": passed, "tried": tried, "share": float(f"{passed / tried:.3g}")}


def _flipped(frame: bytes, mask: FlipMask) -> bytes:
    damaged = bytearray(frame)
    for place, bits in mask:
        damaged[place] ^= bits
    return bytes(damaged)


def _flip_patterns(frame: bytes, bits: int) -> Iterator[FlipMask]:
    """Yield every pattern of this many flips in the data bits."""
    for places in combinations(range(8 * len(frame)), bits):
        yield tuple((place >> 3, 1 << (place & 7)) for place in places)


def _parity_preserving_patterns(frame: bytes, bits: int) -> Iterator[FlipMask]:
    """Yield every pattern with an even number of flips in each character, its parity bit included."""
    if bits == 2:
        yield from (((place, mask),) for place in range(len(frame)) for mask in _character_patterns(2))
        return
    yield from (((place, mask),) for place in range(len(frame)) for mask in _character_patterns(4))
    for one, two in combinations(range(len(frame)), 2):
        yield from (
            ((one, first), (two, second)) for first in _character_patterns(2) for second in _character_patterns(2)
        )


def _character_patterns(bits: int) -> tuple[int, ...]:
    """Return the patterns of the eight data bits for this many flips of nine bits."""
    return tuple(sum(1 << place for place in places) & 255 for places in combinations(range(9), bits))
