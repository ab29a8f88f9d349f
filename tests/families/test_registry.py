"""Registry of protocol families: an entry point that can't be used is named, and never hides the other families."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivebus.errors import ConfigurationError
from drivebus.protocols.family import clear_registry, protocol_families, protocol_family, register, resolve

BUILT_IN_NAMES = ["sunfar", "dzb100", "modbus", "huanyang", "mitsubishi"]


@pytest.fixture
def entry_point(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Iterator[None]:
    """An installed distribution whose one entry point ``acme`` names the object of the parameter."""
    metadata = tmp_path / "acme-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(f"[drivebus.families]\nacme = {request.param}\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    clear_registry()
    yield
    clear_registry()


def test_an_unknown_family_is_reported_with_the_known_ones() -> None:
    with pytest.raises(ConfigurationError) as found:
        protocol_family("acme")
    assert found.value.key == "families.unknown"
    assert found.value.params == {"found": "acme", "expected": tuple(BUILT_IN_NAMES)}


@pytest.mark.parametrize(
    ("entry_point", "reason"),
    [
        ("acme_is_not_there:FAMILY", "No module named 'acme_is_not_there'"),
        ("drivebus.protocols.modbus.family:FAMILY", "it is no ProtocolFamily with the name acme"),
        ("json:dumps", "it is no ProtocolFamily with the name acme"),
    ],
    indirect=["entry_point"],
)
def test_a_broken_entry_point_is_reported_and_hides_no_other_family(entry_point: None, reason: str) -> None:
    assert [family.name for family in protocol_families()] == BUILT_IN_NAMES
    with pytest.raises(ConfigurationError) as found:
        protocol_family("acme")
    assert (found.value.key, str(found.value.params["reason"])) == ("families.broken", reason)
    with pytest.raises(ConfigurationError, match="other"):
        protocol_family("other")


def test_a_built_in_family_is_not_replaced() -> None:
    with pytest.raises(ValueError, match="family modbus is built in"):
        register(protocol_family("modbus"))


def test_a_family_may_be_registered_without_texts_and_with_objects_instead_of_import_paths() -> None:
    describe = object()
    register(replace(protocol_family("modbus"), name="acme", describe=describe, catalogues=None))
    try:
        assert resolve(protocol_family("acme").describe) is describe
    finally:
        clear_registry()
