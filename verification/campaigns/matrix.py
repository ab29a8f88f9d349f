"""``matrix``: every cell of the table of faults and protocols, a seeded case each; the docs' table is made of it."""

from __future__ import annotations

from verification.campaign import Campaign, CampaignRun
from verification.fault_matrix.cell import CellRun, MatrixCell, all_cells

SEEDS_PER_CELL = 20
"""So many seeds a cell in the committed report."""
ALL_CELLS = all_cells()


def run(session: CampaignRun) -> None:
    """All cells with one seed, then all with the next."""
    figures: dict[str, dict[str, int]] = {}
    for number in range(session.budget):
        cell = ALL_CELLS[number % len(ALL_CELLS)]
        held = run_cell(session, cell, number // len(ALL_CELLS))
        found = figures.setdefault(cell.name, {"cases": 0, "held": 0})
        found["cases"] += 1
        found["held"] += held
        session.count("cases held" if held else "cases failed")
        session.add_trials()
    session.figures["cells"] = figures


def run_cell(session: CampaignRun, cell: MatrixCell, number: int) -> bool:
    """Was it held? Whatever a case finds, or escapes from it, is a violation that names the cell."""
    before = session.violation_count
    case = CellRun(session, cell, number)
    session.trace(f"--- {case.name}")
    try:
        cell.check(case)
        case.close()
    except Exception as error:
        session.violation(f"seed {session.seed}, {case.name}: {type(error).__name__}: {error}")
    return session.violation_count == before


CAMPAIGN = Campaign(
    name="matrix",
    summary={"en": "Every fault with every protocol.", "zh": "每种故障配每种协议。"},
    unit="cells",
    evidence_for=("I1-I12",),
    full_budget=SEEDS_PER_CELL * len(ALL_CELLS),
    ci_budget=len(ALL_CELLS),
    run=run,
)
