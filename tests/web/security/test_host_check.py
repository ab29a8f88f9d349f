"""Host and Origin: the names of this service, and the pages that may send requests."""

from __future__ import annotations

import socket

import pytest
from starlette.datastructures import Headers

from drivebus.web.gateway import WebConfig
from drivebus.web.middleware.host_check import HostCheck

WEB = WebConfig(host="Plant-PC", origins=("https://Plant.example/", "http://other.example:8080", "https://linux"))


def headers(**given: str | tuple[str, ...]) -> Headers:
    """Return headers; a tuple of values is a repeated header."""
    many = {name: [value] if isinstance(value, str) else value for name, value in given.items()}
    return Headers(raw=[(name.encode(), value.encode()) for name, values in many.items() for value in values])


@pytest.mark.parametrize(
    "host",
    [
        "localhost",
        "LOCALHOST:8080",
        "plant-pc",
        "PLANT-PC:1",
        "plant.example",
        "other.example",
        "127.0.0.1:8080",
        "[::1]:8080",
        socket.gethostname(),
    ],
)
def test_own_names_and_numeric_addresses_are_accepted(host: str) -> None:
    assert HostCheck(WEB).is_known_host(headers(host=host))


@pytest.mark.parametrize(
    "host",
    [
        (),
        ("localhost", "localhost"),
        ("localhost", "evil.example"),
        "evil.example",
        "plant.example.",
        "",
        ":8080",
        "[",
        "user@evil.example",
        "localhost@evil.example",
        "evil.example@127.0.0.1",
        "127.0.0.1#evil.example",
        "127.0.0.1/evil",
        "127.0.0.1?evil",
        "evil.example\\@127.0.0.1",
        "localhost:",
        "localhost:port",
        "127.0.0.1 ",
        "\t127.0.0.1",
        "[127.0.0.1",
        "[::1]evil",
    ],
)
def test_a_missing_repeated_or_foreign_host_is_denied(host: str | tuple[str, ...]) -> None:
    """Two Host headers are ambiguous."""
    assert HostCheck(WEB).is_known_host(headers(host=host)) is False


@pytest.mark.parametrize(
    ("origin", "scheme"),
    [
        ("http://plant-pc:8080", "http"),
        ("http://plant-pc:8080", "ws"),
        ("https://plant-pc:8080", "https"),
        ("https://plant-pc:8080", "wss"),
        ("HTTP://PLANT-PC:8080", "http"),
        ("https://plant.example", "http"),
        ("https://PLANT.example", "ws"),
        ("http://other.example:8080", "https"),
        ("https://linux", "http"),
    ],
)
def test_the_page_of_this_service_and_configured_origins_are_accepted(origin: str, scheme: str) -> None:
    assert HostCheck(WEB).is_allowed_origin(headers(host="Plant-PC:8080", origin=origin), scheme)


@pytest.mark.parametrize(
    ("scheme", "origin"), [("http", "http://plant.example"), ("https", "https://other.example:8080")]
)
def test_a_page_without_the_tls_of_its_proxy_is_foreign(scheme: str, origin: str) -> None:
    """Behind a proxy with TLS a request comes over HTTP; a page that was loaded over HTTP may be a foreign one."""
    host = origin.partition("://")[2]
    assert HostCheck(WEB).is_allowed_origin(headers(host=host, origin=origin), scheme) is False


@pytest.mark.parametrize(
    ("host", "origin", "scheme", "uses_tls"),
    [
        ("127.0.0.1", (), "https", True),
        ("127.0.0.1", (), "wss", True),
        ("Plant.Example", (), "http", True),
        ("plant.example:8080", (), "http", False),
        ("other.example:8080", (), "ws", False),
        ((), (), "http", False),
        ("127.0.0.1:8080", "https://Plant.example", "http", True),
        ("127.0.0.1:8080", "http://other.example:8080", "http", False),
        ("127.0.0.1:8080", "https://foreign.example", "http", False),
        ("127.0.0.1:8080", "http://plant.example/https://", "http", False),
    ],
)
def test_tls_is_known_by_the_scheme_and_by_the_configured_origin_of_a_proxy(
    host: str, origin: str, scheme: str, uses_tls: bool
) -> None:
    """The proxy may leave the name of its Host, or replace it by this service's own."""
    assert HostCheck(WEB).uses_tls(headers(host=host, origin=origin), scheme) is uses_tls


@pytest.mark.parametrize(
    ("origin", "scheme"),
    [
        ((), "http"),
        (("http://plant-pc:8080", "http://plant-pc:8080"), "http"),
        ("https://plant-pc:8080", "http"),
        ("http://plant-pc:8080", "wss"),
        ("https://plant-pc:8080", "ws"),
        ("http://plant.example", "http"),
        ("https://other.example:8080", "https"),
        ("", "http"),
        ("null", "http"),
    ],
)
def test_a_missing_repeated_or_foreign_origin_is_denied(origin: str | tuple[str, ...], scheme: str) -> None:
    assert HostCheck(WEB).is_allowed_origin(headers(host="Plant-PC:8080", origin=origin), scheme) is False
