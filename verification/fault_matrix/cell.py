"""Cells of the fault matrix: the table, the registry of checks, and the checks that many cells share."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any

from drivebus.bus import TraceKind
from verification.campaign import CampaignRun
from verification.drive_variants import DriveVariant
from verification.families.registry import variants_for
from verification.fault_matrix.matrix_scenario import MatrixScenario, ReplyAction
from verification.reference.request_effects import is_sync_probe

# --- table ------------------------------------------------------------------------------------------------------------

COVERED = variants_for("matrix")
TABLE: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "table.json").read_text(encoding="utf-8"))[
    "rows"
]
"""Rows by name, in order: ``fault``; ``cells`` by model, ``partly`` where the product is incomplete; ``shown``: what
the check does; ``missing``: what it cannot show yet."""


# --- cells ------------------------------------------------------------------------------------------------------------

CELL_MODULES = ("reply_cells", "damaged_frame_cells", "adapter_cells", "address_cells", "drive_rule_cells")


class CellRun:
    """Run of a cell: a drive variant, a random generator, and the scenarios of the check."""

    def __init__(self, campaign_run: CampaignRun, cell: MatrixCell, number: int) -> None:
        self.campaign_run, self.variant = campaign_run, cell.variant
        self.name = f"{cell.name}/{number}"
        self.rng: Random = campaign_run.rng(cell.name, number)
        self.scenarios: list[MatrixScenario] = []

    def scenario(self, *addresses: int, **options: Any) -> MatrixScenario:
        """Return a scenario whose drives are known to be online. ``options`` are those of ``sim://`` URLs."""
        scenario = MatrixScenario(
            self.campaign_run, self.variant, self.name, addresses or (1, 2), self.rng.randrange(2**31), options
        )
        self.scenarios.append(scenario)
        return scenario

    def random_hz(self, low: float = 5.0, high: float = 20.0) -> float:
        """Return a random frequency in steps of 0.1 Hz, which every model can represent."""
        return self.rng.randrange(round(low * 10), round(high * 10)) / 10.0

    def close(self) -> None:
        for scenario in self.scenarios:
            scenario.close()


CellCheck = Callable[[CellRun], None]


@dataclass(frozen=True, slots=True)
class MatrixCell:
    """Cell of the table: its row, and its column by the model of the variant."""

    row: str
    variant: DriveVariant
    check: CellCheck

    @property
    def name(self) -> str:
        return f"{self.row}/{self.variant.name}"


_CELL_CHECKS: dict[tuple[str, str], CellCheck] = {}


def cell(row: str, *variants: DriveVariant) -> Callable[[CellCheck], CellCheck]:
    """Register a function as the check of a row, for these variants (default: all)."""

    def register(check: CellCheck) -> CellCheck:
        for variant in variants or COVERED:
            _CELL_CHECKS[row, variant.name] = check
        return check

    return register


def all_cells() -> tuple[MatrixCell, ...]:
    """Return all cells, in the order of the table. Raises KeyError for a cell without a check."""
    for module in CELL_MODULES:
        import_module(f"verification.fault_matrix.{module}")
    return tuple(
        MatrixCell(row, variant, _CELL_CHECKS[row, variant.name])
        for row, message in TABLE.items()
        for variant in COVERED
        if variant.model in message["cells"]
    )


# --- shared checks ----------------------------------------------------------------------------------------------------

QUALITY_CHECK_INTERVAL_S = 0.05
STALE_AFTER_S = 3 * 1.0 + 0.4
"""Age at which the slowest signal here is bad, in seconds: max(3 × period, 1 s) + timeout."""


def check_failed_read(scenario: MatrixScenario, act: ReplyAction | str, error: str) -> None:
    """Check one failed read of drive 1: it is counted, and the read is repeated once after a sync probe."""
    address = 1
    wanted, data = scenario.plain_read(address)
    failed, mark, events = scenario.failure_count(address, error), len(scenario.requests), len(scenario.events)
    manipulation = scenario.manipulate_replies(address, act, 1)
    answer = scenario.transact(address, wanted)
    sent = scenario.requests_since(mark)
    scenario.expect(
        manipulation.remaining == 0 and [request.data for request in sent].count(data) == 2,
        f"sent {len(sent)} requests, the read not twice",
    )
    accepted = answer.error is None and answer.attempts == 2 and answer.received == scenario.replies[-1].data
    scenario.expect(accepted, f"the accepted reply is not the second one: {answer}")
    scenario.expect(
        scenario.failure_count(address, error) == failed + 1,
        f"counted: {scenario.statistics(address).errors}, not {error}",
    )
    message = [event for event in scenario.events[events:] if event.kind in (TraceKind.INVALID, TraceKind.NO_REPLY)]
    scenario.expect(len(message) == 1, f"{len(message)} failures in the trace")
    check_quarantine(scenario, mark)


def check_quarantine(scenario: MatrixScenario, mark: int) -> None:
    """Check that the model's longest lateness of silence and a sync probe follow the request at ``mark``."""
    first, second = scenario.requests[mark : mark + 2]
    scenario.expect(is_sync_probe(scenario.variant, second.data), f"{second.data.hex()} is no sync probe")
    scenario.expect(
        second.start - first.end >= scenario.variant.max_reply_lateness_s,
        f"sync probe after {second.start - first.end:.3f} s",
    )


def check_persistent_failure(scenario: MatrixScenario, act: ReplyAction | str) -> None:
    """Check that values stay good after one failed read, and are bad with an unknown state where the fault lasts."""
    address = 1
    scenario.run(scenario.variant.identical_probe_quarantine_s)  # until the replies lost before can no longer be due
    monitor = scenario.monitored(address)
    scenario.expect(not scenario.has_bad_quality(address), "bad before anything happened")
    scenario.manipulate_replies(address, act, 1)
    for _ in range(round(2.0 / QUALITY_CHECK_INTERVAL_S)):
        scenario.run(QUALITY_CHECK_INTERVAL_S)
        if scenario.has_bad_quality(address):
            scenario.expect(False, "bad after one failed read")
            break
    failed, manipulation = scenario.failure_count(address), scenario.manipulate_replies(address, act)
    scenario.run(STALE_AFTER_S + 1.0)
    scenario.expect(
        scenario.has_bad_quality(address) and monitor.status().state == "unknown",
        "still good after 3 periods of failed reads",
    )
    scenario.expect(scenario.failure_count(address) >= failed + 2, "bad after fewer than two failed reads")
    manipulation.remaining = 0
