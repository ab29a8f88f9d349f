"""Checks of schemathesis beyond the API description."""

from __future__ import annotations

from typing import Any

import schemathesis

BEYOND = {"cursor", "to_ms"}
"""Errors that no schema can exclude: a cursor that was not issued, and a span that ends before it begins."""


@schemathesis.check
def what_fits_the_description_is_never_called_wrong(ctx: Any, response: Any, case: Any) -> None:
    """422 has two meanings here: wrong parameters, which a fitting request never has, and what this drive can't do or
    must not do (a limit, a parameter it lacks), which only the plant knows.
    """
    fits = case.meta is not None and case.meta.generation.mode.is_positive
    if not fits or response.status_code != 422:
        return
    error = response.json()["error"]
    wrong = {fault["path"] for fault in error["params"].get("faults", ())}
    if error["code"] == "plant.params" and not wrong <= BEYOND:
        raise AssertionError(f"the description allows what is refused: {response.text[:300]}")
