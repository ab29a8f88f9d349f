"""``audit`` (S12): audit trails that the real writer made, changed afterwards in every way that we can think of.

Each change must be found by ``verify``. Beside it, what it can't find is tried too and only counted: what is cut off
behind the last checkpoint, and the newest checkpoint itself.
"""

from __future__ import annotations

from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.outside import tampering
from drivebus.lab.outside.tampering import MARKS, TAMPERS, Files
from drivebus.plant.audit.chain import Chain
from drivebus.plant.audit.entry import Entry, told
from drivebus.plant.audit.files import Places
from drivebus.plant.audit.verify import Report, verify

A_TRAIL = 200
"""Changes of one trail, before another one is made."""
WORDS = ("drive.run", "drive.stop", "parameters.write", "login", "drive.waiver", "configuration.reload")
FULL_AT = 4_000


class Trail:
    """One trail in a folder of its own, and its files' bytes as they were written."""

    def __init__(self, session: Session, number: int, folder: Path) -> None:
        self.session, self.rng = session, session.rng("trail", number)
        self.places = Places.of(folder / "plant")
        self.places.key.write_bytes(self.rng.randbytes(32).hex().encode())
        self._write(self.rng.randint(1, 60))
        self.files: Files = {path.name: path.read_bytes() for path in (*self.places.files(), self.places.checkpoints)}

    def _write(self, count: int) -> None:
        now_ms = 1_795_219_200_000

        def clock() -> int:
            nonlocal now_ms
            now_ms += self.rng.randint(1, 10_000)
            return now_ms

        chain = Chain(self.places, clock, FULL_AT)
        chain.open()
        while count > 0:
            batch = min(count, self.rng.choice((1, 1, 2, 5)))
            chain.append([told(_entry(self.rng), clock()) for _ in range(batch)])
            count -= batch
            if self.rng.random() < 0.2:
                chain.mark()
        chain.mark()
        chain.close()

    def tried(self, files: Files) -> Report:
        """What ``verify`` says of these files."""
        self._lay(files)
        return verify(self.places)

    def _lay(self, files: Files) -> None:
        for name in {*self.files, *files}:
            path = self.places.folder / name
            if name in files:
                path.write_bytes(files[name])
            else:
                path.unlink(missing_ok=True)

    # --- one change ------------------------------------------------------------------------------------------------

    def change(self, name: str) -> None:
        """In one way; found, or a violation."""
        files = dict(self.files)
        where = TAMPERS[name](self.rng, files)
        if where is None or _same(files, self.files):
            self.session.count("nothing changed, tried again")
            return
        report = self.tried(files)
        self.session.did()
        kinds = sorted({problem.kind for problem in report.problems})
        self.session.line(f"{name} at {where}: {', '.join(kinds)}")
        self.session.count(name)
        if report.ok:
            self.session.violation(f"S12 {name} at {where} is not found (seed {self.session.seed})")

    def whole(self) -> None:
        """Nothing is found where nothing was changed."""
        report = self.tried(self.files)
        if not report.ok:
            self.session.violation(f"S12 a trail that nobody changed is called changed: {report.problems[0]}")

    def unseen(self) -> None:
        """What nobody can find."""
        files = dict(self.files)
        found = tampering.lines(files[MARKS])
        files[MARKS] = b"".join(found[:-1])
        report = self.tried(files)
        word = "found" if not report.ok else "not found: fewer records are vouched for"
        self.session.count(f"beyond what can be found: the newest checkpoint taken away, {word}")
        if report.covered >= _last(self.files):
            self.session.violation("S12 a checkpoint that is gone still vouches for its record")
        if report.ok and report.covered < _last(self.files):
            self._tail(files)

    def _tail(self, files: Files) -> None:
        """Records behind the last checkpoint, cut off at a line's end."""
        name = tampering.trail(files)[-1]
        found = tampering.lines(files[name])
        if found:
            files[name] = b"".join(found[:-1])
            word = "not found" if self.tried(files).ok else "found"
            self.session.count(f"beyond what can be found: the last record cut off behind the last checkpoint, {word}")


def _same(one: Files, other: Files) -> bool:
    """A file without a line tells nothing, whether it is there or not."""
    return {name: data for name, data in one.items() if data} == {name: data for name, data in other.items() if data}


def _last(files: Files) -> int:
    return sum(len(tampering.lines(files[name])) for name in tampering.trail(files))


def _entry(rng: Random) -> Entry:
    drive, frame = f"fan-{rng.randrange(9)}", rng.randbytes(8).hex(" ").upper()
    return Entry(
        rng.choice(WORDS), rng.choice(("li", "wang", "ann\x1b[31m")), f"s-{rng.randrange(99)}", "127.0.0.1", drive,
        {"frequency_hz": rng.uniform(0, 50)}, [{"sent": frame}] * rng.randrange(3), rng.choice(("asked", "confirmed")),
    )  # fmt: skip


def run(session: Session) -> None:
    number = 0
    while session.left:
        with TemporaryDirectory() as folder:
            trail = Trail(session, number, Path(folder))
            trail.whole()
            trail.unseen()
            for index in range(min(A_TRAIL, session.left)):
                trail.change([*TAMPERS][index % len(TAMPERS)])
        number += 1
    session.figures["trails"] = number


CAMPAIGN = Campaign("audit", "changes", ("S12",), 10_000, 280, run, "audit-tamper")
