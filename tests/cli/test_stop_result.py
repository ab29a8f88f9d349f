"""Result of a stop of many drives: the same document, sentence and exit code by every way to ask for it."""

from __future__ import annotations

import json
from typing import Any

import pytest
from click.testing import CliRunner

from drivebus.cli.commands import stop
from drivebus.cli.main import cli
from drivebus.cli.remote import client
from drivebus.types import Json

WAYS = (("--directory", "state"), ("--service", "http://127.0.0.1:8080"))
CONFIRMED, ACKNOWLEDGED = {"status": "confirmed"}, {"status": "acknowledged"}
LOST = {"code": "bus.no_reply", "kind": "NoReply"}


def stop_all(monkeypatch: pytest.MonkeyPatch, outcomes: Json, *words: str) -> tuple[int, str]:
    """Stop everything by each way, with this answer of the service; return the one exit code and the one output."""
    answer: Json = {"buses": {"a": {"took_s": 0.5}} if outcomes else {}, "outcomes": outcomes}

    async def request_stop(folder: Any) -> Json:
        return answer

    monkeypatch.setattr(stop, "_request_stop", request_stop)
    monkeypatch.setattr(client, "call_once", lambda *given: answer)
    results = [CliRunner().invoke(cli, ["stop", "--all", *way, *words]) for way in WAYS]
    (found,) = {(result.exit_code, result.stdout) for result in results}
    return found


@pytest.mark.parametrize(
    ("outcomes", "code"),
    [
        ({"a": CONFIRMED}, 0),
        ({"a": CONFIRMED, "b": ACKNOWLEDGED}, 0),
        ({"a": CONFIRMED, "b": ACKNOWLEDGED, "c": LOST}, 4),
        ({}, 4),
    ],
)
def test_a_drive_that_cannot_report_is_acknowledged_and_a_plant_without_drives_is_not_stopped(
    monkeypatch: pytest.MonkeyPatch, outcomes: Json, code: int
) -> None:
    found = stop_all(monkeypatch, outcomes, "--json")
    document = json.loads(found[1])
    assert found[0] == code
    assert (document["confirmed"], document["acknowledged"], document["unconfirmed"]) == (
        [drive for drive in outcomes if drive == "a"],
        [drive for drive in outcomes if drive == "b"],
        [drive for drive in outcomes if drive == "c"],
    )


def test_an_acknowledged_stop_is_never_called_not_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    _, text = stop_all(monkeypatch, {"fan": CONFIRMED, "saw": ACKNOWLEDGED}, "--lang", "en")
    assert "NOT CONFIRMED" not in text and "acknowledged, the drive can't report it: saw" in text
    assert "NOT CONFIRMED: there is no drive" in stop_all(monkeypatch, {}, "--lang", "en")[1]
