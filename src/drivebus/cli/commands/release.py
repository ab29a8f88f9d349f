"""``release``: permit starts again after a bus stop of a running service. Nothing is sent to a drive."""

from __future__ import annotations

from drivebus.cli import options
from drivebus.cli.click_ext import CliCommand
from drivebus.cli.errors import ExitCode


def _release(*, service: str, drives: tuple[str, ...], group: str | None, everything: bool) -> ExitCode:
    from drivebus.cli.remote.selection import call_on_selection, print_results
    from drivebus.service.api.operations.selections import START_INHIBITS_RELEASE

    outcomes = call_on_selection(service, START_INHIBITS_RELEASE, drives, group, everything=everything)
    return print_results(outcomes, json_key="released", done="release.done", nothing="release.nothing")


command = CliCommand(
    "release",
    callback=_release,
    params=[options.required(options.service_option()), *options.selection_options("help.option.release_all")],
    examples=(
        "drivebus release --service http://127.0.0.1:8080 --drive fan-1 --drive fan-2",
        "drivebus release --service http://127.0.0.1:8080 --group fans",
        "drivebus release --service http://127.0.0.1:8080 --all",
    ),
)
