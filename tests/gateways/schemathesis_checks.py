"""What schemathesis is told of this API beside its description."""

from __future__ import annotations

from typing import Any

import schemathesis


@schemathesis.check
def what_fits_the_description_is_never_called_wrong(ctx: Any, response: Any, case: Any) -> None:
    """422 has two meanings here: wrong parameters, which a fitting request never has, and what this drive can't do or
    must not do (a limit, a parameter it lacks), which only the plant knows.
    """
    fits = case.meta is not None and case.meta.generation.mode.is_positive
    if fits and response.status_code == 422 and response.json()["error"]["code"] == "plant.params":
        raise AssertionError(f"the description allows what is refused: {response.text[:300]}")
