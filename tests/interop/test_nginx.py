"""The sample configuration of nginx in front of the page: TLS, live values, and the client's own address."""

from __future__ import annotations

import asyncio
import json
import re
import socket
import ssl
import subprocess
import time
from collections.abc import Iterator
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path

import httpx
import trustme
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

import peers
from drivebus.cli.demo.host import free_port
from drivebus.service.auth.rights import Role
from drivebus.web.gateway import WebConfig
from fixtures.running_service import http_service, token

SAMPLE = Path(__file__).resolve().parents[2] / "examples" / "nginx.conf"
START_TIMEOUT_S = 10.0
PROGRAM = """daemon off;
pid {folder}/nginx.pid;
error_log {folder}/error.log;
events {{ }}
http {{
    access_log off;
    client_body_temp_path {folder}/body;
    proxy_temp_path {folder}/proxy;
    fastcgi_temp_path {folder}/fastcgi;
    uwsgi_temp_path {folder}/uwsgi;
    scgi_temp_path {folder}/scgi;
{sample}
}}
"""


def settings(folder: Path, ports: tuple[int, int, int]) -> str:
    """Return the sample with the ports, names and files of this test."""
    plain, tls, upstream = ports
    own = {
        "listen 80;": f"listen 127.0.0.1:{plain};",
        "listen 443 ssl;": f"listen 127.0.0.1:{tls} ssl;",
        "https://plant.example$": f"https://127.0.0.1:{tls}$",
        "server_name plant.example;": "server_name 127.0.0.1;",
        "/etc/nginx/plant.crt": f"{folder}/plant.crt",
        "/etc/nginx/plant.key": f"{folder}/plant.key",
        "127.0.0.1:8080": f"127.0.0.1:{upstream}",
    }
    sample = SAMPLE.read_text(encoding="utf-8")
    for printed, here in own.items():
        assert printed in sample, printed
        sample = sample.replace(printed, here)
    return PROGRAM.format(folder=folder, sample=sample)


@contextmanager
def running_nginx(folder: Path, text: str, port: int) -> Iterator[None]:
    program = peers.need_program("nginx", "nginx")
    file = folder / "nginx.conf"
    file.write_text(text, encoding="utf-8")
    with subprocess.Popen([program, "-p", str(folder), "-c", str(file)]) as process:
        try:
            deadline = time.monotonic() + START_TIMEOUT_S
            while time.monotonic() < deadline and process.poll() is None:
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", port)) == 0:
                        break
                time.sleep(0.05)
            assert process.poll() is None, (folder / "error.log").read_text()
            yield
        finally:
            process.terminate()


def test_the_sample_of_nginx_carries_page_live_values_and_the_address_of_the_client(tmp_path: Path) -> None:
    peers.need_program("nginx", "nginx")
    authority = trustme.CA()
    certificate = authority.issue_cert("127.0.0.1")
    certificate.private_key_and_cert_chain_pem.write_to_path(tmp_path / "plant.key")
    certificate.private_key_and_cert_chain_pem.write_to_path(tmp_path / "plant.crt")
    trust = ssl.create_default_context()
    authority.configure_trust(trust)
    plain, tls = free_port(0), free_port(0)
    origin = f"https://127.0.0.1:{tls}"
    web = WebConfig(origins=(origin,), trusted_proxies=("127.0.0.1",))
    (tmp_path / "state").mkdir()
    with http_service(tmp_path / "state", web=web) as plant:
        upstream = int(re.sub(r".*:", "", plant.url))
        with running_nginx(tmp_path, settings(tmp_path, (plain, tls, upstream)).replace(" 128;", " 3;"), tls):
            moved = httpx.get(f"http://127.0.0.1:{plain}/#/drives")
            assert (moved.status_code, moved.headers["location"]) == (301, f"{origin}/")
            for path in ("/api/v1/drives", "/metrics"):  # a program that sends its token in clear text does not work
                assert httpx.get(f"http://127.0.0.1:{plain}{path}").status_code == 403, path
            own_address = httpx.HTTPTransport(verify=trust, local_address="127.0.0.2")
            with httpx.Client(base_url=origin, transport=own_address, headers={"Origin": origin}) as client:
                page = client.get("/")
                assert page.status_code == 200 and page.headers["strict-transport-security"] == "max-age=31536000"
                forwarded = {"X-Forwarded-For": "198.51.100.7"}  # what a client claims stays left of its own address
                refused = client.post(
                    "/api/v1/login", json={"name": "operator", "password": "wrong password"}, headers=forwarded
                )
                assert refused.status_code == 401
                engineer = {"Authorization": f"Bearer {token(Role.ENGINEER)}"}
                records = client.get("/api/v1/audit", headers=engineer).json()["items"]
                (denied,) = [record for record in records if record["what"] == "refused"]
                assert denied["who"]["address"] == "127.0.0.2", "neither the proxy's nor the claimed one"
                bearer = {"Authorization": f"Bearer {token(Role.OPERATOR)}"}
                assert client.get("/api/v1/drives", headers=bearer).status_code == 200
                foreign = client.get("/api/v1/session", headers={"Host": "evil.example"})
                assert foreign.status_code in (400, 403, 421)

            async def refused_connections(count: int) -> int:
                async with AsyncExitStack() as stack:
                    for number in range(count):
                        live = connect(f"wss://127.0.0.1:{tls}/api/v1/live", ssl=trust, additional_headers=bearer)
                        try:
                            await stack.enter_async_context(live)
                        except InvalidStatus as error:
                            assert error.response.status_code == 503
                            return count - number
                return 0

            assert asyncio.run(refused_connections(4)) == 1, "one client does not take every connection"

            async def first_message() -> str:
                async with connect(
                    f"wss://127.0.0.1:{tls}/api/v1/live?topics=plant", ssl=trust, additional_headers=bearer
                ) as live:
                    return str(json.loads(await live.recv())["type"])

            assert asyncio.run(first_message()) == "snapshot"
