"""Steps that only read: port, owner, line, reply times, fences, parity."""

from __future__ import annotations

import asyncio
import json
import sys
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from drivebus.bus.messages import BusRequest
from drivebus.errors import DrivebusError

if TYPE_CHECKING:
    from drivebus.bus import Bus
    from drivebus.cli.acceptance.session import AcceptanceSession
    from drivebus.cli.connect import Target
    from drivebus.drives import Drive

StepOutcome = tuple[bool | None, dict[str, Any]]
TIMING_READS = 300
WRONG_PARITY_READS = 20
FAILED_SHARE_MAX = 0.01
"""A line on which more than 1 % of the reads fail, before their retry, is not well wired."""
QUIET_OBSERVATION_S = 3.0
OTHER_PARITY = {"N": "E", "E": "O", "O": "E"}
UNSOLICITED_KINDS = ("late", "foreign", "duplicate", "unsolicited", "foreign_request", "collision", "line_errors")
"""Counters that stay at zero on a line that is well wired and has one master."""


async def check_port(rig: AcceptanceSession) -> StepOutcome:
    """What the port says of itself: real pacing, real parity, who switches the RS485 driver."""
    async with rig.drive() as (bus, _):
        able = bus.port.capabilities
        return True, {
            "identity": bus.port.identity,
            "line": str(bus.settings),
            "line_timing": able.has_line_timing,
            "parity": able.parity,
            "direction_control": able.direction_control,
        }


async def check_exclusive(rig: AcceptanceSession) -> StepOutcome:
    """G18: while we have the port no other program gets it."""
    if rig.target.port.startswith(("sim:", "memory:", "tcp:", "rfc2217:")):
        return None, {}
    async with rig.drive():
        error = (await rig.race(_second_instance(rig.target))).get("error", {})
    return error.get("type") == "PortUnavailable", {"refused": error["text"]} if error else {}


async def _second_instance(target: Target) -> dict[str, Any]:
    """What a second drivebus is told that reads the status of this drive."""
    options = ["--model", target.model, "--address", str(target.address), "--json", "--lang", "en"]
    options += [] if target.baud is None else ["--baud", str(target.baud)]
    options += [] if target.format is None else ["--format", target.format]
    program = await asyncio.create_subprocess_exec(
        sys.executable,
        "-m",
        "drivebus",
        "status",
        target.port,
        *options,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.DEVNULL,
    )
    said, _ = await program.communicate()
    told: dict[str, Any] = json.loads(said.splitlines()[-1])
    return told


async def check_quiet(rig: AcceptanceSession) -> StepOutcome:
    """F14: nobody speaks on the line while we don't."""
    async with rig.drive() as (bus, _):
        await rig.race(asyncio.sleep(QUIET_OBSERVATION_S))
        heard = bus.statistics().bytes_received
    return heard == 0, {"listened_s": QUIET_OBSERVATION_S, "bytes_heard": heard}


async def check_reply_times(rig: AcceptanceSession) -> StepOutcome:
    """300 reads: reply times against what the line's arithmetic asks for, and what went wrong."""
    async with rig.drive() as (bus, drive):
        await rig.race(_reads(bus, drive, TIMING_READS))
        found = bus.statistics().stations[drive.address]
    figures: dict[str, Any] = {
        f"reply_{name}_ms": _ms(getattr(found, f"reply_{name}_s")) for name in ("p50", "p95", "p99")
    }
    figures |= {"reads": found.transactions, "damaged": found.damaged, "errors": dict(found.errors)}
    figures["least_possible_ms"] = _ms(_min_reply_s(bus, drive))
    return found.error_rate <= FAILED_SHARE_MAX and found.replies >= TIMING_READS, figures


async def check_sync_probes(rig: AcceptanceSession) -> StepOutcome:
    """F01, F02, F15: no late, foreign or second answer turned up in as many reads again."""
    async with rig.drive() as (bus, drive):
        await rig.race(_reads(bus, drive, TIMING_READS))
        found = bus.statistics().counters
    stray = {name: found.get(name, 0) for name in UNSOLICITED_KINDS}
    return not any(stray.values()), stray


async def check_parity(rig: AcceptanceSession) -> StepOutcome:
    """G20: on a line with another parity than the drive's no value is believed. Only where parity is really checked."""
    async with rig.drive() as (bus, _):
        settings, real = bus.settings, bus.port.capabilities.parity
    if not real or rig.target.port.startswith("sim:"):
        return None, {}
    other = f"{settings.data_bits}{OTHER_PARITY[settings.parity]}{settings.stop_bits}"
    async with replace(rig, target=replace(rig.target, format=other)).drive() as (bus, drive):
        await rig.race(_reads(bus, drive, WRONG_PARITY_READS))
        found = bus.statistics().stations[drive.address]
    return found.replies == 0, {"format": other, "reads": WRONG_PARITY_READS, "believed": found.replies}


async def _reads(bus: Bus, drive: Drive, count: int) -> None:
    for _ in range(count):
        await bus.transact(BusRequest(drive.address, drive.dialect.echo_test_read()))


def _min_reply_s(bus: Bus, drive: Drive) -> float:
    """The reply's own characters: a drive and an adapter without any delay."""
    return bus.settings.seconds(drive.dialect.codec.reply_size(drive.dialect.echo_test_read()))


def _ms(seconds: float | None) -> float | None:
    return None if seconds is None else round(1000 * seconds, 3)


async def replies_now(bus: Bus, drive: Drive) -> bool:
    """Does the drive answer now?"""
    try:
        return (await bus.transact(BusRequest(drive.address, drive.dialect.echo_test_read()))).error is None
    except DrivebusError:
        return False
