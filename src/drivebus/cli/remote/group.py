"""Commands to a group of a service: control of all its drives meanwhile, the outcome or error of each afterwards."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from drivebus.cli import output
from drivebus.cli.errors import ExitCode, error_json, error_text, exit_code_of
from drivebus.types import Json

if TYPE_CHECKING:
    from drivebus.service.api.operations import Operation


async def command_group(service: str, operation: Operation, group: str, **params: Any) -> Json:
    """Take control of the drives of a group, execute an operation on it and give the control back.

    Return the outcome or error of each drive. Raises NotFound, ControlNotHeld: then nothing was sent.
    """
    from drivebus import profiles
    from drivebus.cli.remote.client import open_client
    from drivebus.cli.remote.drive import RemoteDrive
    from drivebus.service.api.operations.drives import DRIVES_LIST
    from drivebus.service.api.operations.groups import GROUPS_LIST

    async with open_client(service) as client:
        groups = {each["id"]: each["drives"] for each in (await client.call(GROUPS_LIST.name, {}))["groups"]}
        views = {view["id"]: view for view in (await client.call(DRIVES_LIST.name, {}))["drives"]}
        drives = [
            RemoteDrive(client, id, views[id]["address"], profiles.load(views[id]["model"]))
            for id in groups.get(group, ())  # the operation rejects an unknown group
        ]
        try:
            for drive in drives:
                await drive.take_control()
            outcomes: Json = (await client.call(operation.name, {"group": group, **params}))["outcomes"]
        finally:
            for drive in drives:
                await drive.close()
        return outcomes


def print_outcomes_by_drive(outcomes: Json) -> ExitCode:
    """Print the outcome or error of each drive; return 4 where one is unknown, else 1 where one failed."""
    with output.continue_without_output():  # it is done
        codes = {_print_outcome(drive, outcome) for drive, outcome in outcomes.items()}
    return (
        ExitCode.UNKNOWN if ExitCode.UNKNOWN in codes else ExitCode.FAILED if codes - {ExitCode.DONE} else ExitCode.DONE
    )


def _print_outcome(drive: str, data: Json) -> ExitCode:
    """Print the outcome or error of one drive; return its exit code."""
    from drivebus.cli.formatting import outcome_exit_code, outcome_json, outcome_text
    from drivebus.cli.remote.convert import parse_error_outcome, parse_outcome
    from drivebus.cli.remote.drive import RemoteBus
    from drivebus.service.api.errors import error_from_json

    if "code" in data:
        error = parse_error_outcome(error_from_json(data))
        output.print_json({"drive": drive} | error_json(error), stream=True)
        output.print_wrapped(f"{drive}: {error_text(error)}")
        return exit_code_of(error)
    outcome = parse_outcome({"outcome": data})
    text = outcome_text(outcome) if outcome.succeeded else outcome.text(output.language())
    output.print_json({"drive": drive} | outcome_json(outcome, RemoteBus.now()), stream=True)
    output.print_wrapped(f"{drive}: {text}")
    return outcome_exit_code(outcome)
