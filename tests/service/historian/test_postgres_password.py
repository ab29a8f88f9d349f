"""Password of the database beside the configuration: a password file or an environment variable."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from fixtures.postgres import messages_sent
from peers import need_module

PASSWORD_REQUEST = b"R\x00\x00\x00\x08\x00\x00\x00\x03"  # AuthenticationCleartextPassword


@pytest.mark.parametrize("where", ["PGPASSFILE", "PGPASSWORD", "passfile"])
def test_the_password_of_the_database_need_not_be_in_the_configuration(
    where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_module("asyncpg")
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        file = tmp_path / "pgpass"
        file.write_text(f"127.0.0.1:{port}:plant:drivebus:hunter2\n")
        file.chmod(0o600)
        url = f"postgresql://drivebus@127.0.0.1:{port}/plant?sslmode=disable"
        if where == "passfile":
            url += f"&passfile={file}"
        else:
            monkeypatch.setenv(where, str(file) if where == "PGPASSFILE" else "hunter2")
        _, answer = messages_sent(listener, url, PASSWORD_REQUEST)
        assert answer[5:] == b"hunter2\0"
