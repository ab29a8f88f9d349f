"""The damaged frames that no check can tell from good ones: enumerated once, recorded, and held to ever since.

A case is a frame of ``vectors/`` with who may take it: the station that hears it, the host whose request it answers, or
the host that hears its own request back from an echoing adapter. ``data/flips.json`` has all cases with their bytes, so
that an installed package needs no vectors, and for one, two and three flipped bits how many frames are taken and which:
listed where they are few, else as the SHA-256 of the list. ``python -m verification.codec_fuzz.bit_flips VECTORS``
records it again.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from hashlib import sha256
from itertools import combinations
from math import comb
from pathlib import Path
from typing import Any

from verification.codec_fuzz.incremental_feed import accepted_size, decode_outcome
from verification.codec_fuzz.registry import FUZZED_CODECS
from verification.pool import map_in_order

FLIPS_FILE = Path(__file__).parent / "data" / "flips.json"
FLIP_COUNTS = (1, 2, 3)
MAX_LISTED_FLIPS = 20
"""So many accepted flips are listed in full."""
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
"""The request of each reply that names none."""


@dataclass(frozen=True, slots=True)
class FlipCase:
    """A frame and who may take it."""

    vector: str
    printed: bool
    """As printed; else as a correct sender writes it."""
    role: str
    """"request" at a station, "reply" or "echo" at a host."""
    codec: str
    sent: bytes
    """The request that the host waits on; empty at a station."""
    frame: bytes

    @property
    def name(self) -> str:
        return f"{self.vector}{'' if self.printed else ' (canonical)'} as {self.role} by {self.codec}"

    def pattern_count(self, bits: int) -> int:
        """So many ways to flip so many of its data bits."""
        return comb(8 * len(self.frame), bits)


FlipSets = dict[str, dict[str, Any]]
"""Number of flipped bits → accepted: how many; flips: which; or sha256 of them."""


def accepted_flips(case: FlipCase, bits: int) -> tuple[list[str], list[str]]:
    """The flips that the codec takes, and those where its judge disagrees. "3.0 17.6": bit 0 of byte 3, bit 6 of 17."""
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
    """A set as it is recorded."""
    if len(flips) <= MAX_LISTED_FLIPS:
        return {"accepted": len(flips), "flips": flips}
    return {"accepted": len(flips), "sha256": sha256("\n".join(flips).encode()).hexdigest()}


@cache
def recorded_cases() -> dict[FlipCase, FlipSets]:
    """All cases, in order."""
    rows = json.loads(FLIPS_FILE.read_text(encoding="utf-8"))["cases"]
    return {_read_case(row): row["sets"] for row in rows}


def _read_case(row: dict[str, Any]) -> FlipCase:
    sent, frame = bytes.fromhex(row["sent"]), bytes.fromhex(row["frame"])
    return FlipCase(row["vector"], row["printed"], row["as"], row["codec"], sent, frame)


def vector_cases(folder: Path) -> Iterator[FlipCase]:
    """Every frame of ``vectors/`` as printed, and as it should have been, with everybody who may take it."""
    lines = [json.loads(line) for path in sorted(folder.glob("*.jsonl")) for line in path.open(encoding="utf-8")]
    right = {line["id"]: bytes.fromhex(line.get("canonical_hex", line["hex"])) for line in lines}
    for line in lines:
        printed = bytes.fromhex(line["hex"])
        for frame in dict.fromkeys((printed, right[line["id"]])):
            for codec in CODECS_OF_VECTORS[line["model"], line["encoding"]]:
                if line["direction"] == "request":
                    yield FlipCase(line["id"], frame == printed, "request", codec, b"", frame)
                    if frame == right[line["id"]]:
                        yield FlipCase(line["id"], frame == printed, "echo", codec, frame, frame)
                else:
                    sent = (
                        bytes.fromhex(MISSING_REQUESTS[line["id"]])
                        if "reply_to" not in line
                        else right[line["reply_to"]]
                    )
                    yield FlipCase(line["id"], frame == printed, "reply", codec, sent, frame)


def write_record(folder: Path) -> None:
    """Enumerate everything and write ``DATA``. Raises ValueError where codec and judge disagree."""
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
            raise ValueError(f"{case.name}: codec and judge disagree on {disputed[:9]}")
        sets[str(bits)] = flips_digest(found)
    return sets


if __name__ == "__main__":
    write_record(Path(sys.argv[1]))
