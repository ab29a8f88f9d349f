"""``audit verify``, ``audit list``: the trail of a plant as it lies on disk; no service is needed or disturbed."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, voice
from drivebus.cli.command import Argument, LazyGroup, Option, Verb
from drivebus.cli.exits import Exit
from drivebus.errors import ConfigurationError

if TYPE_CHECKING:
    from drivebus.plant.audit.files import Places
    from drivebus.plant.model import AuditSetting

EVER_MS = 253_402_300_799_999


def _verify(plant: str | None, checkpoints: str | None, key: str | None) -> Exit:
    from drivebus.plant.audit.verify import verify

    places = _places(plant, checkpoints, key)
    with _readable(places.folder):
        report = verify(places)
    voice.document(report.as_json())
    for problem in report.as_json()["problems"]:
        voice.tell("audit.verb.problem", text=problem["text"][voice.language()])
    told = {"entries": report.entries, "checkpoints": report.checkpoints, "covered": report.covered}
    voice.tell("audit.verb.whole" if report.ok else "audit.verb.found", found=report.found, **told)
    if not report.keyed:
        voice.note("audit.verb.no_key", key=places.key)
    return Exit.DONE if report.ok else Exit.REFUSED


def _list(plant: str | None, drive: str | None, limit: int) -> Exit:
    from drivebus.plant.audit.listing import listed

    places = _places(plant, None, None)
    with _readable(places.folder):
        found = listed(places, 0, EVER_MS, drive, None, limit)
    voice.document(found)
    head = [voice.say(f"audit.verb.head.{name}") for name in ("n", "time", "who", "what", "target", "outcome")]
    voice.show(voice.grid(head, [_row(item) for item in found["items"]]))
    return Exit.DONE


def _row(item: dict[str, Any]) -> list[str]:
    time = datetime.fromtimestamp(item["time_ms"] / 1000, UTC).isoformat(sep=" ", timespec="milliseconds")
    cells = (item["n"], time, item["who"]["name"], item["what"], item["target"], item["outcome"] or "")
    return [visible(str(cell)) for cell in cells]


def visible(text: str) -> str:
    r"""Control characters, terminal escapes and what turns the direction of writing stand as ``\x1b`` (S13)."""
    return "".join(
        one.encode("unicode_escape").decode() if unicodedata.category(one)[0] in "CZ" and one != " " else one
        for one in text
    )


def _places(plant: str | None, checkpoints: str | None, key: str | None) -> Places:
    """Of a plant's file, of a state directory, or of the only plant that this user has. Raises ConfigurationError."""
    from drivebus.plant.audit.files import Places

    folder, kept = _kept(plant)
    places = Places.of(folder, Path(checkpoints) if checkpoints else kept.checkpoints, Path(key) if key else kept.key)
    if not places.folder.is_dir():
        raise ConfigurationError("audit.verb.none", folder=str(folder))
    return places


def _kept(plant: str | None) -> tuple[Path, AuditSetting]:
    """The state directory, and what the plant's file says of the second file and the key."""
    from drivebus.plant.model import AuditSetting

    if plant is None:
        from drivebus.plant.config.build import state_directory

        plants = state_directory("x").parent
        found = sorted(one for one in plants.iterdir() if one.is_dir()) if plants.is_dir() else []
        if len(found) != 1:
            raise ConfigurationError("audit.verb.which", plants=", ".join(one.name for one in found) or "-")
        return found[0], AuditSetting()
    if Path(plant).suffix != ".toml":
        return Path(plant), AuditSetting()
    from drivebus.plant.config.load import load

    setting = load(plant)
    return setting.directory, setting.audit


@contextmanager
def _readable(folder: Path) -> Iterator[None]:
    """A file that is there and can't be read is the user's to mend."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise ConfigurationError("audit.verb.unreadable", folder=str(folder), reason=reason) from error


def _argument() -> Argument:
    return Argument(["plant"], metavar="[PLANT.toml|DIRECTORY]", required=False, key="help.argument.audit")


verify = Verb(
    "verify",
    topic="audit.verify",
    callback=_verify,
    params=[
        _argument(),
        Option(["--checkpoints"], metavar="FILE", example="--checkpoints /mnt/worm/checkpoints.jsonl"),
        Option(["--key"], metavar="FILE", key="help.option.audit_key", example="--key /root/hall.audit.key"),
    ],
    examples=(
        "drivebus audit verify plant.toml",
        "drivebus audit verify /var/lib/drivebus/plants/hall --key /root/hall.audit.key --json",
    ),
)

list_ = Verb(
    "list",
    topic="audit.list",
    callback=_list,
    params=[
        _argument(),
        Option(["--drive"], metavar="ID", key="help.option.audit_drive", example="--drive fan-1"),
        Option(
            ["--limit"],
            type=options.Number(1, 100_000),
            default=50,
            metavar="N",
            key="help.option.audit_limit",
            example="--limit 500",
        ),
    ],
    examples=("drivebus audit list plant.toml --drive fan-1", "drivebus audit list plant.toml --limit 500 --json"),
)

command = LazyGroup(
    "audit",
    topic="audit",
    sections={
        "cli.section.audit": {
            "verify": "drivebus.cli.verbs.audit:verify",
            "list": "drivebus.cli.verbs.audit:list_",
        }
    },
    no_args_is_help=True,
    examples=("drivebus audit verify plant.toml", "drivebus audit list plant.toml --drive fan-1"),
)
