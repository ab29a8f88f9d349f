"""``matrix``: every cell of the table of faults and protocols, a seeded case each; the docs' table is made of it."""

from __future__ import annotations

from drivebus.lab.campaign import Campaign, Session
from drivebus.lab.cells.cell import Case, Cell, cells

SEEDS = 20
"""So many seeds a cell in the committed report."""
CELLS = cells()


def run(session: Session) -> None:
    """All cells with one seed, then all with the next."""
    figures: dict[str, dict[str, int]] = {}
    for number in range(session.budget):
        cell = CELLS[number % len(CELLS)]
        held = try_cell(session, cell, number // len(CELLS))
        found = figures.setdefault(cell.name, {"cases": 0, "held": 0})
        found["cases"] += 1
        found["held"] += held
        session.count("cases held" if held else "cases failed")
        session.did()
    session.figures["cells"] = figures


def try_cell(session: Session, cell: Cell, number: int) -> bool:
    """Was it held? Whatever a case finds, or escapes from it, is a violation that names the cell."""
    before = session.violated
    case = Case(session, cell, number)
    session.line(f"--- {case.name}")
    try:
        cell.check(case)
        case.close()
    except Exception as error:
        session.violation(f"seed {session.seed}, {case.name}: {type(error).__name__}: {error}")
    return session.violated == before


CAMPAIGN = Campaign("matrix", "cells", ("F01-F19", "I1-I12"), SEEDS * len(CELLS), len(CELLS), run)
