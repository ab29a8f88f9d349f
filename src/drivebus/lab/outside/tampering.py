"""What somebody may do to an audit trail that lies on a disk: by accident, by hand, or knowing exactly how it is made.

A trail is its files' bytes by name. Each function changes some of them and says where; None where there was nothing to
change there. Whoever knows the format computes hashes anew as the writer does; the key of the checkpoints he lacks.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from hashlib import sha256
from random import Random

from drivebus.plant.audit import seal

Files = dict[str, bytes]
MARKS = "checkpoints.jsonl"
Tamper = Callable[[Random, Files], str | None]


def lines(data: bytes) -> list[bytes]:
    return data.splitlines(keepends=True)


def trail(files: Files) -> list[str]:
    """The trail's own files, in order."""
    return sorted((name for name in files if name != MARKS), key=lambda name: (name == "audit.jsonl", name))


def _place(rng: Random, files: Files) -> tuple[str, list[bytes], int]:
    name = rng.choice([name for name in trail(files) if files[name]])
    found = lines(files[name])
    return name, found, rng.randrange(len(found))


def _put(files: Files, name: str, found: list[bytes]) -> None:
    files[name] = b"".join(found)


# --- by accident or by hand ------------------------------------------------------------------------------------------


def flip_bits(rng: Random, files: Files) -> str:
    """One to eight bits anywhere."""
    name = rng.choice([name for name in trail(files) if files[name]])
    data = bytearray(files[name])
    for _ in range(rng.randint(1, 8)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    files[name] = bytes(data)
    return name


def edit(rng: Random, files: Files) -> str:
    """Some octets of a line are others now, or more, or fewer."""
    name, found, at = _place(rng, files)
    line = found[at]
    start = rng.randrange(len(line))
    end = min(len(line), start + rng.randint(0, 5))
    found[at] = line[:start] + bytes(rng.choice(b'0123456789abcdef{}[]",: \n') for _ in range(3)) + line[end:]
    _put(files, name, found)
    return f"{name}:{at + 1}"


def delete(rng: Random, files: Files) -> str:
    name, found, at = _place(rng, files)
    del found[at : at + rng.choice((1, 1, 2, 5))]
    _put(files, name, found)
    return f"{name}:{at + 1}"


def swap(rng: Random, files: Files) -> str:
    name, found, at = _place(rng, files)
    other = rng.randrange(len(found))
    found[at], found[other] = found[other], found[at]
    _put(files, name, found)
    return f"{name}:{min(at, other) + 1}"


def insert(rng: Random, files: Files) -> str:
    """A line that was there already, or an empty one."""
    name, found, at = _place(rng, files)
    found.insert(rng.randrange(len(found) + 1), rng.choice((found[at], b"\n", b"{}\n")))
    _put(files, name, found)
    return name


def cut(rng: Random, files: Files) -> str:
    """Everything from some octet of the last file on, or from some file on."""
    names = trail(files)
    first = rng.randrange(len(names))
    at = rng.randrange(len(files[names[first]]) or 1)
    files[names[first]] = files[names[first]][:at]
    for name in names[first + 1 :]:
        del files[name]
    return f"{names[first]}@{at}"


def lose_file(rng: Random, files: Files) -> str:
    name = rng.choice([name for name in trail(files) if files[name]])
    del files[name]
    return name


def swap_files(rng: Random, files: Files) -> str | None:
    names = trail(files)
    if len(names) < 2:
        return None
    one, other = rng.sample(names, 2)
    files[one], files[other] = files[other], files[one]
    return f"{one}, {other}"


# --- by somebody who knows how it is made ----------------------------------------------------------------------------


def reseal(rng: Random, files: Files) -> str:
    """Another value in a record, with the right hash for it; the rest stays."""
    name, found, at = _place(rng, files)
    found[at] = _forged(found[at], rng, None)
    _put(files, name, found)
    return f"{name}:{at + 1}"


def insert_sealed(rng: Random, files: Files) -> str:
    """A record that nobody wrote, in the chain at its place, with the right hash."""
    name, found, at = _place(rng, files)
    found.insert(at, _forged(found[at], rng, None))
    _put(files, name, found)
    return f"{name}:{at + 1}"


def rewrite(rng: Random, files: Files) -> str:
    """A record is changed or left out, and everything after it is numbered and sealed anew."""
    names = trail(files)
    flat = [(name, line) for name in names for line in lines(files[name])]
    at = rng.randrange(len(flat))
    leaves_out = rng.random() < 0.5 and len(flat) > 1
    kept = flat[:at] + (flat[at + 1 :] if leaves_out else flat[at:])
    n, hash = (_number(kept[at - 1][1]), _hash(kept[at - 1][1])) if at else (0, seal.FIRST)
    made = [line for _, line in kept[:at]]
    for index, (_, line) in enumerate(kept[at:]):
        n += 1
        made.append(_forged(line, rng if index == 0 and not leaves_out else None, (n, hash)))
        hash = _hash(made[-1])
    for name in names:
        _put(files, name, [line for (owner, _), line in zip(kept, made, strict=True) if owner == name])
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


def _number(line: bytes) -> int:
    return int(json.loads(line)["n"])


def _hash(line: bytes) -> str:
    return str(json.loads(line)["hash"])


# --- the checkpoints -------------------------------------------------------------------------------------------------


def edit_mark(rng: Random, files: Files) -> str:
    """An octet of a checkpoint is another one now."""
    data = bytearray(files[MARKS])
    at = rng.randrange(len(data))
    data[at] ^= 1 << rng.randrange(8)
    files[MARKS] = bytes(data)
    return f"{MARKS}@{at}"


def delete_mark(rng: Random, files: Files) -> str | None:
    """A checkpoint that is not the newest."""
    found = lines(files[MARKS])
    if len(found) < 2:
        return None
    at = rng.randrange(len(found) - 1)
    del found[at]
    _put(files, MARKS, found)
    return f"{MARKS}:{at + 1}"


def forge_marks(rng: Random, files: Files) -> str:
    """The trail is written anew, and all checkpoints with it, under another key."""
    where = rewrite(rng, files)
    hashes = {_number(line): _hash(line) for name in trail(files) for line in lines(files[name])}
    last = max(hashes)
    made, mac, key = [], seal.FIRST, rng.randbytes(32)
    for line in lines(files[MARKS]):
        old = json.loads(line)
        n = min(old["n"], last)
        line, mac = seal.checkpoint_line(old["checkpoint"], (n, hashes[n]), mac, old["time_ms"], key)
        made.append(line)
    _put(files, MARKS, made)
    return f"{where}, and all checkpoints"


TAMPERS: dict[str, Tamper] = {
    "bits flipped": flip_bits, "edit": edit, "deletion": delete, "swap": swap, "insertion": insert, "cut": cut,
    "file lost": lose_file, "files swapped": swap_files, "edit with a right hash": reseal,
    "insertion with a right hash": insert_sealed, "written anew from a record on": rewrite,
    "checkpoint edited": edit_mark, "checkpoint deleted": delete_mark,
    "all written anew under another key": forge_marks,
}  # fmt: skip
