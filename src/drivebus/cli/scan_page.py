"""A scan for people and programs: the bar while it runs, what it found, and what it would ask."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli import voice
from drivebus.cli.exits import Exit
from drivebus.cli.progress import Bar, duration

if TYPE_CHECKING:
    from drivebus.commissioning.scan import Found, Overheard, Progress
    from drivebus.commissioning.scan_plan import Pass


class Meter(Bar):
    """The bar of a scan; what is found is told above it at once."""

    def __init__(self) -> None:
        super().__init__()
        self._told = 0

    def __enter__(self) -> Meter:
        super().__enter__()
        return self

    def tell(self, progress: Progress) -> None:
        """The scan moved on."""
        for found in progress.found[self._told :]:
            self.line(voice.say("scan.found", **_words(found)))
        self._told = len(progress.found)
        if progress.address is not None:
            where = f"{progress.settings} {progress.kind[0]}/{progress.kind[1]} {progress.address:3d}"
            self.move(where, progress.done_s, progress.total_s)


def _words(found: Found) -> dict[str, Any]:
    return {
        "models": "/".join(found.models),
        "address": found.address,
        "settings": str(found.settings),
        "encoding": found.encoding,
    }


def show(link: str, progress: Progress, overheard: Overheard | None, code: Exit) -> Exit:
    voice.document(
        {
            "link": link,
            "overheard": None
            if overheard is None
            else {
                "bytes": overheard.count,
                "marks": overheard.marks,
                "first": overheard.first,
                "seconds": overheard.seconds,
            },
            "found": [as_document(found) for found in progress.found],
            "complete": code in (Exit.DONE, Exit.REFUSED) and progress.left_s < 1e-6,
            "asked_s": round(progress.done_s, 3),
        }
    )
    if progress.found or progress.done_s > 0:
        voice.show(_table(progress.found))
    return code


def as_document(found: Found) -> dict[str, Any]:
    """One find as JSON."""
    return {
        "models": list(found.models),
        "family": found.family,
        "encoding": found.encoding,
        "address": found.address,
        "baud": found.settings.baud,
        "format": found.settings.format,
        "doubtful": found.doubtful,
        "sent": found.exchange[0],
        "received": found.exchange[1],
    }


def _table(found: list[Found]) -> str:
    if not found:
        return voice.say("scan.nobody")
    head = [voice.say(f"scan.{name}") for name in ("address", "model", "encoding", "line", "note")]
    rows = [
        [
            str(one.address),
            " / ".join(one.models),
            one.encoding,
            str(one.settings),
            voice.say("scan.doubtful") if one.doubtful else "",
        ]
        for one in found
    ]
    return voice.grid(head, rows)


def show_plan(passes: list[Pass]) -> Exit:
    """The first question of each pass, byte for byte, and how often it would be asked."""
    from drivebus.cli.dry import plan as plan_frames
    from drivebus.commissioning.scan_plan import probe
    from drivebus.drives.make import make_dialect

    documents = []
    for one in passes:
        candidate = one.candidates[0]
        if not one.addresses:
            continue
        dialect = make_dialect(candidate.profile, one.addresses[0], encoding=candidate.encoding)
        frame = plan_frames("scan", [probe(dialect)], dialect.link.codec, dialect.link.timing, one.settings)[0]
        where = {"line": str(one.settings), "family": candidate.profile.family, "encoding": candidate.encoding}
        documents.append(where | {"questions": one.questions, "seconds": round(one.seconds, 3)} | frame.as_document())
        voice.tell("scan.pass", hex=voice.plain(frame.data), time=duration(one.seconds), count=one.questions, **where)
    total = sum(one.seconds for one in passes)
    voice.document({"dry_run": True, "passes": documents, "seconds": round(total, 3)})
    voice.tell("scan.total", time=duration(total))
    return Exit.DONE
