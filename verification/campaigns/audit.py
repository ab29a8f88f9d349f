"""``audit``: audit trails that the real writer made, changed afterwards in every way that we can think of.

Each change must be found by ``verify``. Beside it, what it can't find is tried too and only counted: what is cut off
behind the last checkpoint, and the newest checkpoint itself.
"""

from __future__ import annotations

from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from drivebus.service.audit.chain import AuditChain, AuditPaths
from drivebus.service.audit.records import AuditEntry, entry_json
from drivebus.service.audit.verify import AuditReport, verify
from verification.campaign import Campaign, CampaignRun
from verification.security import audit_tampering
from verification.security.audit_tampering import CHECKPOINT_FILE, TAMPERINGS, TrailFiles

CHANGES_PER_TRAIL = 200
"""Changes of one trail, before another one is made."""
AUDITED_ACTIONS = ("drive.run", "drive.stop", "parameters.write", "login", "waiver.grant", "configuration.reload")
RECORDS_PER_FILE = 4_000


class AuditTrailTrial:
    """One trail in a folder of its own, and its files' bytes as they were written."""

    def __init__(self, session: CampaignRun, number: int, folder: Path) -> None:
        self.session, self.rng = session, session.rng("trail", number)
        self.places = AuditPaths.of(folder / "plant")
        self.places.key.write_bytes(self.rng.randbytes(32).hex().encode())
        self._write(self.rng.randint(1, 60))
        self.files: TrailFiles = {
            path.name: path.read_bytes() for path in (*self.places.files(), self.places.checkpoints)
        }

    def _write(self, count: int) -> None:
        now_ms = 1_795_219_200_000

        def clock() -> int:
            nonlocal now_ms
            now_ms += self.rng.randint(1, 10_000)
            return now_ms

        chain = AuditChain(self.places, clock, RECORDS_PER_FILE)
        chain.open()
        while count > 0:
            batch = min(count, self.rng.choice((1, 1, 2, 5)))
            chain.append([entry_json(_entry(self.rng), clock()) for _ in range(batch)])
            count -= batch
            if self.rng.random() < 0.2:
                chain.write_checkpoint()
        chain.write_checkpoint()
        chain.close()

    def verify_files(self, files: TrailFiles) -> AuditReport:
        """What ``verify`` says of these files."""
        self._write_files(files)
        return verify(self.places)

    def _write_files(self, files: TrailFiles) -> None:
        for name in {*self.files, *files}:
            path = self.places.folder / name
            if name in files:
                path.write_bytes(files[name])
            else:
                path.unlink(missing_ok=True)

    # --- one change ------------------------------------------------------------------------------------------------

    def try_tampering(self, name: str) -> None:
        """In one way; found, or a violation."""
        files = dict(self.files)
        where = TAMPERINGS[name](self.rng, files)
        if where is None or _same(files, self.files):
            self.session.count("nothing changed, tried again")
            return
        report = self.verify_files(files)
        self.session.add_trials()
        kinds = sorted({problem.kind for problem in report.problems})
        self.session.trace(f"{name} at {where}: {', '.join(kinds)}")
        self.session.count(name)
        if report.ok:
            self.session.violation(f"S12 {name} at {where} is not found (seed {self.session.seed})")

    def check_untampered(self) -> None:
        """Nothing is found where nothing was changed."""
        report = self.verify_files(self.files)
        if not report.ok:
            self.session.violation(f"S12 a trail that nobody changed is called changed: {report.problems[0]}")

    def count_undetectable(self) -> None:
        """What nobody can find."""
        files = dict(self.files)
        found = audit_tampering.split_lines(files[CHECKPOINT_FILE])
        files[CHECKPOINT_FILE] = b"".join(found[:-1])
        report = self.verify_files(files)
        word = "found" if not report.ok else "not found: fewer records are vouched for"
        self.session.count(f"beyond what can be found: the newest checkpoint taken away, {word}")
        if report.covered >= _last(self.files):
            self.session.violation("S12 a checkpoint that is gone still vouches for its record")
        if report.ok and report.covered < _last(self.files):
            self._cut_last_record(files)

    def _cut_last_record(self, files: TrailFiles) -> None:
        """Records behind the last checkpoint, cut off at a line's end."""
        name = audit_tampering.trail_files(files)[-1]
        found = audit_tampering.split_lines(files[name])
        if found:
            files[name] = b"".join(found[:-1])
            word = "not found" if self.verify_files(files).ok else "found"
            self.session.count(f"beyond what can be found: the last record cut off behind the last checkpoint, {word}")


def _same(one: TrailFiles, other: TrailFiles) -> bool:
    """A file without a line tells nothing, whether it is there or not."""
    return {name: data for name, data in one.items() if data} == {name: data for name, data in other.items() if data}


def _last(files: TrailFiles) -> int:
    return sum(len(audit_tampering.split_lines(files[name])) for name in audit_tampering.trail_files(files))


def _entry(rng: Random) -> AuditEntry:
    drive, frame = f"fan-{rng.randrange(9)}", rng.randbytes(8).hex(" ").upper()
    return AuditEntry(
        rng.choice(AUDITED_ACTIONS),
        rng.choice(("li", "wang", "ann\x1b[31m")),
        f"s-{rng.randrange(99)}",
        "127.0.0.1",
        drive,
        {"frequency_hz": rng.uniform(0, 50)},
        [{"sent": frame}] * rng.randrange(3),
        rng.choice(("requested", "confirmed")),
    )


def run(session: CampaignRun) -> None:
    number = 0
    while session.remaining:
        with TemporaryDirectory() as folder:
            trail = AuditTrailTrial(session, number, Path(folder))
            trail.check_untampered()
            trail.count_undetectable()
            for index in range(min(CHANGES_PER_TRAIL, session.remaining)):
                trail.try_tampering([*TAMPERINGS][index % len(TAMPERINGS)])
        number += 1
    session.figures["trails"] = number


CAMPAIGN = Campaign(
    name="audit",
    summary={"en": "Audit trails changed afterwards.", "zh": "事后被改动的审计记录。"},
    unit="changes",
    evidence_for=(),
    full_budget=10_000,
    ci_budget=280,
    run=run,
    report="audit-tamper",
)
