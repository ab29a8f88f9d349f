"""Odd forms of a request over a real socket: each has one meaning, and none stops or starts a drive by another name."""

from __future__ import annotations

import socket
from urllib.parse import urlsplit

import pytest

from drivebus.service.api.operations import API_PREFIX
from drivebus.service.auth.rights import Role
from fixtures.running_service import RunningService, plant_fixture, token

TIMEOUT_S = 20.0
STOP, DRIVE = f"{API_PREFIX}/drives/fan-1/stop", f"{API_PREFIX}/drives/fan-1"
JSON = "Content-Type: application/json"


plant = plant_fixture()


def status_of(plant: RunningService, line: str, *headers: str, body: bytes = b"") -> int:
    """Return the status of the response to a request of an operator; 0 where there is none."""
    address = urlsplit(plant.url)
    head = [line, f"Host: {address.netloc}", f"Authorization: Bearer {token(Role.OPERATOR)}", "Connection: close"]
    head += [*headers, *([f"Content-Length: {len(body)}"] if body else [])]
    with socket.create_connection((address.hostname or "", address.port or 0), TIMEOUT_S) as client:
        client.sendall("\r\n".join([*head, "", ""]).encode("latin-1") + body)
        answer = client.recv(100)
    return int(answer.split()[1]) if answer else 0


@pytest.mark.parametrize("line", [f"{method} {STOP}" for method in ("GET", "HEAD", "OPTIONS", "TRACE", "QUERY", "PUT")])
@pytest.mark.parametrize("override", ["", "X-HTTP-Method-Override: POST", "X-Method-Override: POST"])
def test_only_the_method_of_a_command_runs_it(plant: RunningService, line: str, override: str) -> None:
    before = plant.kit.service.plant.stop_counts["fan-1"]
    assert status_of(plant, f"{line} HTTP/1.1", *([override] if override else [])) == 405
    assert status_of(plant, f"{line}?_method=POST HTTP/1.1") == 405
    assert plant.kit.service.plant.stop_counts["fan-1"] == before
    assert status_of(plant, f"POST {STOP} HTTP/1.1") == 200
    assert plant.kit.service.plant.stop_counts["fan-1"] == before + 1


@pytest.mark.parametrize(
    ("name", "status"),
    [
        ("fan%2D1", 200),  # the same name, encoded
        ("FAN-1", 422),
        ("fan-1%00", 422),
        ("fan-1%0a", 422),
        ("fan-1;x=1", 422),
        ("fan-1%E2%80%8B", 422),
        ("%EF%BD%86an-1", 422),
        ("%zz", 422),
        ("fan-1/", 404),
        ("./fan-1", 404),
        ("x/../fan-1", 404),
        ("%2e%2e%2ffan-1", 404),
    ],
)
def test_a_drive_has_one_name_in_an_address(plant: RunningService, name: str, status: int) -> None:
    assert status_of(plant, f"GET {API_PREFIX}/drives/{name} HTTP/1.1") == status


@pytest.mark.parametrize(
    "body",
    [
        b'{"how": "stop", "how": "coast"}',
        b'{"how": "stop", "h\\u006fw": "coast"}',
        b"{} {}",
        b"\xef\xbb\xbf{}",
        "{}".encode("utf-16"),
        b"[]",
        b"null",
        b'{"assume_model": NaN}',
        b'{"assume_model": 1}',
        b'{"how":' + b"[" * 50_000 + b"]" * 50_000 + b"}",
    ],
)
def test_a_body_with_two_meanings_or_none_stops_nothing(plant: RunningService, body: bytes) -> None:
    before = plant.kit.service.plant.stop_counts["fan-1"]
    assert status_of(plant, f"POST {STOP} HTTP/1.1", JSON, body=body) == 422
    assert plant.kit.service.plant.stop_counts["fan-1"] == before


@pytest.mark.parametrize(
    "header",
    ["Host: other", " folded: x", "Bad Name: x", "Content-Length: +3", "Transfer-Encoding: gzip", "X: a\x00b"],
)
def test_a_head_with_two_meanings_is_refused(plant: RunningService, header: str) -> None:
    assert status_of(plant, f"GET {DRIVE} HTTP/1.1", header) in (400, 403)
