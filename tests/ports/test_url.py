"""Port URLs: parsed, completed by arguments, rejected with the text found and the remedy."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from drivebus.errors import PortUrlError
from drivebus.ports import open_port
from drivebus.ports.url import parse_port_url
from drivebus.serial_settings import SerialSettings


@pytest.mark.parametrize(
    ("text", "scheme", "host", "port", "path"),
    [
        ("/dev/ttyUSB0", "serial", "", None, "/dev/ttyUSB0"),
        ("COM3", "serial", "COM3", None, "COM3"),
        (r"\\.\COM12", "serial", r"\\.\COM12", None, r"\\.\COM12"),
        ("serial:///dev/ttyUSB0?baud=19200", "serial", "", None, "/dev/ttyUSB0"),
        ("serial://COM3", "serial", "COM3", None, "COM3"),
        ("tcp://192.168.1.50:4001", "tcp", "192.168.1.50", 4001, ""),
        ("rfc2217://[::1]:2217", "rfc2217", "::1", 2217, ""),
        ("sim://c320@0-3,7", "sim", "c320@0-3,7", None, "c320@0-3,7"),
        ("sim://c320@1-3+vc660@4?seed=1", "sim", "c320@1-3+vc660@4", None, "c320@1-3+vc660@4"),
        ("memory://a", "memory", "a", None, "a"),
        ("replay:///tmp/a%20b.dbcap", "replay", "", None, "/tmp/a b.dbcap"),
        ("replay://a.dbcap", "replay", "a.dbcap", None, "a.dbcap"),
    ],
)
def test_a_port_url_is_parsed(text: str, scheme: str, host: str, port: int | None, path: str) -> None:
    link = parse_port_url(text)
    assert (link.scheme, link.host, link.port, link.path) == (scheme, host, port, path)


def test_the_query_sets_the_serial_settings_and_marks_them_explicit() -> None:
    link = parse_port_url("serial:///dev/ttyUSB0?baud=19200&format=8e1&rs485=on")
    assert link.settings == SerialSettings(19200, 8, "E", 1)
    assert link.explicit == {"baud", "format"}
    assert dict(link.options) == {"rs485": "on"}


def test_an_explicit_argument_overrides_the_query() -> None:
    link = parse_port_url("tcp://h:1?baud=1200&echo=on", baud=9600, format="8O1", echo="off", timeout=None)
    assert (link.settings, link.options) == (SerialSettings(9600, 8, "O", 1), {"echo": "off"})


def test_settings_that_are_not_specified_are_defaults_and_not_explicit() -> None:
    link = parse_port_url("COM3")
    assert (link.settings, link.explicit) == (SerialSettings(9600, 8, "N", 1), frozenset())


def test_a_relative_path_to_a_device_needs_no_dot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """``simulate --link run/bus04`` makes such a name. It stays a port URL while the adapter is pulled."""
    monkeypatch.chdir(tmp_path)
    for path in ("run/bus04", "bus05"):
        Path("run").mkdir(exist_ok=True)
        if path == "bus05":
            Path(path).symlink_to("/dev/null")
        link = parse_port_url(f"{path}?baud=19200")
        assert (link.scheme, link.path, link.settings.baud) == ("serial", path, 19200)
    Path("notes.txt").touch()
    with pytest.raises(PortUrlError, match="no port URL"):
        parse_port_url("notes.txt")


@pytest.mark.parametrize("name", ["plant.toml", "./plant.toml", "/etc/drivebus/hall.TOML"])
def test_the_file_of_a_plant_in_place_of_a_port_says_where_its_ports_are(name: str) -> None:
    """It was no port URL, or a device that does not exist."""
    with pytest.raises(PortUrlError) as caught:
        parse_port_url(name)
    assert f"`drivebus check {name}` shows the port of each of its buses" in caught.value.text("en")
    assert f"`drivebus check {name}` 显示各条总线的端口" in caught.value.text("zh")


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("serial/by-id/usb-1a86-if00", "/dev/serial/by-id/usb-1a86-if00"),
        ("captures/day.dbcap", "replay://captures/day.dbcap"),
        ("tcp:/192.168.1.50:4001", "tcp://192.168.1.50:4001"),
        ("192.168.1.50:4001/", "drivebus ports"),
    ],
)
def test_a_slash_makes_no_path_of_another_port_url_that_is_mistyped(text: str, meant: str) -> None:
    with pytest.raises(PortUrlError) as caught:
        parse_port_url(text)
    assert caught.value.params["hint"] == meant


def test_a_bare_sim_url_is_answered_with_the_models_that_can_be_simulated() -> None:
    with pytest.raises(PortUrlError, match="for example c320, c300, e300, e350, e500, e550, dzb100") as caught:
        open_port("sim://")
    assert "sim://c320@1" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "key", "found"),
    [
        ("ttyUSB0", "ports.url", "ttyUSB0"),
        ("COM３", "ports.url", "COM３"),
        ("", "ports.url", '""'),
        (" ", "ports.url", '""'),
        ("serial://", "ports.url_empty", None),
        ("COM3?baud=fast", "ports.baud", "fast"),
        ("COM3?baud=１２００", "ports.baud", "１２００"),
        ("COM3?baud=-9600", "ports.baud", "-9600"),
        ("COM3?baud=49", "ports.baud", "49"),
        ("COM3?baud=" + "9" * 5_000, "ports.baud", "9" * 5_000),
        ("COM3?format=9Z1", "ports.format", "9Z1"),
        ("COM3?baud", "ports.query", "baud"),
        ("COM3?baud=1200&baud=9600", "ports.query_twice", "baud=1200&baud=9600"),
        ("tcp://host", "ports.no_tcp_port", None),
        ("tcp://", "ports.url_empty", None),
        ("tcp://host:0", "ports.address", "host:0"),
        ("tcp://host:99999", "ports.address", "host:99999"),
        ("tcp://:4001", "ports.address", ":4001"),
        ("tcp://host:1/path", "ports.address", "host:1/path"),
        ("tcp://me@host:1", "ports.address", "me@host:1"),
    ],
)
def test_a_wrong_port_url_is_rejected_with_the_text_found(text: str, key: str, found: str | None) -> None:
    with pytest.raises(PortUrlError) as caught:
        parse_port_url(text)
    assert caught.value.key == key
    assert caught.value.params.get("found") == found


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("ttyUSB0", "/dev/ttyUSB0"),
        ("10.0.0.5:4001", "tcp://10.0.0.5:4001"),
        ("night.dbcap", "replay://night.dbcap"),
        ("inverter", "drivebus ports"),
    ],
)
def test_a_wrong_port_url_names_the_next_step(text: str, hint: str) -> None:
    with pytest.raises(PortUrlError) as caught:
        parse_port_url(text)
    assert caught.value.params["hint"] == hint


def test_an_unknown_scheme_names_the_known_ones() -> None:
    with pytest.raises(PortUrlError) as caught:
        open_port("gopher://host:70")
    assert caught.value.key == "ports.scheme"
    assert {"serial", "tcp", "rfc2217", "sim", "memory", "replay"} <= set(caught.value.params["expected"])


def test_an_unknown_option_names_the_known_ones() -> None:
    with pytest.raises(PortUrlError) as caught:
        open_port("memory://x?bood=9600")
    assert (caught.value.key, caught.value.params["found"]) == ("ports.option_unknown", "bood")
    assert caught.value.params["expected"] == ("baud", "echo", "format", "line_timing")


def test_options_are_words_flags_and_numbers() -> None:
    link = parse_port_url("COM3?echo=loud&rs485=maybe&timeout=0")
    for read in (
        lambda: link.choice("echo", ("detect", "on", "off"), "detect"),
        lambda: link.flag("rs485"),
        lambda: link.number("timeout", 3, 0.1, 60),
    ):
        with pytest.raises(PortUrlError) as caught:
            read()
        assert caught.value.key == "ports.option"
    assert parse_port_url("COM3", rs485=True).flag("rs485") is True
    assert link.number("other", 3, 0.1, 60) == 3


def test_the_message_of_a_wrong_port_url_names_the_value_and_what_is_expected() -> None:
    with pytest.raises(PortUrlError) as caught:
        parse_port_url("COM3?baud=96OO")
    assert str(caught.value) == (
        "COM3?baud=96OO: baud 96OO; expected a whole number 50 … 4000000, as set on the drive's keypad"
    )
    assert "波特率 96OO" in caught.value.text("zh")


@pytest.mark.parametrize("page", ["ports.md", "ports.zh.md"])
def test_every_port_url_of_the_page_is_valid(page: str) -> None:
    text = (Path(__file__).parents[2] / "docs" / "reference" / page).read_text(encoding="utf-8")
    links = re.findall(r"^\| `([^`]*(?:/|COM)[^`]*)` \|", text, re.MULTILINE)
    assert len(links) == 8
    assert {parse_port_url(link).scheme for link in links} == {
        "serial",
        "tcp",
        "rfc2217",
        "sim",
        "replay",
        "memory",
    }


@pytest.mark.parametrize(
    "link",
    [
        "/dev/ttyUSB0?baud=9600&format=8E1&echo=on&rs485=on",
        "tcp://h:1?echo=off&timeout=9",
        "rfc2217://h:1?echo=off&timeout=9",
        "memory://page?line_timing=on&echo=on",
    ],
)
def test_every_option_of_the_page_is_accepted_by_its_scheme(link: str) -> None:
    assert open_port(link).url.startswith(link.partition("?")[0])
