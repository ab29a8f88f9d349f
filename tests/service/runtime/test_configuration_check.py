"""Checks of a configuration: beside the buses, one at a time, bounded, and ended with client and service."""

from __future__ import annotations

import asyncio
import json
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from drivebus.errors import ConfigurationError, ServiceError, ServiceUnavailable
from drivebus.service.config.load import load
from drivebus.service.ipc.client import SocketClient
from drivebus.service.ipc.server import SocketServer
from drivebus.service.runtime import configuration_check
from drivebus.service.runtime.plant import GatewayStatus
from drivebus.web.gateway import WebConfig, web_address
from fixtures.service import LOCAL, SHOP_FILE, ServiceKit, running_service

FAN_2 = SHOP_FILE.partition("[drive.fan-1]")[2].replace("address = 1", "address = 2")
LONG_TEXT = SHOP_FILE + "".join(
    f'[bus.b{n}]\nport = "sim://c320@1-30"\n'
    + "".join(f'[drive.d{n}-{m}]\nbus = "b{n}"\naddress = {m}\nmodel = "c320"\n' for m in range(1, 31))
    for n in range(30)
)
"""Its check takes seconds."""
HISTORY = '[history]\nurl = "postgresql://drivebus:{password}@127.0.0.1/plant"\n'
SHOWN_URL = "postgresql://drivebus:…@127.0.0.1/plant"


@asynccontextmanager
async def shop(folder: Path) -> AsyncIterator[tuple[ServiceKit, SocketClient]]:
    file = folder / "plant.toml"
    file.write_text(SHOP_FILE)
    async with running_service(load(file)) as kit:
        server = SocketServer(kit.service, folder / "plant.sock")
        await server.open()
        client = SocketClient(server.path)
        yield kit, client
        await client.close()
        await server.close()


async def child_of(kit: ServiceKit) -> asyncio.subprocess.Process:
    """Return the process of the check that is under way."""
    check: Any = kit.service.reload._check
    for _ in range(1000):
        if check._process is not None:
            process: asyncio.subprocess.Process = check._process
            return process
        await asyncio.sleep(0.01)
    raise AssertionError("no check was started")


async def test_the_password_of_the_database_is_hidden_and_its_text_is_still_checked(tmp_path: Path) -> None:
    history = HISTORY.format(password="hunter2")
    file = tmp_path / "plant.toml"
    file.write_text(SHOP_FILE + history)
    async with running_service(load(file)) as kit:
        shown = (await kit.call("configuration.get"))["text"]
        assert shown == SHOP_FILE + history.replace("hunter2", "…")
        same = await kit.call("configuration.check", text=shown)
        assert same["difference"] == {"added": [], "changed": [], "removed": []}
        copied = shown.replace('"shop"', f'"{SHOWN_URL}"').replace('"c320"', f'"{SHOWN_URL}"')
        copied += f'[group.g]\nmembers = ["{SHOWN_URL}"]\n["{SHOWN_URL}"]\n'
        wrong = await kit.call("configuration.check", text=copied)
        assert json.dumps(wrong, ensure_ascii=False).count(SHOWN_URL) > 4 and "hunter2" not in json.dumps(wrong)
    file.write_text(shown)
    with pytest.raises(ConfigurationError) as rejected:
        load(file)
    assert [diagnostic.kind for diagnostic in rejected.value.params["diagnostics"]] == ["history_url"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('id = "shop"', f'id = "{SHOWN_URL}"'),
        ('id = "shop"', f'id = "shop"\ntitle = 5 # {SHOWN_URL}\nx = "{SHOWN_URL}"'),
        ('"state"', f'"state"\nusers = "{SHOWN_URL}"'),
        ("[plant]", f'["{SHOWN_URL}"]\n[plant]'),
        ('port = "sim://c320@1"', f'port = "{SHOWN_URL}"'),
        ('port = "sim://c320@1"', f'port = "sim://c320@1"\nformat = "{SHOWN_URL}"'),
        ('model = "c320"', f'model = "{SHOWN_URL}"'),
        ('model = "c320"', 'model = "plant.toml"'),
        ('model = "c320"', f'model = "c320"\nencoding = "{SHOWN_URL}"'),
        ('model = "c320"', f'model = "c320"\nsignals = {{ "{SHOWN_URL}" = 1 }}'),
        ('bus = "a"', f'bus = "{SHOWN_URL}"'),
        ("[bus.a]", f'[bus."{SHOWN_URL}"]\nport = "sim://c320@2"\n[bus.a]'),
        ("[drive.fan-1]", f'[drive."{SHOWN_URL}"]'),
        ("[bus.a]", f'[group.g]\nmembers = ["{SHOWN_URL}"]\n[bus.a]'),
        ("[bus.a]", f'[interlock.i]\nrequire = "{SHOWN_URL}"\nblocks = ["{SHOWN_URL}"]\n[bus.a]'),
        ("[bus.a]", f'[alarm.i]\ndrive = "{SHOWN_URL}"\n[bus.a]'),
        ("[bus.a]", f'[gateway."{SHOWN_URL}"]\nx = 1\n[bus.a]'),
        ("[bus.a]", f'[audit]\nkey = "{SHOWN_URL}/x"\n[bus.a]'),
        ("[history]", "[history]\nmax_size_mb = 1"),
        ("[history]", "[history]\nretention = { raw_days = 9, rollup_1s_days = 1 }"),
        ("/plant", "/"),
        (SHOWN_URL, f"x{SHOWN_URL}"),
        ("format = 1", f'format = "{SHOWN_URL}"'),
        ("format = 1", f"format = {SHOWN_URL}"),
    ],
)
def test_no_fault_shows_the_password_of_the_database_wherever_its_hidden_form_is_copied_to(
    tmp_path: Path, old: str, new: str
) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(SHOP_FILE + HISTORY.format(password="hunter2"))
    text = SHOP_FILE + HISTORY.format(password="…")
    assert old in text
    found = configuration_check.check_text(text.replace(old, new), load(file))
    assert found["diagnostics"] and "hunter2" not in json.dumps(found)


def test_no_difference_shows_the_password_of_the_database(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_text(SHOP_FILE + HISTORY.format(password="hunter2"))
    running = load(file)
    found = configuration_check.check_text(
        SHOP_FILE.replace("[bus.a]", f'title = "{SHOWN_URL}"\n[bus.a]') + HISTORY.format(password="…"), running
    )
    assert found["difference"] == {"added": [], "changed": ["title"], "removed": []}
    found = configuration_check.check_text(SHOP_FILE + HISTORY.format(password="hunter3"), running)
    assert found["difference"]["changed"] == ["history"]


@pytest.mark.skipif(not hasattr(os, "getpgid"), reason="process groups of POSIX")
async def test_ctrl_z_in_the_terminal_of_the_service_does_not_suspend_a_check(tmp_path: Path) -> None:
    async with shop(tmp_path) as (kit, client):
        check = asyncio.create_task(client.call("configuration.check", {"text": LONG_TEXT}, LOCAL))
        child = await child_of(kit)
        assert os.getpgid(child.pid) == child.pid
        check.cancel()


async def test_faults_and_differences_of_a_text_are_found(tmp_path: Path) -> None:
    async with shop(tmp_path) as (kit, client):
        good = await client.call("configuration.check", {"text": f"{SHOP_FILE}[drive.fan-2]{FAN_2}"}, LOCAL)
        difference = {"added": ["fan-2"], "changed": [], "removed": []}
        assert good == {"diagnostics": [], "difference": difference, "notes": []}
        same = await client.call("configuration.check", {"text": SHOP_FILE}, LOCAL)
        assert same["difference"] == {"added": [], "changed": [], "removed": []}
        wrong = await client.call("configuration.check", {"text": SHOP_FILE.replace('"c320"', '"nonsense"')}, LOCAL)
        assert [diagnostic["line"] for diagnostic in wrong["diagnostics"]] == [14] and wrong["difference"] == {}
        assert kit.service.plant.config.source == str(tmp_path / "plant.toml")


@pytest.mark.parametrize(
    ("before", "after", "english"),
    [
        ("", "port = 9090", "starts it at http://127.0.0.1:9090: open it there"),
        ("port = 9090", "", "starts it at http://127.0.0.1:8080: open it there"),
        ("", 'host = "::1"', "starts it at http://[::1]:8080: open it there"),
        ("", "port = 0", "starts it at a free port"),
        ("port = 0", "port = 9090", "starts it at http://127.0.0.1:9090: open it there"),
        ("", "enabled = false", "switches web off"),
        ("port = 0", "enabled = false", "switches web off"),
        ("", 'origins = ["https://hall.example"]', None),
        ("enabled = false", "enabled = false\nport = 9090", None),
        ("port = 0", "port = 0", None),
    ],
)
def test_a_check_says_where_a_page_is_found_that_a_reload_moves(
    before: str, after: str, english: str | None, tmp_path: Path
) -> None:
    """Regression: the reload of another port cut the page off without a word."""
    file = tmp_path / "plant.toml"
    file.write_text(f"{SHOP_FILE}[gateway.web]\n{before}\n")
    running = load(file)
    notes = configuration_check.check_text(f"{SHOP_FILE}[gateway.web]\n{after}\n", running)["notes"]
    assert [english in note["en"] for note in notes] == ([] if english is None else [True]), notes
    assert all("重新加载后 web" in note["zh"] for note in notes)


def test_no_note_names_a_gateway_that_the_service_was_started_without(tmp_path: Path) -> None:
    """Trap: a service that was started without its page announces where a reload moves that page."""
    file = tmp_path / "plant.toml"
    file.write_text(SHOP_FILE)
    moved = f"{SHOP_FILE}[gateway.web]\nport = 9090\n"
    assert configuration_check.check_text(moved, load(file), ["web"])["notes"] == []
    assert configuration_check.check_text(moved, load(file))["notes"] != []


async def test_the_gateways_that_run_decide_the_notes_of_a_check(tmp_path: Path) -> None:
    moved = {"text": f"{SHOP_FILE}[gateway.web]\nport = 9090\n"}
    async with shop(tmp_path) as (kit, client):
        assert (await client.call("configuration.check", moved, LOCAL))["notes"] == []
        kit.service.plant.gateways["web"] = GatewayStatus(id="web")
        assert len((await client.call("configuration.check", moved, LOCAL))["notes"]) == 1


def test_a_page_on_all_addresses_of_a_machine_is_found_by_any_of_its_names() -> None:
    assert web_address(WebConfig(host="0.0.0.0", port=8443, certificate=Path("c"))) == "https://HOST:8443"
    assert web_address(WebConfig(host="hall.example", port=443, certificate=Path("c"))) == "https://hall.example:443"


async def test_one_check_runs_at_a_time_and_ends_with_its_client(tmp_path: Path) -> None:
    async with shop(tmp_path) as (kit, client):
        first = asyncio.create_task(client.call("configuration.check", {"text": LONG_TEXT}, LOCAL))
        process = await child_of(kit)
        with pytest.raises(ServiceUnavailable, match="another configuration"):
            await kit.call("configuration.check", text=SHOP_FILE)
        first.cancel()
        assert await asyncio.wait_for(process.wait(), 60.0) == -9
        second = asyncio.create_task(client.call("configuration.check", {"text": LONG_TEXT}, LOCAL))
        process = await child_of(kit)
        await client.close()
        assert await asyncio.wait_for(process.wait(), 60.0) == -9
        with pytest.raises(ServiceUnavailable):
            await second


async def test_the_end_of_the_service_ends_a_check(tmp_path: Path) -> None:
    async with shop(tmp_path) as (kit, client):
        check = asyncio.create_task(client.call("configuration.check", {"text": LONG_TEXT}, LOCAL))
        process = await child_of(kit)
        await kit.service.stop()
        with pytest.raises(ServiceUnavailable, match="ended"):
            await check
        assert process.returncode == -9


async def test_a_check_is_bounded_in_time_and_drives(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async with shop(tmp_path) as (kit, _):
        monkeypatch.setattr(configuration_check, "CHECK_TIMEOUT_S", 0.05)
        with pytest.raises(ServiceError, match=r"longer than 0\.05 s"):
            await kit.call("configuration.check", text=LONG_TEXT)
        monkeypatch.setattr(configuration_check, "MAX_CHECKED_DRIVES", 900)
        with pytest.raises(ConfigurationError, match="901 drives"):
            await kit.call("configuration.check", text=LONG_TEXT)


def test_a_check_tells_nothing_about_files_outside_the_folder_of_the_plant(tmp_path: Path) -> None:
    """The check discloses neither that such a file exists nor where its first error stands."""
    folder, outside = tmp_path / "plant", tmp_path / "outside.toml"
    folder.mkdir()
    (folder / "own.toml").write_text("not = [a profile")
    outside.write_text("first = 1\nnot = [a profile")
    (folder / "link.toml").symlink_to(outside)
    (folder / "plant.toml").write_text(SHOP_FILE)
    running = load(folder / "plant.toml")

    def diagnostics(model: str) -> list[Any]:
        text = SHOP_FILE + f'[drive.x]\nbus = "a"\naddress = 9\nmodel = "{model}"\n'
        found = configuration_check.check_text(text, running)["diagnostics"]
        return [(diagnostic["key"], "that is not read here" in diagnostic["text"]["en"]) for diagnostic in found]

    for model in (str(outside), "/etc/passwd", "/no/such/file.toml", "../outside.toml", "link.toml", "/var/"):
        assert diagnostics(model) == [("drive.x.model", True)], model
    assert len(diagnostics("own.toml")) == 2, "its own errors are listed"
    for secret in ("./database-password", "state/setup-secret", "state/users.json", "state/own.toml"):
        (folder / secret).parent.mkdir(exist_ok=True)
        (folder / secret).write_text("hunter2")
        assert diagnostics(secret) == [("drive.x.model", True)], "the first error would repeat its first word"
    running = replace(running, drives=(replace(running.drives[0], model=str(outside)),))
    assert len(diagnostics(str(outside))) == 2, "a file that is in use"
