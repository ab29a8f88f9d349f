"""Device cookies: a browser in which a user has logged in before, and no other, is counted on its own."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest

from drivebus.service.auth.devices import DeviceCookies, device_cookie_name

COOKIE = re.compile(r"[A-Za-z0-9_-]{22}\.[0-9a-f]{64}")


def test_a_device_is_known_after_a_restart_and_in_each_spelling_of_its_user(tmp_path: Path) -> None:
    cookie = DeviceCookies(tmp_path).issue("Operator")
    assert COOKIE.fullmatch(cookie)
    again = DeviceCookies(tmp_path)
    assert again.device("operator", cookie) == again.device("OPERATOR", cookie) == cookie.partition(".")[0]


def test_the_key_of_the_devices_is_private_and_random(tmp_path: Path) -> None:
    keys = set()
    for name in "ab":
        DeviceCookies(tmp_path / name).issue("operator")
        path = tmp_path / name / "device.key"
        assert path.stat().st_mode & 0o777 == 0o600
        keys.add(path.read_bytes())
    assert {len(key) for key in keys} == {32} and len(keys) == 2


def test_a_valid_cookie_stays_and_each_browser_gets_another_one(tmp_path: Path) -> None:
    devices = DeviceCookies(tmp_path)
    first = devices.issue("operator")
    assert devices.issue("operator", first) == first
    assert len({first, devices.issue("operator"), devices.issue("operator", "x"), devices.issue("eve", first)}) == 4


def test_a_cookie_of_another_user_or_with_one_other_character_is_no_device(tmp_path: Path) -> None:
    devices = DeviceCookies(tmp_path)
    cookie = devices.issue("operator")
    device, _, mac = cookie.partition(".")
    changed = ["A" + device[1:] if device[0] != "A" else "B" + device[1:], device[:-1], device + "A", "é" + device[1:]]
    others = [mac[:-1] + ("0" if mac[-1] != "0" else "1"), mac.upper(), mac[:-1], mac + "0", "é" * 64, ""]
    forged = [f"{changed_device}.{mac}" for changed_device in changed] + [
        f"{device}.{other_mac}" for other_mac in others
    ]
    assert [devices.device("operator", value) for value in (*forged, device, "", ".", cookie + "\n")] == [""] * 14
    assert devices.device("engineer", cookie) == ""


def test_a_fifo_in_the_place_of_the_key_delays_no_login(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "device.key")
    devices = DeviceCookies(tmp_path)
    assert devices.device("operator", devices.issue("operator"))


@pytest.mark.parametrize("content", [b"", b"short", bytes(33)])
def test_a_damaged_key_is_replaced_and_its_devices_are_unknown(content: bytes, tmp_path: Path) -> None:
    cookie = DeviceCookies(tmp_path).issue("operator")
    (tmp_path / "device.key").write_bytes(content)
    devices = DeviceCookies(tmp_path)
    assert devices.device("operator", cookie) == ""
    fresh = devices.issue("operator")
    assert DeviceCookies(tmp_path).device("operator", fresh) and len((tmp_path / "device.key").read_bytes()) == 32


def test_a_key_that_can_not_be_saved_lasts_as_long_as_its_process(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    devices = DeviceCookies(tmp_path / "file")
    cookie = devices.issue("operator")
    assert devices.device("operator", cookie) and devices.issue("operator", cookie) == cookie
    assert DeviceCookies(tmp_path / "file").device("operator", cookie) == ""


def test_the_cookie_has_one_name_for_each_user_whatever_is_typed_as_the_name(tmp_path: Path) -> None:
    assert device_cookie_name("Operator") == device_cookie_name("operator") != device_cookie_name("engineer")
    assert re.fullmatch("drivebus_device_[0-9a-f]{16}", device_cookie_name("\ud800"))
    assert DeviceCookies(tmp_path).device("\ud800", "x" * 22 + "." + "0" * 64) == ""
