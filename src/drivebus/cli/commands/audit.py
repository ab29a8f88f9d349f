"""``audit``: verify and list the audit trail of a plant on disk, with or without a running service."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivebus.cli import options, output
from drivebus.cli.click_ext import Argument, CliCommand, LazyGroup, Option
from drivebus.cli.errors import ExitCode
from drivebus.errors import ConfigurationError, SystemReason

if TYPE_CHECKING:
    from drivebus.service.audit.chain import AuditPaths
    from drivebus.service.audit.description import Titles
    from drivebus.service.config.model import AuditConfig


def _verify(plant: str | None, checkpoints: str | None, key: str | None, head: str | None, at_least: int) -> ExitCode:
    from drivebus.service.audit.verify import verify

    places = _places(plant, checkpoints, key, head)
    with _readable_trail(places.folder):
        report = verify(places, at_least)
    output.print_json(report.as_json())
    for problem in report.as_json()["problems"]:
        output.print_message("audit.command.problem", text=problem["text"][output.language()])
    counts = {"entries": report.entries, "checkpoints": report.checkpoints, "covered": report.covered}
    output.print_message(
        "audit.command.whole" if report.ok else "audit.command.found", found=report.problem_count, **counts
    )
    if not report.keyed:
        output.print_note("audit.command.no_key", key=places.key)
    if not places.head.exists():
        output.print_note("audit.command.no_head", head=places.head)
    return ExitCode.DONE if report.ok else ExitCode.FAILED


def _list(plant: str | None, drive: str | None, limit: int) -> ExitCode:
    from drivebus.clock import MAX_TIME_MS
    from drivebus.service.audit.description import described
    from drivebus.service.audit.query import query_records

    places, titles = _places(plant), _titles(plant)
    with _readable_trail(places.folder):
        page = query_records(places, from_ms=0, to_ms=MAX_TIME_MS, drive=drive, cursor=None, limit=limit)
    items = [described(item, titles) for item in page["items"]]
    output.print_json(page | {"items": items})
    head = [output.text(f"audit.command.head.{name}") for name in ("n", "time", "who", "what", "outcome")]
    output.print_text(output.fitted_table(head, [_row(item) for item in items]))
    return ExitCode.DONE


def _row(item: dict[str, Any]) -> list[str]:
    time = datetime.fromtimestamp(item["time_ms"] / 1000, UTC).isoformat(sep=" ", timespec="milliseconds")
    language = output.language()
    outcome = item["outcome_text"][language] if item["outcome_text"] else ""
    cells = (item["n"], time, item["who"]["name"], item["text"][language], outcome)
    return [escape_control_characters(str(cell)) for cell in cells]


def escape_control_characters(text: str) -> str:
    r"""Write control characters, terminal escapes and direction marks as escapes such as ``\x1b``."""
    return "".join(
        char.encode("unicode_escape").decode() if unicodedata.category(char)[0] in "CZ" and char != " " else char
        for char in text
    )


def _places(
    plant: str | None, checkpoints: str | None = None, key: str | None = None, head: str | None = None
) -> AuditPaths:
    """Return the paths of a plant file, a state directory, or this user's only plant. Raises ConfigurationError."""
    from drivebus.service.audit.chain import AuditPaths

    folder, config = _state_directory(plant)
    places = AuditPaths.of(
        folder,
        Path(checkpoints) if checkpoints else config.checkpoints,
        Path(key) if key else config.key,
        Path(head) if head else config.head,
    )
    if not places.folder.is_dir():
        raise ConfigurationError("audit.command.none", folder=str(folder))
    return places


def _state_directory(plant: str | None) -> tuple[Path, AuditConfig]:
    """Return the state directory, and the audit settings of the plant file."""
    from drivebus.service.config.model import AuditConfig

    if plant is None:
        from drivebus.service.config.build import state_directory

        plants = state_directory("x").parent
        directories = sorted(path for path in plants.iterdir() if path.is_dir()) if plants.is_dir() else []
        if len(directories) != 1:
            raise ConfigurationError("audit.command.which", plants=tuple(path.name for path in directories) or "-")
        return directories[0], AuditConfig()
    if Path(plant).suffix != ".toml":
        return Path(plant), AuditConfig()
    from drivebus.service.config.load import load

    config = load(plant)
    return config.directory, config.audit


def _titles(plant: str | None) -> Titles:
    """Return the titles of a plant file; none for a state directory, which does not hold them."""
    if plant is None or Path(plant).suffix != ".toml":
        return {}
    from drivebus.service.audit.description import titles_of
    from drivebus.service.config.load import load

    return titles_of(load(plant))


@contextmanager
def _readable_trail(folder: Path) -> Iterator[None]:
    """Convert an OSError to a ConfigurationError."""
    try:
        yield
    except OSError as error:
        raise ConfigurationError("audit.command.unreadable", folder=str(folder), reason=SystemReason(error)) from error


def _argument() -> Argument:
    return Argument(["plant"], metavar="[PLANT.toml|DIRECTORY]", required=False, key="help.argument.audit")


verify = CliCommand(
    "verify",
    help_key="audit.verify",
    callback=_verify,
    params=[
        _argument(),
        Option(["--checkpoints"], metavar="FILE", example="--checkpoints /mnt/worm/checkpoints.jsonl"),
        Option(["--key"], metavar="FILE", key="help.option.audit_key", example="--key /root/hall.audit.key"),
        Option(["--head"], metavar="FILE", key="help.option.audit_head", example="--head /root/hall.audit.head"),
        Option(
            ["--at-least"],
            type=options.NumberType(0, 10**12),
            default=0,
            metavar="N",
            key="help.option.audit_at_least",
            example="--at-least 4711",
        ),
    ],
    examples=(
        "drivebus audit verify plant.toml",
        "drivebus audit verify plant.toml --at-least 4711",
        "drivebus audit verify /var/lib/drivebus/plants/hall --key /root/hall.audit.key",
    ),
)

list_ = CliCommand(
    "list",
    help_key="audit.list",
    callback=_list,
    params=[
        _argument(),
        Option(["--drive"], metavar="ID", key="help.option.audit_drive", example="--drive fan-1"),
        Option(
            ["--limit"],
            type=options.NumberType(1, 100_000),
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
    help_key="audit",
    sections={
        "cli.section.audit": {
            "verify": "drivebus.cli.commands.audit:verify",
            "list": "drivebus.cli.commands.audit:list_",
        }
    },
    no_args_is_help=True,
    examples=("drivebus audit verify plant.toml", "drivebus audit list plant.toml --drive fan-1"),
)
