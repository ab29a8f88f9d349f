"""End of the certificates of a plant, and the mode of their keys: read, printed by ``check``, and announced."""

from __future__ import annotations

import json
import os
import ssl
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import pytest
import trustme
from click.testing import CliRunner, Result

from drivebus.cli.main import cli
from drivebus.clock import wall_clock
from drivebus.service.config.certificates import EXPIRY_WARNING, validity
from drivebus.service.config.load import load
from drivebus.service.config.model import CertificateFiles, GatewayConfig
from drivebus.service.process import permissions
from fixtures.service import plant_config, running_service

PLANT = """format = 1
[plant]
id = "p"
[bus.a]
port = "sim://c320@1"
[drive.f]
bus = "a"
address = 1
model = "c320"
[gateway.web]
certificate = "cert.pem"
key = "key.pem"
"""


def certificate(folder: Path, until: datetime, mode: int = 0o640, *, start: datetime | None = None) -> CertificateFiles:
    """Write a certificate that ends at a time, and its key. It is valid now unless ``start`` says else."""
    start = start or min(wall_clock(), until) - timedelta(days=90)
    files = CertificateFiles(folder / "cert.pem", folder / "key.pem")
    made = trustme.CA().issue_cert("127.0.0.1", not_before=start, not_after=until)
    made.cert_chain_pems[0].write_to_path(files.certificate)
    made.private_key_pem.write_to_path(files.key)
    files.key.chmod(mode)
    return files


def check(folder: Path, *options: str) -> Result:
    (folder / "plant.toml").write_text(PLANT)
    return CliRunner().invoke(cli, ["check", str(folder / "plant.toml"), "--lang", "en", *options])


@pytest.mark.parametrize(
    "until", [datetime(2027, 2, 28, 23, 59, 59, tzinfo=UTC), datetime(2051, 1, 1, 12, 0, tzinfo=UTC)]
)
def test_the_end_of_a_certificate_is_read_in_both_forms_of_a_date(tmp_path: Path, until: datetime) -> None:
    """Years from 2050 on have four digits."""
    start = until - timedelta(days=90)
    assert validity(certificate(tmp_path, until, start=start)) == (start, until)


def test_what_is_no_certificate_is_an_error_and_no_end(tmp_path: Path) -> None:
    files = certificate(tmp_path, wall_clock())
    der = ssl.PEM_cert_to_DER_cert(files.certificate.read_text())
    for content in (b"", b"\x30\x03\x02\x01\x01", b"\x30\x02\x30\x00", der[:60], der[:-1]):
        files.certificate.write_text(ssl.DER_cert_to_PEM_cert(content))
        with pytest.raises(ValueError):
            validity(files)
    files.certificate.write_text("nothing")
    with pytest.raises(ValueError):
        validity(files)


@pytest.mark.parametrize(
    ("days", "text"), [(300, "valid until"), (5, "renew it"), (-5, "browsers and programs refuse it")]
)
def test_check_prints_the_end_of_a_certificate(tmp_path: Path, days: int, text: str) -> None:
    until = wall_clock().replace(microsecond=0) + timedelta(days=days)
    certificate(tmp_path, until)
    found = check(tmp_path)
    assert found.exit_code == 0 and text in found.output and f"{until:%Y-%m-%d}" in found.output
    assert json.loads(check(tmp_path, "--json").stdout)["certificates"][0]["valid_until"] == until.isoformat()


@pytest.mark.parametrize(("mode", "named"), [(0o600, False), (0o640, False), (0o644, True), (0o660, True)])
def test_check_names_a_key_that_others_can_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: int, named: bool
) -> None:
    monkeypatch.setattr(permissions, "_is_private_group", lambda gid, uid: False)
    certificate(tmp_path, wall_clock() + timedelta(days=300), mode)
    found = check(tmp_path)
    assert found.exit_code == 0
    assert ("chmod 640" in found.output) is named
    assert json.loads(check(tmp_path, "--json").stdout)["exposed_files"] == [] or named


@pytest.mark.parametrize("name", ["cert.pem", "key.pem"])
def test_check_names_a_key_or_certificate_that_another_user_owns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """The owner of a file can read and replace it, whatever its mode is."""
    certificate(tmp_path, wall_clock() + timedelta(days=300))
    monkeypatch.setattr(permissions, "ROOT", -1)
    monkeypatch.setattr(permissions, "_service_user", lambda config: 65_534)
    problems = json.loads(check(tmp_path, "--json").stdout)["exposed_files"]
    (found,) = [problem for problem in problems if problem["params"]["path"] == str(tmp_path / name)]
    assert found["key"] == "plant.foreign_owner" and f"chown -h nobody {tmp_path / name}" in found["text"]


def test_check_compares_the_owner_of_a_key_with_that_of_the_state_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An administrator who runs it is not the service's user: the service's own key is not foreign to it."""
    certificate(tmp_path, wall_clock() + timedelta(days=300))
    (tmp_path / "state").mkdir(0o700)
    (tmp_path / "plant.toml").write_text(PLANT.replace('id = "p"', 'id = "p"\ndirectory = "state"'))
    config = load(tmp_path / "plant.toml")
    assert config.directory == tmp_path / "state"
    monkeypatch.setattr(permissions, "ROOT", -1)
    monkeypatch.setattr(os, "geteuid", lambda: 65_534)

    def foreign() -> bool:
        paths = {problem.params["path"] for problem in permissions.certificate_problems(config)}
        return str(tmp_path / "key.pem") in paths

    assert not foreign()
    (tmp_path / "state").rmdir()
    assert foreign()


@pytest.mark.parametrize("inside", [False, True], ids=["the name is the link", "a folder of the name is the link"])
@pytest.mark.parametrize("replaceable", ["by its owner", "by every user"])
@pytest.mark.parametrize("name", ["certificate", "key"])
def test_check_names_a_link_that_another_user_can_lead_to_a_key_or_certificate_of_their_own(
    name: str, replaceable: str, inside: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the file that the link led to was looked at."""
    private, shared = tmp_path / "private", tmp_path / "shared"
    private.mkdir(mode=0o700)
    shared.mkdir()
    target = getattr(certificate(private, wall_clock() + timedelta(days=300)), name)
    files = {"certificate": private / "cert.pem", "key": private / "key.pem"}
    link = shared / "link"
    link.symlink_to(private if inside else target)
    files[name] = link / target.name if inside else link
    text = PLANT.replace('"cert.pem"', f'"{files["certificate"]}"').replace('"key.pem"', f'"{files["key"]}"')
    (tmp_path / "plant.toml").write_text(text)
    config = load(tmp_path / "plant.toml")
    assert list(permissions.certificate_problems(config)) == []
    if replaceable == "by every user":
        shared.chmod(0o777)
        expected = ("plant.writable_by_others", str(shared))
    else:
        owner, lstat = link.lstat(), Path.lstat
        foreign = SimpleNamespace(st_uid=65_534, st_mode=owner.st_mode)
        monkeypatch.setattr(Path, "lstat", lambda path: foreign if path == link else lstat(path))
        expected = ("plant.foreign_owner", str(link))
    (problem,) = permissions.certificate_problems(config)
    assert (problem.key, problem.params["path"]) == expected


async def test_check_and_service_name_a_folder_in_which_others_can_replace_the_key(tmp_path: Path) -> None:
    folder = tmp_path / "tls keys"
    folder.mkdir()
    files = certificate(folder, wall_clock() + timedelta(days=300))
    gateway = GatewayConfig(id="web", module="x", settings=None, certificates=(files,))
    async with running_service(plant_config(gateways=(gateway,))) as kit:

        async def events() -> list[str]:
            supervision = kit.service.supervision
            if supervision._disk_task is not None:  # its own check, which began before the folder was changed
                await supervision._disk_task
            await supervision._check_disk()
            texts = kit.event_texts()
            return [text for text in texts if "tls keys" in text]

        assert await events() == []
        folder.chmod(0o777)
        (text,) = await events()
        assert f"{folder} can be written by other users (mode 777)" in text and f"chmod go-w '{folder}'" in text
        assert len(await events()) == 1, "once, not at each check"


async def test_check_and_service_name_a_certificate_that_is_not_valid_yet(tmp_path: Path) -> None:
    """It was printed as valid until its end, and cleared the alarm of an ended one that it had replaced."""
    start = wall_clock().replace(microsecond=0) + timedelta(days=10)
    until = start + timedelta(days=90)
    files = certificate(tmp_path, until, start=start)
    found = check(tmp_path)
    assert found.exit_code == 0 and f"is valid from {start:%Y-%m-%d %H:%M} UTC on" in found.output
    assert json.loads(check(tmp_path, "--json").stdout)["certificates"][0]["valid_from"] == start.isoformat()
    gateway = GatewayConfig(id="web", module="x", settings=None, certificates=(files,))
    async with running_service(plant_config(gateways=(gateway,))) as kit:
        await kit.service.supervision._check_disk()
        assert any("is valid from" in text for text in kit.event_texts())
    certificate(tmp_path, until)
    assert "is valid from" not in check(tmp_path).output


@pytest.mark.parametrize("left", [EXPIRY_WARNING - timedelta(hours=1), timedelta(days=-30)])
async def test_a_certificate_that_ends_or_has_ended_is_an_alarm_until_it_is_renewed(
    tmp_path: Path, left: timedelta
) -> None:
    ends = wall_clock() + left
    files = certificate(tmp_path, ends)
    gateway = GatewayConfig(id="web", module="x", settings=None, certificates=(files,))
    async with running_service(plant_config(gateways=(gateway,))) as kit:

        def alarms() -> list[str]:
            found = kit.service.plant.alarms.active()
            return [alarm.text.en for alarm in found if alarm.kind == "certificate_expiry" and not alarm.cleared_ms]

        supervision = kit.service.supervision
        await supervision._check_disk()
        (text,) = alarms()
        assert f"cert.pem: {ends:%Y-%m-%d}" in text and "is valid" not in text, "true also after the end"
        certificate(tmp_path, wall_clock() + EXPIRY_WARNING + timedelta(hours=1))
        await supervision._check_disk()
        assert alarms() == []


def test_the_certificate_of_the_page_is_known_from_its_table(tmp_path: Path) -> None:
    certificate(tmp_path, wall_clock())
    (tmp_path / "plant.toml").write_text(PLANT)
    files = load(tmp_path / "plant.toml").gateway("web").certificates
    assert files == (CertificateFiles(tmp_path / "cert.pem", tmp_path / "key.pem"),)
