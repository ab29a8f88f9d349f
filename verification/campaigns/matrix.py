"""``matrix``: every cell of the table of faults and protocols; the table in the docs is generated from its report."""

from __future__ import annotations

from verification.campaign import Campaign, CampaignRun
from verification.fault_matrix.cell import CellRun, MatrixCell, all_cells

SEEDS_PER_CELL = 20
"""Seeds of each cell in the committed report."""
ALL_CELLS = all_cells()


def run(campaign_run: CampaignRun) -> None:
    """Run all cells with one seed, then all with the next."""
    figures: dict[str, dict[str, int]] = {}
    for number in range(campaign_run.budget):
        cell = ALL_CELLS[number % len(ALL_CELLS)]
        held = run_cell(campaign_run, cell, number // len(ALL_CELLS))
        found = figures.setdefault(cell.name, {"cases": 0, "held": 0})
        found["cases"] += 1
        found["held"] += held
        campaign_run.count("cases held" if held else "cases failed")
        campaign_run.add_trials()
    campaign_run.figures["cells"] = figures


def run_cell(campaign_run: CampaignRun, cell: MatrixCell, number: int) -> bool:
    """Run one case and return whether it held; an exception that escapes is a violation of the cell."""
    before = campaign_run.violation_count
    case = CellRun(campaign_run, cell, number)
    campaign_run.trace(f"--- {case.name}")
    try:
        cell.check(case)
        case.close()
    except Exception as error:
        campaign_run.violation(f"seed {campaign_run.seed}, {case.name}: {type(error).__name__}: {error}")
    return campaign_run.violation_count == before


CAMPAIGN = Campaign(
    name="matrix",
    summary={"en": "Every fault with every protocol.", "zh": "每种故障配每种协议。"},
    unit="cells",
    evidence_for=("I1-I12",),
    full_budget=SEEDS_PER_CELL * len(ALL_CELLS),
    ci_budget=len(ALL_CELLS),
    run=run,
)
