"""``scan``: find the drives of a bus. Listens first, sends only reads, keeps its results when it is interrupted."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import TYPE_CHECKING

from drivebus.cli import options, output
from drivebus.cli.click_ext import CliCommand, Option
from drivebus.cli.connect import record_ports
from drivebus.cli.errors import ExitCode, exit_code_of
from drivebus.cli.scan_output import ScanProgressBar, announce_scan, print_scan, print_scan_plan
from drivebus.cli.scanning import ScanRequest, listen_for_master, listen_option, search_options

if TYPE_CHECKING:
    from drivebus.ports import Port
    from drivebus.serial_settings import SerialSettings


def _scan(
    *,
    port: str,
    models: tuple[str, ...] | None,
    addresses: tuple[int, ...] | None,
    bauds: tuple[int, ...] | None,
    formats: tuple[str, ...] | None,
    encoding: str | None,
    listen_seconds: float,
    force: bool,
    everything: bool,
    record: str | None,
    dry_run: bool,
) -> ExitCode:
    request = ScanRequest(
        port=port, models=models, addresses=addresses, bauds=bauds, formats=formats, encoding=encoding
    )
    if dry_run:
        return print_scan_plan(request.plan())
    with record_ports(record) as wrap:
        return asyncio.run(_run(request, listen_seconds, force=force, everything=everything, wrap=wrap))


async def _run(
    request: ScanRequest, listen_s: float, *, force: bool, everything: bool, wrap: Callable[[Port], Port]
) -> ExitCode:
    from drivebus.cli.signals import shutdown_signals
    from drivebus.commissioning import scan
    from drivebus.errors import DrivebusError

    def open_port(settings: SerialSettings) -> Port:
        return wrap(request.open_port(settings))

    passes = request.plan()
    progress = scan.ScanProgress(total_s=sum(each_pass.duration_s for each_pass in passes))
    sniffed = None
    with shutdown_signals() as shutdown:
        if listen_s > 0 and passes:
            sniffed = await shutdown.interruptible(listen_for_master(open_port(passes[0].settings), listen_s))
        if sniffed is not None and sniffed.count and not force:
            output.print_note("scan.foreign_end")
            return print_scan(request.port, progress, sniffed, ExitCode.FAILED)
        announce_scan(passes)
        try:
            with ScanProgressBar() as bar:
                search = scan.scan(passes, open_port, progress, bar.on_progress, keep_going=everything)
                await shutdown.interruptible(search)
        except DrivebusError as error:
            return print_scan(request.port, progress, sniffed, exit_code_of(error), error)
    if shutdown.received:
        output.print_note("scan.aborted")
    named = any(drive.models for drive in progress.found)  # a device that no model fits can't be commanded
    code = ExitCode.INTERRUPTED if shutdown.received else ExitCode.DONE if named else ExitCode.FAILED
    return print_scan(request.port, progress, sniffed, code)


command = CliCommand(
    "scan",
    callback=_scan,
    params=[
        options.port_argument(),
        *search_options(),
        options.encoding_option(),
        listen_option(),
        Option(["--force"], is_flag=True, key="help.option.scan_force"),
        Option(["--all", "everything"], is_flag=True, key="help.option.all"),
        options.record_option(),
        options.dry_run_option(),
    ],
    examples=(
        "drivebus scan /dev/ttyUSB0",
        "drivebus scan /dev/ttyUSB0 --addresses 1-8 --bauds 9600 --formats 8E1,8N1",
        "drivebus scan sim://vc660@3 --models vc660 --addresses 1-5 --json",
        "drivebus scan tcp://192.168.1.50:4001 --dry-run",
        "drivebus scan /dev/ttyUSB0 --record what-answered.dbcap",
    ),
)
