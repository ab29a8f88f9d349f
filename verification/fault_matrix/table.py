"""The table of faults and protocols as data: what each cell must end in, in words of both languages."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

TABLE: dict[str, dict[str, Any]] = json.loads((Path(__file__).parent / "table.json").read_text(encoding="utf-8"))[
    "rows"
]
"""Rows by name, in order. ``fault``; ``cells`` by model, ``partly`` where the product has not all of it yet;
``shown``: what the case does and sees; ``missing``: what it can't show yet."""
