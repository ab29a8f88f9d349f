"""schemathesis against a real service over simulated drives, through its web app on a socket.

``DRIVEBUS_API_EXAMPLES=100`` runs more examples than the slice beside the other tests.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import httpx
import pytest

from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.rights import Role
from drivebus.web.operations import WEB_OPERATIONS
from fixtures.running_service import PASSWORD, RunningService, http_service, token

pytestmark = pytest.mark.xdist_group("api")
EXAMPLES = os.environ.get("DRIVEBUS_API_EXAMPLES", "2")
HERE = Path(__file__).parent
ENDS_ITSELF = ("/logout", "/password", "/session/activity")
"""Routes that end the session of the test, which would then find nothing more."""


def described(plant: RunningService, headers: dict[str, str], directory: Path) -> Path:
    answer = httpx.get(f"{plant.url}{API_PREFIX}/openapi.json", headers=headers)
    file = directory / "openapi.json"
    file.write_bytes(answer.raise_for_status().content)
    return file


def findings(plant: RunningService, headers: dict[str, str], directory: Path, *chosen: str) -> str:
    """Return the output of schemathesis; empty where it found nothing."""
    words = [word for name, value in headers.items() for word in ("-H", f"{name}: {value}")]
    file = described(plant, headers, directory)
    done = subprocess.run(
        [Path(sys.executable).parent / "schemathesis", "--config-file", HERE / "schemathesis.toml", "run", file]
        + ["--url", plant.url, "--max-examples", EXAMPLES, "--seed", "1", "--phases", "examples,coverage,fuzzing"]
        + ["--checks", "all", "--suppress-health-check", "all", "--no-color", *words, *chosen],
        cwd=directory,
        env=os.environ | {"PYTHONPATH": str(HERE.parents[1])},
        capture_output=True,
        text=True,
        check=False,
    )
    return "" if done.returncode == 0 else done.stdout[-8000:] + done.stderr[-2000:]


def cookie(plant: RunningService) -> dict[str, str]:
    """An administrator's session, with the page's header."""
    given = {"name": str(Role.ADMINISTRATOR), "password": PASSWORD}
    answer = httpx.post(f"{plant.url}{API_PREFIX}/login", json=given).raise_for_status()
    return {
        "Cookie": f"drivebus_session={answer.cookies['drivebus_session']}",
        "X-Drivebus-CSRF": answer.json()["csrf"],
    }


@pytest.mark.timeout(600)
def test_schemathesis_finds_nothing_with_the_token_of_an_engineer(tmp_path: Path) -> None:
    with http_service(tmp_path) as plant:
        found = findings(plant, {"Authorization": f"Bearer {token(Role.ENGINEER)}"}, tmp_path)
        assert not found, found


@pytest.mark.timeout(600)
def test_schemathesis_finds_nothing_with_the_session_of_an_administrator(tmp_path: Path) -> None:
    with http_service(tmp_path) as plant:
        names = dict.fromkeys(operation.tag for operation in WEB_OPERATIONS.values())
        tags = [word for tag in names for word in ("--include-tag", tag)]
        ours = [word for path in ENDS_ITSELF for word in ("--exclude-path", API_PREFIX + path)]
        found = findings(plant, cookie(plant), tmp_path, *tags, *ours)
        assert not found, found
