"""The server: its address, TLS, and clients that are too slow or too many."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import json
import os
import resource
import socket
import ssl
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx
import pytest
import trustme
from fastapi import FastAPI
from starlette.websockets import WebSocket, WebSocketDisconnect
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed

from drivebus.errors import ConfigurationError
from drivebus.service.auth.errors import NotAuthenticated
from drivebus.service.auth.service import AuthService
from drivebus.service.auth.users import UserDatabase
from drivebus.service.ipc.client import SocketClient
from drivebus.service.process.gateway_arguments import GatewayArguments
from drivebus.web import __main__ as web_process
from drivebus.web import listener
from drivebus.web import server as web_server
from drivebus.web.gateway import WebConfig
from drivebus.web.listener import BoundedListener, limited_network
from drivebus.web.middleware import connection_limits
from drivebus.web.server import (
    ClosedConnectionsLog,
    EmbeddedServer,
    HttpServer,
    bind_listener,
    is_loopback,
    listen_host,
    server_config,
)
from drivebus.web.tls import TlsContext
from fixtures.web_app import PASSWORD, USERS, WebAppHarness


@contextlib.asynccontextmanager
async def serving(harness: WebAppHarness, web: WebConfig) -> AsyncIterator[list[str]]:
    """Return the addresses that the server listened at, the newest last."""
    addresses: list[str] = []
    listening = asyncio.Event()

    def on_address(address: str) -> None:
        addresses.append(address)
        listening.set()

    ending = asyncio.Event()
    server = HttpServer(harness.app, harness.auth, web, on_address, ending)
    task = asyncio.create_task(server.run())
    await asyncio.wait({asyncio.create_task(listening.wait()), task}, return_when=asyncio.FIRST_COMPLETED)
    try:
        yield addresses
    finally:
        ending.set()
        await task


def where(at: str) -> tuple[str, int]:
    host, _, port = at.partition("://")[2].rpartition(":")
    return host, int(port)


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[WebConfig, ssl.SSLContext]:
    """Return TLS settings for 127.0.0.1, and a client context that trusts them."""
    authority = trustme.CA()
    made = authority.issue_cert("127.0.0.1", "localhost")
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    made.cert_chain_pems[0].write_to_path(certificate)
    made.private_key_pem.write_to_path(key)
    trusting = ssl.create_default_context()
    authority.configure_trust(trusting)
    return WebConfig(port=0, certificate=certificate, key=key), trusting


@pytest.mark.parametrize("host", ["127.0.0.1", "::1", "127.0.0.53", "localhost", "0.0.0.0", "::", "10.1.2.3", "plant"])
def test_the_server_is_on_loopback_unless_there_is_tls_and_an_administrator(host: str, tmp_path: Path) -> None:
    certificate = tmp_path / "cert.pem"
    for users in (False, True):
        access = WebAppHarness(tmp_path / str(users), users=users).auth
        assert access.needs_setup is not users
        for tls in (None, certificate):
            found = listen_host(WebConfig(host=host, certificate=tls), access)
            assert found == (host if is_loopback(host) or (tls and users) else "127.0.0.1")


def test_a_page_that_names_missing_users_is_reached_where_the_page_was(tmp_path: Path) -> None:
    missing = AuthService(tmp_path, had_users=True)
    assert missing.users_missing
    assert listen_host(WebConfig(host="10.1.2.3", certificate=tmp_path / "cert.pem"), missing) == "10.1.2.3"
    assert listen_host(WebConfig(host="10.1.2.3"), missing) == "127.0.0.1"


async def test_the_real_socket_is_on_loopback_without_tls_whatever_the_setting(tmp_path: Path) -> None:
    harness = WebAppHarness(tmp_path)
    async with serving(harness, WebConfig(host="0.0.0.0", port=0)) as text:
        assert where(text[0])[0] == "127.0.0.1"
        sockets = await asyncio.to_thread(Path("/proc/self/net/tcp").read_text)
        listening = [line.split()[1] for line in sockets.splitlines()[1:]]
        port = f"{where(text[0])[1]:04X}"
        assert [address.partition(":")[0] for address in listening if address.endswith(port)] == ["0100007F"]


async def test_the_server_moves_to_its_address_when_the_first_administrator_exists(
    tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext]
) -> None:
    """127.0.0.2 stands for an external address: no test binds to one that others reach."""
    web, trusting = certificate
    harness = WebAppHarness(tmp_path / "state", users=False, web=web)
    moved = replace(web, host="127.0.0.2")
    with pytest.MonkeyPatch.context() as context:
        context.setattr("drivebus.web.server.is_loopback", lambda host: host == "127.0.0.1")
        async with serving(harness, moved) as text, asyncio.timeout(60):
            assert where(text[0])[0] == "127.0.0.1"
            secret = harness.auth.setup_secret.issue()
            async with httpx.AsyncClient(verify=trusting, base_url=text[0]) as client:
                body = {"secret": secret, "name": "ann", "password": PASSWORD}
                assert (await client.post("/api/v1/setup", json=body)).status_code == 200
            while len(text) < 2:  # noqa: ASYNC110  asyncio.timeout ends it
                await asyncio.sleep(0.05)
            assert where(text[1])[0] == "127.0.0.2"


async def test_a_server_that_ends_in_order_gives_each_websocket_the_reason(tmp_path: Path) -> None:
    """Regression: while a service that was ending stopped its drives, the page had lost it without a reason."""
    harness = WebAppHarness(tmp_path)
    secret = await harness.token("viewer", "view")
    messages: list[Any] = []
    async with serving(harness, WebConfig(port=0)) as text:
        host, port = where(text[0])
        live = await connect(
            f"ws://{host}:{port}/api/v1/live", additional_headers={"Authorization": f"Bearer {secret}"}
        )
        messages.append(json.loads(await live.recv()))
    with pytest.raises(ConnectionClosed):
        while True:
            messages.append(json.loads(await live.recv()))
    assert [message["type"] for message in messages] == ["snapshot", "closed"]
    assert (messages[-1]["reason"], live.close_code) == ("shutdown", 1012)


async def served_certificate(host: str, port: int) -> bytes:
    """Return the certificate that a new handshake gets."""
    anyone = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    anyone.check_hostname, anyone.verify_mode = False, ssl.CERT_NONE
    _, writer = await asyncio.open_connection(host, port, ssl=anyone)
    try:
        return bytes(writer.get_extra_info("ssl_object").getpeercert(binary_form=True))
    finally:
        writer.close()


async def test_a_renewed_certificate_is_used_for_new_connections_and_an_open_one_goes_on(
    tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext]
) -> None:
    """A certificate without its key changes nothing until the key is there, too."""
    web, trusting = certificate
    assert web.certificate is not None and web.key is not None
    renewed = trustme.CA().issue_cert("127.0.0.1")
    expected = ssl.PEM_cert_to_DER_cert(renewed.cert_chain_pems[0].bytes().decode())
    with pytest.MonkeyPatch.context() as context:
        context.setattr("drivebus.web.server._CHECK_INTERVAL_S", 0.02)
        async with serving(WebAppHarness(tmp_path / "state", web=web), web) as text, asyncio.timeout(60):
            before = await served_certificate(*where(text[0]))
            async with httpx.AsyncClient(verify=trusting, base_url=text[0]) as client:
                assert (await client.get("/api/v1/health")).status_code == 200
                renewed.cert_chain_pems[0].write_to_path(web.certificate)
                await asyncio.sleep(0.1)
                assert await served_certificate(*where(text[0])) == before
                renewed.private_key_pem.write_to_path(web.key)
                while await served_certificate(*where(text[0])) != expected:  # noqa: ASYNC110  asyncio.timeout ends it
                    await asyncio.sleep(0.02)
                assert (await client.get("/api/v1/health")).status_code == 200
            assert len(text) == 1


async def test_a_reload_uses_a_renewed_certificate_whether_or_not_its_files_look_changed(
    tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext]
) -> None:
    web, _ = certificate
    assert web.certificate is not None and web.key is not None
    tls, renewed = TlsContext(web), trustme.CA().issue_cert("127.0.0.1")
    renewed.cert_chain_pems[0].write_to_path(web.certificate)
    renewed.private_key_pem.write_to_path(web.key)
    tls._files = tls._file_state()
    harness = WebAppHarness(tmp_path / "state", web=web)
    server = HttpServer(harness.app, harness.auth, web, print, asyncio.Event())
    server.reload_certificate()
    server._tls = tls
    for reload, expected in ((tls.follow_files, False), (server.reload_certificate, True)):
        reload()
        listener = await asyncio.start_server(lambda reader, writer: None, "127.0.0.1", 0, ssl=tls.context)
        found = await served_certificate("127.0.0.1", listener.sockets[0].getsockname()[1])
        assert (found == ssl.PEM_cert_to_DER_cert(renewed.cert_chain_pems[0].bytes().decode())) is expected
        listener.close()


async def test_a_key_that_becomes_readable_later_is_noticed(
    tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext]
) -> None:
    """``chmod`` changes neither the time of the content nor its size: the new pair was never tried again."""
    web, _ = certificate
    assert web.key is not None
    tls = TlsContext(web)
    web.key.chmod(0o400)
    assert tls._file_state() != tls._files


@pytest.mark.filterwarnings("ignore:ssl.TLSVersion:DeprecationWarning")
async def test_only_tls_1_2_and_newer_is_accepted_with_hsts(
    tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext]
) -> None:
    web, trusting = certificate
    harness = WebAppHarness(tmp_path / "state", web=web)
    async with serving(harness, web) as text:
        host, port = where(text[0])
        assert text[0].startswith("https://")
        async with httpx.AsyncClient(verify=trusting, base_url=text[0]) as client:
            answer = await client.post("/api/v1/login", json={"name": "operator", "password": PASSWORD})
            assert answer.headers["set-cookie"].startswith("__Host-drivebus=")
            assert "max-age=31536000" in answer.headers["strict-transport-security"]
        for newest, works in ((ssl.TLSVersion.TLSv1_1, False), (ssl.TLSVersion.TLSv1_2, True)):
            old = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
            old.check_hostname, old.verify_mode = False, ssl.CERT_NONE
            old.minimum_version, old.maximum_version = ssl.TLSVersion.MINIMUM_SUPPORTED, newest
            old.set_ciphers("ALL:@SECLEVEL=0")
            try:
                _, writer = await asyncio.open_connection(host, port, ssl=old)
            except (ssl.SSLError, ConnectionError):
                assert not works
                continue
            assert works
            writer.close()
        assert not await raw_response(host, port, b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")


@pytest.mark.parametrize(
    ("suites", "works"),
    [
        ("ECDHE+AESGCM", True),
        ("ECDHE+CHACHA20", True),
        ("AES128-GCM-SHA256:AES256-GCM-SHA384:AES128-SHA256", False),  # the key of the session is encrypted, RFC 9325
        ("ECDHE-ECDSA-AES128-SHA:ECDHE-RSA-AES128-SHA:AES128-SHA", False),  # SHA-1
        ("aNULL", False),
        ("eNULL", False),
    ],
)
async def test_only_cipher_suites_with_forward_secrecy_and_without_sha_1_are_accepted(
    suites: str, works: bool, tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext]
) -> None:
    web, _ = certificate
    async with serving(WebAppHarness(tmp_path / "state", web=web), web) as text:
        client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        client.check_hostname, client.verify_mode = False, ssl.CERT_NONE
        client.maximum_version = ssl.TLSVersion.TLSv1_2
        client.set_ciphers(f"{suites}:@SECLEVEL=0")
        try:
            _, writer = await asyncio.open_connection(*where(text[0]), ssl=client)
        except (ssl.SSLError, ConnectionError):
            assert not works
        else:
            assert works
            writer.close()


async def raw_response(host: str, port: int, request: bytes) -> bytes:
    """Return the bytes that a raw connection gets until it is closed or reset."""
    reader, writer = await asyncio.open_connection(host, port)
    writer.write(request)
    try:
        return await asyncio.wait_for(reader.read(), 5)
    except ConnectionError:
        return b""
    finally:
        writer.close()


@pytest.mark.parametrize(
    "head",
    [
        b"",
        b"GET / HT",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: ",
        b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\nGET / ",
    ],
    ids=["nothing", "half a line", "half a head", "half of a second request"],
)
async def test_unfinished_headers_end_the_connection(head: bytes, tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as context:
        context.setattr(connection_limits, "HEADER_TIMEOUT_S", 0.2)
        async with serving(WebAppHarness(tmp_path), WebConfig(port=0)) as text:
            begun = asyncio.get_running_loop().time()
            found = await raw_response(*where(text[0]), head)
            assert asyncio.get_running_loop().time() - begun < 4
            assert found.count(b"200 OK") == head.count(b"\r\n\r\n")


async def test_a_head_without_end_is_cut(tmp_path: Path) -> None:
    async with serving(WebAppHarness(tmp_path), WebConfig(port=0)) as text:
        head = b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX-A: " + b"a" * (connection_limits.MAX_HEADER_BYTES + 1)
        assert await raw_response(*where(text[0]), head) == b""
        fits = b"GET /api/v1/health HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\nX-A: " + b"a" * 20_000
        assert b"200 OK" in await raw_response(*where(text[0]), fits + b"\r\n\r\n")


async def test_the_limit_of_the_headers_is_exact_however_they_arrive(tmp_path: Path) -> None:
    """All in one piece, too."""
    async with serving(WebAppHarness(tmp_path), WebConfig(port=0)) as text:
        path, lines = b"/api/v1/health", b"Host: 127.0.0.1\r\nConnection: close\r\n"
        used = len(path) + len(lines)
        for size, status in (
            (connection_limits.MAX_HEADER_BYTES, b" 200 "),
            (connection_limits.MAX_HEADER_BYTES + 1, b" 400 "),
        ):
            rest = b"X-A: " + b"a" * (size - used - 7) + b"\r\n"
            found = await raw_response(*where(text[0]), b"GET %b HTTP/1.1\r\n%b%b\r\n" % (path, lines, rest))
            assert status in found.split(b"\r\n")[0] + b" "


async def test_a_large_body_sent_together_with_its_head_is_read(tmp_path: Path) -> None:
    """A mebibyte is allowed where a right is needed, in whatever pieces it arrives."""
    harness = WebAppHarness(tmp_path)
    secret = await harness.token("operator", "stop")
    async with serving(harness, WebConfig(port=0)) as text:
        body = b"{" + b" " * 200_000 + b"}"
        kind = b"Content-Type: application/json\r\nConnection: close\r\n"
        head = b"POST /api/v1/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer %b\r\n" % secret.encode() + kind
        found = await raw_response(*where(text[0]), head + b"Content-Length: %d\r\n\r\n" % len(body) + body)
        assert found.startswith(b"HTTP/1.1 200 ")


async def test_trailers_are_no_headers(tmp_path: Path) -> None:
    """A proxy that passes trailers on adds no address to them: X-Forwarded-For there is the client's invention."""
    harness = WebAppHarness(tmp_path)
    secret = await harness.token("operator", "stop")
    async with serving(harness, WebConfig(port=0)) as text:
        head = b"POST /api/v1/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nTransfer-Encoding: chunked\r\nConnection: close\r\n"
        authorization = b"Authorization: Bearer %b\r\n" % secret.encode()
        kind = b"Content-Type: application/json\r\n"
        for headers, trailers, status in ((authorization, b"Host: evil\r\n", b" 200 "), (b"", authorization, b" 401 ")):
            request = head + kind + headers + b"\r\n2\r\n{}\r\n0\r\n" + trailers + b"\r\n"
            assert status in (await raw_response(*where(text[0]), request)).split(b"\r\n")[0]


async def test_an_unwanted_body_is_not_awaited(tmp_path: Path) -> None:
    async with serving(WebAppHarness(tmp_path), WebConfig(port=0)) as text:
        begun = asyncio.get_running_loop().time()
        head = b"POST /api/v1/stop HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 104857600\r\n\r\n" + b"x" * 1000
        assert b" 401 " in await raw_response(*where(text[0]), head)
        get = b"GET /api/v1/health HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Length: 104857600\r\n\r\n" + b"x" * 1000
        assert b" 200 " in await raw_response(*where(text[0]), get)
        assert asyncio.get_running_loop().time() - begun < 4


async def test_an_unread_response_ends_the_connection(tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as context:
        context.setattr(connection_limits, "WRITE_STALL_TIMEOUT_S", 0.2)
        async with serving(WebAppHarness(tmp_path), WebConfig(port=0)) as text:
            unread = socket.socket()  # its kernel buffers 4 kB, the server's a few hundred: then nothing moves
            unread.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            unread.setblocking(False)
            await asyncio.get_running_loop().sock_connect(unread, where(text[0]))
            ask = b"GET /i18n/zh.json HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n"
            for _ in range(3000):
                with contextlib.suppress(OSError):
                    unread.send(ask)
                await asyncio.sleep(0.02)
                if unread.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
                    break
            else:
                pytest.fail("still connected")
            unread.close()


def flooding_app() -> FastAPI:
    """Return an app with the WebSockets ``/flood``, which sends without end, and ``/closed``, closed at once."""
    app = FastAPI()

    async def flood(socket: WebSocket) -> None:
        await socket.accept()
        with contextlib.suppress(WebSocketDisconnect):
            while True:
                await socket.send_text("x" * 100_000)

    async def closed(socket: WebSocket) -> None:
        await socket.accept()
        await socket.close(1013, "many")

    app.add_api_websocket_route("/flood", flood)
    app.add_api_websocket_route("/closed", closed)
    return app


@pytest.mark.parametrize(
    ("path", "limit"), [("/flood", "WRITE_STALL_TIMEOUT_S"), ("/closed", "WEBSOCKET_CLOSE_TIMEOUT_S")]
)
async def test_a_websocket_that_is_not_read_or_does_not_end_keeps_no_connection(path: str, limit: str) -> None:
    """The connection ends although the data that waits for it cannot be sent."""
    with pytest.MonkeyPatch.context() as context:
        context.setattr(connection_limits, limit, 0.2)
        listener = bind_listener("127.0.0.1", 0)
        server = EmbeddedServer(server_config(flooding_app()))
        serving = asyncio.create_task(server.serve([listener]))
        unread = socket.socket()  # never read
        unread.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        unread.setblocking(False)
        await asyncio.get_running_loop().sock_connect(unread, listener.getsockname())
        more = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13"
        key = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA=="
        unread.send(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\n{more}\r\n{key}\r\n\r\n".encode())
        async with asyncio.timeout(60):
            for there in (True, False):
                while bool(server.server_state.connections) is not there:  # noqa: ASYNC110
                    await asyncio.sleep(0.01)
        unread.close()
        server.should_exit = True
        await serving


async def test_a_garbage_collection_does_not_traverse_the_whole_app(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full traversal takes 0.1 s, which would delay a stop over the web."""
    frozen: list[int] = []

    async def run(_: HttpServer) -> None:
        frozen.append(gc.get_freeze_count())

    monkeypatch.setattr(HttpServer, "run", run)
    before = gc.get_freeze_count()
    try:
        socket = tmp_path / "plant.sock"
        arguments = GatewayArguments(
            socket=socket, directory=tmp_path, user_file=tmp_path / "users.json", settings=WebConfig(port=0)
        )
        await web_process.WebProcess().serve(SocketClient(socket), arguments, asyncio.Event())
    finally:
        gc.unfreeze()
    assert frozen[0] > before


@pytest.mark.parametrize("left_by", ["this process", "the one before"])
async def test_a_set_up_secret_ends_with_its_file_where_an_administrator_is_added_on_the_command_line(
    tmp_path: Path, left_by: str
) -> None:
    """It stayed valid until the next start: where an older file of users was put back, it set the plant up."""
    harness = WebAppHarness(tmp_path, users=False)
    secret = harness.auth.setup_secret.issue()
    if left_by == "the one before":
        harness = WebAppHarness(tmp_path, users=False)
    async with serving(harness, WebConfig(port=0)):
        assert (tmp_path / "setup-secret").exists()
        harness.auth.user_file.change(lambda _: USERS)
        while (tmp_path / "setup-secret").exists():  # noqa: ASYNC110  the server looks every second
            await asyncio.sleep(0.05)
        harness.auth.user_file.change(lambda _: UserDatabase())
        with pytest.raises(NotAuthenticated):
            await harness.auth.create_first_administrator(secret, "eve", "a long enough pass phrase", "127.0.0.1")


async def test_a_stop_works_beside_500_idle_connections(tmp_path: Path) -> None:
    """Idle connections are closed after a timeout; until then there is capacity for others."""
    harness = WebAppHarness(tmp_path)
    with pytest.MonkeyPatch.context() as context:
        context.setattr(connection_limits, "HEADER_TIMEOUT_S", 1.0)
        async with serving(harness, WebConfig(port=0)) as text:
            idle = [await asyncio.open_connection(*where(text[0])) for _ in range(500)]
            async with httpx.AsyncClient(base_url=text[0]) as client:
                login = await client.post("/api/v1/login", json={"name": "operator", "password": PASSWORD})
                headers = {"x-drivebus-csrf": login.json()["csrf"]}
                assert (await client.post("/api/v1/stop", headers=headers)).status_code == 200
            ended = await asyncio.gather(
                *(asyncio.wait_for(reader.read(), 60) for reader, _ in idle), return_exceptions=True
            )
            assert not [outcome for outcome in ended if isinstance(outcome, TimeoutError)]
            for _, writer in idle:
                writer.close()
    assert [call[0] for call in harness.service.calls] == ["plant.stop"]


def test_a_network_of_one_client_is_an_ipv4_address_or_an_ipv6_64_and_this_machine_is_exempt() -> None:
    """A reverse proxy connects from this machine."""
    found = {
        "10.0.0.9": "10.0.0.9",
        "::ffff:10.0.0.9": "10.0.0.9",
        "2001:db8:0:1::9": "2001:db8:0:1::/64",
        "2001:db8:0:1:ffff::1": "2001:db8:0:1::/64",
        "2001:db8:0:2::9": "2001:db8:0:2::/64",
        "fe80::1%eth0": "fe80::/64",
        "127.0.0.1": None,
        "::1": None,
        "::ffff:127.0.0.1": None,
    }
    assert {address: limited_network(address) for address in found} == found


@pytest.fixture
def few_connections(monkeypatch: pytest.MonkeyPatch) -> Iterator[BoundedListener]:
    monkeypatch.setattr(listener, "MAX_CONNECTIONS", 3)
    monkeypatch.setattr(listener, "OVERLOAD_CONNECTIONS", 1)
    found = bind_listener("127.0.0.1", 0)
    found.setblocking(False)
    yield found
    found.close()


def connections_to(found: BoundedListener, count: int) -> list[socket.socket]:
    return [socket.create_connection(found.getsockname()) for _ in range(count)]


def accepted_by(found: BoundedListener) -> list[socket.socket]:
    taken = []
    with contextlib.suppress(BlockingIOError):
        while True:
            taken.append(found.accept()[0])
    return taken


def close_all(*sockets: socket.socket) -> None:
    for connection in sockets:
        connection.close()


def test_connections_beyond_the_limit_are_closed_as_soon_as_they_are_accepted(few_connections: BoundedListener) -> None:
    clients = connections_to(few_connections, 7)
    taken = accepted_by(few_connections)
    assert len(taken) == 4
    for refused in clients[4:]:
        refused.settimeout(5)
        assert refused.recv(1) == b""
    taken.pop().close()
    late = connections_to(few_connections, 1)
    again = accepted_by(few_connections)
    assert len(again) == 1
    close_all(*clients, *late, *taken, *again)


def test_connections_that_were_closed_are_logged_once_a_minute_however_many_there_are(
    few_connections: BoundedListener, caplog: pytest.LogCaptureFixture
) -> None:
    """A page out of reach is otherwise a riddle: the log of the service says nothing of the flood."""
    log = ClosedConnectionsLog(few_connections)
    log.report(100.0)
    clients, taken = [], []
    for now in (100.5, 101.0, 159.0, 161.0, 300.0):
        if now < 160.0:
            clients += connections_to(few_connections, 5)
            taken += accepted_by(few_connections)
        log.report(now)
    lines = [record.getMessage() for record in caplog.records]
    assert [line.partition(";")[0] for line in lines] == [f"connections closed at once: {n}" for n in (1, 10)]
    assert "; open: 4, and the limit is" in lines[0] and "stop --all" in lines[0]
    close_all(*clients, *taken)


def test_one_client_does_not_take_every_connection(
    few_connections: BoundedListener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listener, "MAX_CONNECTIONS_PER_ADDRESS", 2)
    monkeypatch.setattr(listener, "limited_network", lambda address: "10.0.0.9")
    clients = connections_to(few_connections, 3)
    taken = accepted_by(few_connections)
    assert len(taken) == 2
    close_all(*clients, *taken)


@pytest.mark.parametrize(("proxies", "accepted"), [(("127.0.0.0/8",), 3), (("10.0.0.1",), 2)])
def test_a_trusted_proxy_may_have_every_connection(
    proxies: tuple[str, ...], accepted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The connections of all its clients have its address."""
    monkeypatch.setattr(listener, "MAX_CONNECTIONS_PER_ADDRESS", 2)
    monkeypatch.setattr(listener, "limited_network", lambda address: "10.0.0.9")
    bound = bind_listener("127.0.0.1", 0, proxies)
    bound.setblocking(False)
    assert isinstance(bound, BoundedListener)
    clients = connections_to(bound, 3)
    taken = accepted_by(bound)
    assert len(taken) == accepted
    close_all(*clients, *taken, bound)


def test_a_reserved_descriptor_that_cannot_be_opened_again_is_not_closed_twice(
    few_connections: BoundedListener, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def fail(*_: object) -> int:
        raise OSError(errno.EMFILE, "Too many open files")

    reserve = few_connections._reserve
    with monkeypatch.context() as full:
        full.setattr(os, "open", fail)
        with pytest.raises(OSError, match="Too many"):
            few_connections._close_waiting()
    other = os.open(tmp_path, os.O_RDONLY)
    assert other == reserve, "the number is that of another file now"
    with pytest.raises(BlockingIOError):
        few_connections._close_waiting()
    assert few_connections._reserve not in (-1, other)
    assert os.path.samestat(os.fstat(other), tmp_path.stat())
    os.close(other)


def test_without_free_descriptors_waiting_connections_are_closed(few_connections: BoundedListener) -> None:
    clients = connections_to(few_connections, 2)
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    highest = max(int(entry.name) for entry in Path("/proc/self/fd").iterdir()) + 1
    fillers: list[int] = []
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (highest, before[1]))
        with contextlib.suppress(OSError):
            while True:
                fillers.append(os.open(os.devnull, os.O_RDONLY))
        assert accepted_by(few_connections) == []
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
        for filler in fillers:
            os.close(filler)
    for refused in clients:
        refused.settimeout(5)
        assert refused.recv(1) == b""
    close_all(*clients)


async def test_a_tls_handshake_that_does_not_end_is_cut(
    tmp_path: Path, certificate: tuple[WebConfig, ssl.SSLContext], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(web_server, "TLS_HANDSHAKE_TIMEOUT_S", 0.2)
    web, _ = certificate
    async with serving(WebAppHarness(tmp_path / "state", web=web), web) as text:
        assert await raw_response(*where(text[0]), b"\x16\x03\x01") == b""


@pytest.mark.parametrize("host", ["plant..local", "h" * 64 + ".local"])
async def test_a_host_that_no_name_server_can_be_asked_for_is_named_in_the_error(host: str) -> None:
    """An empty or too long part of the name ended the web process with a traceback."""
    with pytest.raises(ConfigurationError) as raised:
        bind_listener(host, 0)
    assert (raised.value.key, raised.value.params["host"]) == ("auth.can_not_listen", host)


async def test_a_used_port_and_an_invalid_certificate_are_named_in_the_error(tmp_path: Path) -> None:
    taken = bind_listener("127.0.0.1", 0)
    with pytest.raises(ConfigurationError) as raised:
        bind_listener("127.0.0.1", taken.getsockname()[1])
    assert raised.value.key == "auth.can_not_listen"
    taken.close()
    web = WebConfig(port=0, certificate=tmp_path / "missing.pem")
    with pytest.raises(ConfigurationError) as raised:
        async with serving(WebAppHarness(tmp_path), web):
            pytest.fail("listens")
    assert raised.value.key == "auth.certificate"
