"""``waive``: record why drives of a running service may be started although they may run on without their master."""

from __future__ import annotations

from drivebus.cli import options
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.errors import ExitCode


def _waive(*, service: str, drives: tuple[str, ...], group: str | None, everything: bool, reason: str) -> ExitCode:
    from drivebus.cli.remote.selection import call_on_selection, print_results
    from drivebus.service.api.operations.selections import WAIVERS_GRANT

    outcomes = call_on_selection(service, WAIVERS_GRANT, drives, group, everything=everything, reason=reason)
    return print_results(outcomes, json_key="waived", done="waive.done", nothing="waive.nothing")


command = CliCommand(
    "waive",
    callback=_waive,
    params=[
        options.required(options.service_option()),
        *options.selection_options("help.option.waive_all"),
        Option(["--reason"], required=True, metavar="TEXT", key="help.option.waive_reason"),
    ],
    examples=(
        'drivebus waive --service http://127.0.0.1:8080 --group fans --reason "hard-wired stop at each fan"',
        'drivebus waive --service http://127.0.0.1:8080 --all --reason "attended bench"',
    ),
)
