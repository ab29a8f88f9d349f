"""Host and Origin: under which names this service is reached, and which pages may send requests."""

from __future__ import annotations

import socket

import pytest
from starlette.datastructures import Headers

from drivebus.web.gateway import WebConfig
from drivebus.web.middleware.host_check import HostCheck

WEB = WebConfig(host="Plant-PC", origins=("https://Plant.example/", "http://other.example:8080", "https://linux"))


def headers(**given: str | tuple[str, ...]) -> Headers:
    """With several of one name where several are given."""
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
def test_our_own_names_and_addresses_in_digits_are_known(host: str) -> None:
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
    ],
)
def test_no_name_two_names_and_a_strangers_are_not(host: str | tuple[str, ...]) -> None:
    """Of two Host headers nobody knows which the browser meant."""
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
def test_the_page_of_this_service_and_those_of_the_configuration_may_send(origin: str, scheme: str) -> None:
    assert HostCheck(WEB).is_allowed_origin(headers(host="Plant-PC:8080", origin=origin), scheme)


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
def test_no_page_two_pages_and_a_strangers_may_not(origin: str | tuple[str, ...], scheme: str) -> None:
    assert HostCheck(WEB).is_allowed_origin(headers(host="Plant-PC:8080", origin=origin), scheme) is False
