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
from verification.families.campaigns import FUZZED_CODECS, family_campaigns
from verification.families.family_campaign import StrengthCase, WorkedFrame

FLIPS_FILE = Path(__file__).parent / "data" / "flips.json"
FLIP_COUNTS = (1, 2, 3)
MAX_LISTED_FLIPS = 20
"""Largest number of accepted flips that are listed in full."""


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
    """Yield every frame of ``vectors/`` and of each family, as printed and as correct, with every possible receiver."""
    campaigns = family_campaigns().values()
    codecs = {key: names for campaign in campaigns for key, names in campaign.codecs_of_vectors.items()}
    missing = {name: frame for campaign in campaigns for name, frame in campaign.missing_requests.items()}
    lines = [json.loads(line) for path in sorted(folder.glob("*.jsonl")) for line in path.open(encoding="utf-8")]
    right = {line["id"]: bytes.fromhex(line.get("canonical_hex", line["hex"])) for line in lines}
    for line in lines:
        printed = bytes.fromhex(line["hex"])
        for frame in dict.fromkeys((printed, right[line["id"]])):
            for codec in codecs[line["model"], line["encoding"]]:
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
                    sent = bytes.fromhex(missing[line["id"]]) if "reply_to" not in line else right[line["reply_to"]]
                    yield FlipCase(
                        vector=line["id"], printed=frame == printed, role="reply", codec=codec, sent=sent, frame=frame
                    )
    for worked in (frame for campaign in campaigns for frame in campaign.worked_frames):
        yield from _worked_cases(worked)


def _worked_cases(worked: WorkedFrame) -> Iterator[FlipCase]:
    sent, received = bytes.fromhex(worked.request), bytes.fromhex(worked.reply)
    cases = (("request", b"", sent), ("echo", sent, sent), ("reply", sent, received))
    for role, request, frame in cases if received else cases[:2]:
        yield FlipCase(vector=worked.name, printed=True, role=role, codec=worked.codec, sent=request, frame=frame)


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


STRENGTH_CASES = tuple(case for campaign in family_campaigns().values() for case in campaign.strength_cases)


def undetected_shares(most: int) -> dict[str, dict[str, object]]:
    """Return for each row the undetected share of all patterns of 1 … ``most`` flipped bits, and of 2 and 4 with
    parity.

    "check": end mark, digits and checksum; "echo": also address, function and the other fields that repeat the request;
    "parity": also the parity bit of each character, which only an even number of flips in every character passes.
    """
    return {row.name: _case_shares(row, most) for row in STRENGTH_CASES}


def _case_shares(row: StrengthCase, most: int) -> dict[str, object]:
    sent, frame = bytes.fromhex(row.sent), bytes.fromhex(row.frame)
    reference = FUZZED_CODECS[row.codec].reference
    tests: dict[str, Callable[[bytes], bool]] = {
        "check": reference.is_well_formed,
        "echo": lambda data: reference.accepted_size(sent, data) == len(frame),
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
