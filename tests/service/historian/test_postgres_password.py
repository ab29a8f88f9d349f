"""Password of the database beside the configuration: a password file or an environment variable."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import pytest

from peers import need_module

PASSWORD_REQUEST = b"R\x00\x00\x00\x08\x00\x00\x00\x03"  # AuthenticationCleartextPassword


def password_sent(listener: socket.socket, url: str) -> str:
    """Return the password that a connection to ``url`` sends to a server that asks for one."""
    from drivebus.service.historian.postgres import PostgresConnection

    found: list[bytes] = []

    def serve() -> None:
        client, _ = listener.accept()
        with client:
            client.recv(4096)
            client.sendall(PASSWORD_REQUEST)
            found.append(client.recv(4096))

    server = threading.Thread(target=serve)
    server.start()
    connection = PostgresConnection(url)
    with pytest.raises(connection.errors):
        connection.connect()
    connection.close()
    server.join()
    return found[0][5:].rstrip(b"\x00").decode()


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
        assert password_sent(listener, url) == "hunter2"
