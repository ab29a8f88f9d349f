"""``audit``: audit trails of the real writer, manipulated afterwards.

``verify`` must find each manipulation. Manipulations that it cannot find (records after the last checkpoint cut off,
or everything rolled back together with the head) are tried too, and counted.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from drivebus.service.audit import records
from drivebus.service.audit.chain import AuditChain, AuditPaths
from drivebus.service.audit.records import AuditEntry, entry_json
from drivebus.service.audit.verify import AuditReport, verify
from verification.campaign import Campaign, CampaignRun

# --- manipulations ----------------------------------------------------------------------------------------------------

TrailFiles = dict[str, bytes]
CHECKPOINT_FILE = "checkpoints.jsonl"
TamperFunction = Callable[[Random, TrailFiles], str | None]


def split_lines(data: bytes) -> list[bytes]:
    return data.splitlines(keepends=True)


def trail_files(files: TrailFiles) -> list[str]:
    """Return the names of the trail's files, in order, without the checkpoints."""
    return sorted((name for name in files if name != CHECKPOINT_FILE), key=lambda name: (name == "audit.jsonl", name))


def _random_line(rng: Random, files: TrailFiles) -> tuple[str, list[bytes], int]:
    name = rng.choice([name for name in trail_files(files) if files[name]])
    found = split_lines(files[name])
    return name, found, rng.randrange(len(found))


def _store_lines(files: TrailFiles, name: str, found: list[bytes]) -> None:
    files[name] = b"".join(found)


# --- without knowledge of the format ----------------------------------------------------------------------------------


def flip_bits(rng: Random, files: TrailFiles) -> str:
    """Flip one to eight bits anywhere."""
    name = rng.choice([name for name in trail_files(files) if files[name]])
    data = bytearray(files[name])
    for _ in range(rng.randint(1, 8)):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    files[name] = bytes(data)
    return name


def edit(rng: Random, files: TrailFiles) -> str:
    """Replace up to five octets of a line by three others."""
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
    """Insert a copy of a line, an empty line or an empty record."""
    name, found, at = _random_line(rng, files)
    found.insert(rng.randrange(len(found) + 1), rng.choice((found[at], b"\n", b"{}\n")))
    _store_lines(files, name, found)
    return name


def truncate(rng: Random, files: TrailFiles) -> str:
    """Cut everything from a random octet on, and remove the files after it."""
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


# --- with knowledge of the format -------------------------------------------------------------------------------------


def edit_with_right_hash(rng: Random, files: TrailFiles) -> str:
    """Change a value of a record and compute its hash again; the rest stays."""
    name, found, at = _random_line(rng, files)
    found[at] = _forged(found[at], rng, None)
    _store_lines(files, name, found)
    return f"{name}:{at + 1}"


def insert_with_right_hash(rng: Random, files: TrailFiles) -> str:
    """Insert a forged record with a correct hash."""
    name, found, at = _random_line(rng, files)
    found.insert(at, _forged(found[at], rng, None))
    _store_lines(files, name, found)
    return f"{name}:{at + 1}"


def rewrite_from_record(rng: Random, files: TrailFiles) -> str:
    """Change or remove a record, and number and hash all records after it again."""
    names = trail_files(files)
    flat = [(name, line) for name in names for line in split_lines(files[name])]
    at = rng.randrange(len(flat))
    leaves_out = rng.random() < 0.5 and len(flat) > 1
    remaining = flat[:at] + (flat[at + 1 :] if leaves_out else flat[at:])
    n, hash = (
        (_record_number(remaining[at - 1][1]), _record_hash(remaining[at - 1][1])) if at else (0, records.GENESIS_HASH)
    )
    made = [line for _, line in remaining[:at]]
    for index, (_, line) in enumerate(remaining[at:]):
        n += 1
        made.append(_forged(line, rng if index == 0 and not leaves_out else None, (n, hash)))
        hash = _record_hash(made[-1])
    for name in names:
        _store_lines(files, name, [line for (owner, _), line in zip(remaining, made, strict=True) if owner == name])
    return f"record {at + 1} on"


def _forged(line: bytes, rng: Random | None, place: tuple[int, str] | None) -> bytes:
    """Return the record with another outcome (``rng``) or at another place of the chain, hashed as the writer does."""
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
    """Flip a bit of a checkpoint."""
    data = bytearray(files[CHECKPOINT_FILE])
    at = rng.randrange(len(data))
    data[at] ^= 1 << rng.randrange(8)
    files[CHECKPOINT_FILE] = bytes(data)
    return f"{CHECKPOINT_FILE}@{at}"


def delete_checkpoint(rng: Random, files: TrailFiles) -> str:
    found = split_lines(files[CHECKPOINT_FILE])
    at = rng.randrange(len(found))
    del found[at]
    _store_lines(files, CHECKPOINT_FILE, found)
    return f"{CHECKPOINT_FILE}:{at + 1}"


def roll_back(rng: Random, files: TrailFiles) -> str:
    """Remove the newest checkpoints and all records after the last one left, or every file."""
    found = split_lines(files[CHECKPOINT_FILE])
    kept = found[: rng.randrange(len(found))]
    last = json.loads(kept[-1])["n"] if kept else 0
    for name in trail_files(files):
        _store_lines(files, name, [line for line in split_lines(files[name]) if _record_number(line) <= last])
        if not files[name]:
            del files[name]
    _store_lines(files, CHECKPOINT_FILE, kept)
    return f"{CHECKPOINT_FILE}:{len(kept) + 1}, record {last + 1}"


def forge_checkpoints(rng: Random, files: TrailFiles) -> str:
    """Rewrite the trail and all its checkpoints under another key."""
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
    "rewritten from a record on": rewrite_from_record,
    "checkpoint edited": edit_checkpoint,
    "checkpoint deleted": delete_checkpoint,
    "rolled back": roll_back,
    "everything rewritten under another key": forge_checkpoints,
}


# --- campaign ---------------------------------------------------------------------------------------------------------

CHANGES_PER_TRAIL = 200
"""Manipulations of one trail before the next one is written."""
AUDITED_ACTIONS = ("drive.run", "drive.stop", "parameters.write", "login", "waiver.grant", "configuration.reload")
RECORDS_PER_FILE = 4_000


class AuditTrailTrial:
    """Audit trail in a folder, and its files as the writer left them."""

    def __init__(self, campaign_run: CampaignRun, number: int, folder: Path) -> None:
        self.campaign_run, self.rng = campaign_run, campaign_run.rng("trail", number)
        self.paths = AuditPaths.of(folder / "plant")
        self.paths.key.write_bytes(self.rng.randbytes(32).hex().encode())
        self._write(self.rng.randint(1, 60))
        self.files: TrailFiles = {
            path.name: path.read_bytes() for path in (*self.paths.files(), self.paths.checkpoints)
        }

    def _write(self, count: int) -> None:
        now_ms = 1_795_219_200_000

        def clock() -> int:
            nonlocal now_ms
            now_ms += self.rng.randint(1, 10_000)
            return now_ms

        chain = AuditChain(self.paths, clock, RECORDS_PER_FILE)
        chain.open()
        while count > 0:
            batch = min(count, self.rng.choice((1, 1, 2, 5)))
            chain.append([entry_json(_entry(self.rng), clock()) for _ in range(batch)])
            count -= batch
            if self.rng.random() < 0.2:
                chain.write_checkpoint()
        chain.write_checkpoint()
        chain.write_head()
        chain.close()

    def verify_files(self, files: TrailFiles) -> AuditReport:
        """Return the result of ``verify`` for these files."""
        self._write_files(files)
        return verify(self.paths)

    def _write_files(self, files: TrailFiles) -> None:
        for name in {*self.files, *files}:
            path = self.paths.folder / name
            if name in files:
                path.write_bytes(files[name])
            else:
                path.unlink(missing_ok=True)

    # --- one change ------------------------------------------------------------------------------------------------

    def try_tampering(self, name: str) -> None:
        """Manipulate the trail in one way; a manipulation that ``verify`` misses is a violation."""
        files = dict(self.files)
        where = TAMPERINGS[name](self.rng, files)
        if where is None or _same(files, self.files):
            self.campaign_run.count("nothing changed, repeated")
            return
        report = self.verify_files(files)
        self.campaign_run.add_trials()
        kinds = sorted({problem.kind for problem in report.problems})
        self.campaign_run.trace(f"{name} at {where}: {', '.join(kinds)}")
        self.campaign_run.count(name)
        if report.ok:
            self.campaign_run.violation(f"{name} at {where} was not found (seed {self.campaign_run.seed})")

    def check_untampered(self) -> None:
        """Check that ``verify`` accepts the unchanged trail."""
        report = self.verify_files(self.files)
        if not report.ok:
            self.campaign_run.violation(f"an unchanged trail is reported as changed: {report.problems[0]}")

    def count_undetectable(self) -> None:
        """Count manipulations that ``verify`` cannot detect: all files rolled back together with the head."""
        files, head = dict(self.files), self.paths.head.read_bytes()
        where = roll_back(self.rng, files)
        kept = split_lines(files[CHECKPOINT_FILE])
        if kept:
            self.paths.head.write_bytes(kept[-1])
            word = "not found" if self.verify_files(files).ok else "found"
            self.campaign_run.trace(f"rolled back with the head at {where}: {word}")
            self.campaign_run.count(f"undetectable: rolled back together with the head, {word}")
        self.paths.head.write_bytes(head)


def _same(files: TrailFiles, other: TrailFiles) -> bool:
    """Return whether two trails have the same records; an empty file counts as absent."""
    return {name: data for name, data in files.items() if data} == {name: data for name, data in other.items() if data}


def _entry(rng: Random) -> AuditEntry:
    drive, frame = f"fan-{rng.randrange(9)}", rng.randbytes(8).hex(" ").upper()
    return AuditEntry(
        what=rng.choice(AUDITED_ACTIONS),
        who=rng.choice(("li", "wang", "ann\x1b[31m")),
        session=f"s-{rng.randrange(99)}",
        address="127.0.0.1",
        target=drive,
        params={"frequency_hz": rng.uniform(0, 50)},
        frames=[{"sent": frame}] * rng.randrange(3),
        outcome=rng.choice(("requested", "confirmed")),
    )


def run(campaign_run: CampaignRun) -> None:
    number = 0
    while campaign_run.remaining:
        with TemporaryDirectory() as folder:
            trail = AuditTrailTrial(campaign_run, number, Path(folder))
            trail.check_untampered()
            trail.count_undetectable()
            for index in range(min(CHANGES_PER_TRAIL, campaign_run.remaining)):
                trail.try_tampering([*TAMPERINGS][index % len(TAMPERINGS)])
        number += 1
    campaign_run.figures["trails"] = number


CAMPAIGN = Campaign(
    name="audit",
    summary={"en": "Audit trails manipulated afterwards.", "zh": "事后被改动的审计记录。"},
    unit="changes",
    evidence_for=(),
    full_budget=10_000,
    ci_budget=280,
    run=run,
)
