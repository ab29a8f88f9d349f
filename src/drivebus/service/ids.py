"""Ids of the objects of a plant, as ``plant.toml`` names them: drives, buses, groups, interlocks and alarms."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

ID_CHARACTERS = r"[a-z0-9][a-z0-9_-]{0,63}"
ID_PATTERN = f"^{ID_CHARACTERS}$"
Id = Annotated[str, Field(pattern=ID_PATTERN)]
