"""Checks of schemathesis beyond the API description."""

from __future__ import annotations

from typing import Any

import schemathesis

BEYOND = {"cursor", "to_ms"}
"""Errors that no schema can exclude: a cursor that was not issued, and a span that ends before it begins."""


@schemathesis.check
def valid_requests_have_no_wrong_parameters(ctx: Any, response: Any, case: Any) -> None:
    """422 means wrong parameters, which a valid request never has, or a command that this drive's limits or model do
    not allow, which no schema expresses.
    """
    fits = case.meta is not None and case.meta.generation.mode.is_positive
    if not fits or response.status_code != 422:
        return
    error = response.json()["error"]
    wrong = {fault["path"] for fault in error["params"].get("faults", ())}
    if error["code"] == "plant.params" and not wrong <= BEYOND:
        raise AssertionError(f"the description allows a rejected request: {response.text[:300]}")
