"""TLS of the connection to the history's database: a server elsewhere must prove its name, unless the URL says else."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
import trustme
from click.testing import CliRunner

from drivebus.cli.main import cli
from drivebus.service.config import database
from drivebus.service.config.database import default_sslmode, unverified_sslmode
from fixtures.postgres import messages_sent
from fixtures.service import FAN_FILE
from peers import need_module

SSL_REQUEST = b"\x00\x00\x00\x08\x04\xd2\x16\x2f"
NO_TLS = b"N"


@pytest.fixture(autouse=True)
def without_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("PGSSLMODE", "PGSERVICE", "PGHOST"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    "where",
    [
        "db.plant/plant",
        "u:p@db.plant:5433/plant",
        "u@192.168.1.9/plant",
        "u@[2001:db8::1]:5432/plant",
        "u@127.0.0.1,db/p",
    ],
)
def test_a_server_elsewhere_is_verified_unless_the_url_names_a_mode(where: str) -> None:
    url = f"postgresql://{where}"
    assert (default_sslmode(url), unverified_sslmode(url)) == ("verify-full", None)
    for mode, unverified in (("verify-full", None), ("verify-ca", "verify-ca"), ("require", "require")):
        named = f"{url}?search_path=north&sslmode={mode}"
        assert (default_sslmode(named), unverified_sslmode(named)) == (None, unverified)


@pytest.mark.parametrize(
    "where",
    [
        "/plant",
        "u@127.0.0.1/plant",
        "u@localhost:5433/plant",
        "u@[::1]:5432/plant",
        "u@%2Frun%2Fpostgresql/plant",
        "/plant?host=/run/postgresql",
    ],
)
def test_a_server_on_this_machine_needs_no_certificate(where: str) -> None:
    url = f"postgresql://{where}"
    assert (default_sslmode(url), unverified_sslmode(f"{url}{'&' if '?' in url else '?'}sslmode=disable")) == (
        None,
        None,
    )


def test_the_environment_and_a_service_file_may_name_the_mode_and_the_host(monkeypatch: pytest.MonkeyPatch) -> None:
    assert default_sslmode("postgresql:///plant?host=db.plant") == "verify-full"
    assert default_sslmode("postgresql://db.plant/plant?service=north") is None
    with monkeypatch.context() as patch:
        patch.setenv("PGSSLMODE", "prefer")
        assert default_sslmode("postgresql://db.plant/plant") is None
    monkeypatch.setenv("PGHOST", "db.plant")
    assert default_sslmode("postgresql:///plant") == "verify-full"


def test_the_history_sends_nothing_to_a_server_elsewhere_that_does_not_prove_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Name, password and history went to any computer that took its place."""
    need_module("asyncpg")
    authority = tmp_path / "authority.pem"
    trustme.CA().cert_pem.write_to_path(str(authority))
    monkeypatch.setattr(database, "is_loopback", lambda host: False)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        url = f"postgresql://drivebus@127.0.0.1:{listener.getsockname()[1]}/plant?sslrootcert={authority}"
        assert messages_sent(listener, url, NO_TLS) == (SSL_REQUEST, b"")
        sent, then = messages_sent(listener, f"{url}&sslmode=prefer", NO_TLS)
        assert sent == SSL_REQUEST and b"drivebus" in then, "as the URL says"


def test_check_warns_of_a_database_elsewhere_that_need_not_prove_its_name(tmp_path: Path) -> None:
    plant = tmp_path / "plant.toml"
    text = FAN_FILE + '\n[history]\nurl = "postgresql://u:secret@db.plant/plant?sslmode=require"\n'
    plant.write_text(text)
    result = CliRunner().invoke(cli, ["check", str(plant), "--json"])
    (found,) = json.loads(result.stdout)["warnings"]
    assert (found["key"], found["found"]) == ("history.url", '"sslmode=require"')
    assert found["line"] == text.split("url =")[0].count("\n") + 1
    assert "db.plant" in found["expected"] and "secret" not in result.output
    plant.write_text(text.replace("?sslmode=require", ""))
    assert json.loads(CliRunner().invoke(cli, ["check", str(plant), "--json"]).stdout)["warnings"] == []
