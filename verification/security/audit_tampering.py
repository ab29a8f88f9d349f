"""What somebody may do to an audit trail that lies on a disk: by accident, by hand, or knowing exactly how it is made.

A trail is its files' bytes by name. Each function changes some of them and says where; None where there was nothing to
change there. Whoever knows the format computes hashes anew as the writer does; the key of the checkpoints he lacks.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from hashlib import sha256
from random import Random

from drivebus.service.audit import records

TrailFiles = dict[str, bytes]
CHECKPOINT_FILE = "checkpoints.jsonl"
TamperFunction = Callable[[Random, TrailFiles], str | None]


def split_lines(data: bytes) -> list[bytes]:
    return data.splitlines(keepends=True)


def trail_files(files: TrailFiles) -> list[str]:
    """The trail's own files, in order."""
    return sorted((name for name in files if name != CHECKPOINT_FILE), key=lambda name: (name == "audit.jsonl", name))


def _random_line(rng: Random, files: TrailFiles) -> tuple[str, list[bytes], int]:
    name = rng.choice([name for name in trail_files(files) if files[name]])
    found = split_lines(files[name])
    return name, found, rng.randrange(len(found))


def _store_lines(files: TrailFiles, name: str, found: list[bytes]) -> None:
    files[name] = b"".join(found)


# --- by accident or by hand ------------------------------------------------------------------------------------------


def flip_bits(rng: Random, files: TrailFiles) -> str:
    """One to eight bits anywhere."""
    name = rng.choice([name for name in trail_files(files) if files[name]])
    data = bytearray(files[name])
    for _ in range(rng.randint(1, 8)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    files[name] = bytes(data)
    return name


def edit(rng: Random, files: TrailFiles) -> str:
    """Some octets of a line are others now, or more, or fewer."""
    name, found, at = _random_line(rng, files)
    line = found[at]
    start = rng.randrange(len(line))
    end = min(len(line), start + rng.randint(0, 5))
    found[at] = line[:start] + bytes(rng.choice(b'0123456789abcdef{}[]",: \n') for _ in range(3)) + line[end:]
    _store_lines(files, name, found)
    return f"{name}:{at + 1}"


def delete(rng: Random, files: TrailFiles) -> str:
    name, found, at = _random_line(rng, files)
    del found[at : at + rng.choice((1, 1, 2, 5))]
    _store_lines(files, name, found)
    return f"{name}:{at + 1}"


def swap(rng: Random, files: TrailFiles) -> str:
    name, found, at = _random_line(rng, files)
    other = rng.randrange(len(found))
    found[at], found[other] = found[other], found[at]
    _store_lines(files, name, found)
    return f"{name}:{min(at, other) + 1}"


def insert(rng: Random, files: TrailFiles) -> str:
    """A line that was there already, or an empty one."""
    name, found, at = _random_line(rng, files)
    found.insert(rng.randrange(len(found) + 1), rng.choice((found[at], b"\n", b"{}\n")))
    _store_lines(files, name, found)
    return name


def truncate(rng: Random, files: TrailFiles) -> str:
    """Everything from some octet of the last file on, or from some file on."""
    names = trail_files(files)
    first = rng.randrange(len(names))
    at = rng.randrange(len(files[names[first]]) or 1)
    files[names[first]] = files[names[first]][:at]
    for name in names[first + 1 :]:
        del files[name]
    return f"{names[first]}@{at}"


def delete_file(rng: Random, files: TrailFiles) -> str:
    name = rng.choice([name for name in trail_files(files) if files[name]])
    del files[name]
    return name


def swap_files(rng: Random, files: TrailFiles) -> str | None:
    names = trail_files(files)
    if len(names) < 2:
        return None
    one, other = rng.sample(names, 2)
    files[one], files[other] = files[other], files[one]
    return f"{one}, {other}"


# --- by somebody who knows how it is made ----------------------------------------------------------------------------


def edit_with_right_hash(rng: Random, files: TrailFiles) -> str:
    """Another value in a record, with the right hash for it; the rest stays."""
    name, found, at = _random_line(rng, files)
    found[at] = _forged(found[at], rng, None)
    _store_lines(files, name, found)
    return f"{name}:{at + 1}"


def insert_with_right_hash(rng: Random, files: TrailFiles) -> str:
    """A record that nobody wrote, in the chain at its place, with the right hash."""
    name, found, at = _random_line(rng, files)
    found.insert(at, _forged(found[at], rng, None))
    _store_lines(files, name, found)
    return f"{name}:{at + 1}"


def rewrite_from_record(rng: Random, files: TrailFiles) -> str:
    """A record is changed or left out, and everything after it is numbered and sealed anew."""
    names = trail_files(files)
    flat = [(name, line) for name in names for line in split_lines(files[name])]
    at = rng.randrange(len(flat))
    leaves_out = rng.random() < 0.5 and len(flat) > 1
    kept = flat[:at] + (flat[at + 1 :] if leaves_out else flat[at:])
    n, hash = (_record_number(kept[at - 1][1]), _record_hash(kept[at - 1][1])) if at else (0, records.GENESIS_HASH)
    made = [line for _, line in kept[:at]]
    for index, (_, line) in enumerate(kept[at:]):
        n += 1
        made.append(_forged(line, rng if index == 0 and not leaves_out else None, (n, hash)))
        hash = _record_hash(made[-1])
    for name in names:
        _store_lines(files, name, [line for (owner, _), line in zip(kept, made, strict=True) if owner == name])
    return f"record {at + 1} on"


def _forged(line: bytes, rng: Random | None, place: tuple[int, str] | None) -> bytes:
    """The record with another outcome (``rng``) or at another place of the chain, sealed as the writer does."""
    body = json.loads(line)
    del body["hash"]
    if rng is not None:
        body["outcome"] = f"forged {rng.randrange(10**9)}"
    if place is not None:
        body["n"], body["prev"] = place
    data = json.dumps(body, separators=(",", ":")).encode()
    return data[:-1] + f',"hash":"{sha256(data).hexdigest()}"}}\n'.encode()


def _record_number(line: bytes) -> int:
    return int(json.loads(line)["n"])


def _record_hash(line: bytes) -> str:
    return str(json.loads(line)["hash"])


# --- the checkpoints -------------------------------------------------------------------------------------------------


def edit_checkpoint(rng: Random, files: TrailFiles) -> str:
    """An octet of a checkpoint is another one now."""
    data = bytearray(files[CHECKPOINT_FILE])
    at = rng.randrange(len(data))
    data[at] ^= 1 << rng.randrange(8)
    files[CHECKPOINT_FILE] = bytes(data)
    return f"{CHECKPOINT_FILE}@{at}"


def delete_checkpoint(rng: Random, files: TrailFiles) -> str | None:
    """A checkpoint that is not the newest."""
    found = split_lines(files[CHECKPOINT_FILE])
    if len(found) < 2:
        return None
    at = rng.randrange(len(found) - 1)
    del found[at]
    _store_lines(files, CHECKPOINT_FILE, found)
    return f"{CHECKPOINT_FILE}:{at + 1}"


def forge_checkpoints(rng: Random, files: TrailFiles) -> str:
    """The trail is written anew, and all checkpoints with it, under another key."""
    where = rewrite_from_record(rng, files)
    hashes = {
        _record_number(line): _record_hash(line) for name in trail_files(files) for line in split_lines(files[name])
    }
    last = max(hashes)
    made, mac, key = [], records.GENESIS_HASH, rng.randbytes(32)
    for line in split_lines(files[CHECKPOINT_FILE]):
        old = json.loads(line)
        n = min(old["n"], last)
        line, mac = records.encode_checkpoint(old["checkpoint"], (n, hashes[n]), mac, old["time_ms"], key)
        made.append(line)
    _store_lines(files, CHECKPOINT_FILE, made)
    return f"{where}, and all checkpoints"


TAMPERINGS: dict[str, TamperFunction] = {
    "bits flipped": flip_bits,
    "edit": edit,
    "deletion": delete,
    "swap": swap,
    "insertion": insert,
    "cut": truncate,
    "file lost": delete_file,
    "files swapped": swap_files,
    "edit with a right hash": edit_with_right_hash,
    "insertion with a right hash": insert_with_right_hash,
    "written anew from a record on": rewrite_from_record,
    "checkpoint edited": edit_checkpoint,
    "checkpoint deleted": delete_checkpoint,
    "all written anew under another key": forge_checkpoints,
}
