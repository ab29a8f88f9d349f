"""``--service https://…``: nothing is sent to a server whose certificate does not fit."""

from __future__ import annotations

import asyncio
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
import trustme

from drivebus.cli.remote import http_client
from drivebus.cli.remote.http_client import HttpClient
from drivebus.clock import wall_clock
from drivebus.errors import ServiceUnavailable

TOKEN = "secret-token"


class RecordingHandler(BaseHTTPRequestHandler):
    tokens: list[str | None]

    def do_GET(self) -> None:
        self.tokens.append(self.headers["Authorization"])
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b'{"drives": []}')

    def log_message(self, *_: Any) -> None: ...


@contextmanager
def running_server(made: trustme.LeafCert | None) -> Iterator[tuple[int, list[str | None]]]:
    """Run a server with this certificate (None: plain HTTP); yield its port and the tokens that it received."""
    handler = type("Handler", (RecordingHandler,), {"tokens": []})
    server = HTTPServer(("127.0.0.1", 0), handler)
    server.handle_error = lambda *_: None  # type: ignore[method-assign]
    if made is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        made.configure_cert(context)
        server.socket = context.wrap_socket(server.socket, server_side=True)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,))
    thread.start()
    try:
        yield server.server_port, handler.tokens  # type: ignore[attr-defined]
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


@pytest.mark.parametrize("problem", [None, "authority", "name", "expired"])
def test_a_service_is_called_only_with_a_certificate_of_a_trusted_authority_for_its_name(
    problem: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trusted, other = trustme.CA(), trustme.CA()
    trusted.cert_pem.write_to_path(tmp_path / "ca.pem")
    monkeypatch.setenv("SSL_CERT_FILE", str(tmp_path / "ca.pem"))
    issuer = other if problem == "authority" else trusted
    now = wall_clock()
    until = now + timedelta(days=-1 if problem == "expired" else 1)
    name = "10.0.0.9" if problem == "name" else "127.0.0.1"
    made = issuer.issue_cert(name, not_before=now - timedelta(days=9), not_after=until)
    with running_server(made) as (port, tokens):
        client = HttpClient(f"https://127.0.0.1:{port}", TOKEN)
        if problem is None:
            assert asyncio.run(client.call("drives.list", {})) == {"drives": []}
            assert tokens == [f"Bearer {TOKEN}"]
            return
        with pytest.raises(ServiceUnavailable, match="certificate"):
            asyncio.run(client.call("drives.list", {}))
        assert tokens == []


@pytest.mark.parametrize(("is_local", "key"), [(True, "service.no_tls_local"), (False, "service.no_tls")])
def test_a_plain_http_page_behind_https_is_named_with_what_to_type(
    is_local: bool, key: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The text of the TLS library stood there: wrong version number."""
    monkeypatch.setattr(http_client, "is_loopback", lambda host: is_local)
    with running_server(None) as (port, tokens):
        with pytest.raises(ServiceUnavailable) as caught:
            asyncio.run(HttpClient(f"https://127.0.0.1:{port}", TOKEN).call("drives.list", {}))
        assert caught.value.key == key and tokens == []
        assert (f"--service http://127.0.0.1:{port}" in str(caught.value)) == is_local
