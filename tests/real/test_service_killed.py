"""``kill -9`` of a whole plant at random points: a few kills; ``real.kill_service`` does a thousand."""

from __future__ import annotations

import os
from pathlib import Path

from real import kill_service


def test_a_killed_plant_loses_no_answered_command_and_its_successor_only_reads(tmp_path: Path) -> None:
    found = kill_service.kill_repeatedly(int(os.environ.get("DRIVEBUS_SERVICE_KILLS", "4")), 1, tmp_path)
    assert found.violations == []
    assert found.answered > 0
    assert set(found.requests) == {"read"}
