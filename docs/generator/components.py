"""List of components (SBOM) in CycloneDX 1.6: pinned packages, files of the page and lists of other projects."""

from __future__ import annotations

import json
import re
import tomllib
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any
from urllib.parse import quote

FILE = Path("docs") / "security" / "sbom.cdx.json"
_PIN = re.compile(r"^([\w.-]+)==([^\s;]+)(?: ; ([^\\\n]+))?", re.MULTILINE)
"""Name, version and environment marker of a package in the requirements."""
_CLASSIFIED_LICENCES = {"License :: OSI Approved :: MIT License": "MIT"}
"""SPDX expressions of packages that state their licence in a classifier only."""
_LICENCES_FOR_OTHER_PLATFORMS = {"pywin32": "PSF-2.0"}
"""SPDX expressions of packages that are not installed where this list is made."""
_DATA_FILES = (
    {
        "file": "service/auth/common_passwords.txt",
        "source": "the word lists of zxcvbn 4.5.0",
        "licence": "MIT",
        "url": "https://github.com/dwolfhub/zxcvbn-python",
    },
    {
        "file": "service/auth/look_alikes.txt",
        "source": "confusables.txt of Unicode (UTS 39)",
        "licence": "Unicode-3.0",
        "url": "https://www.unicode.org/Public/security/latest/confusables.txt",
    },
)
"""Files of the package that are made from lists of other projects; each has the notice of its licence."""


def page(root: Path) -> str:
    """Return the list as JSON, without a date: it changes with the components only."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": project["name"],
                "name": project["name"],
                "version": project["version"],
                "licenses": _licences(project["license"]),
            }
        },
        "components": [*_packages(root), *_files_of_the_page(root), *_data_files(root)],
    }
    return json.dumps(document, indent=1) + "\n"


def _packages(root: Path) -> list[dict[str, Any]]:
    """Return the Python packages; the hashes of their files are in the requirements.

    A package with an environment marker is installed only where the marker is true.
    """
    pins = _PIN.findall((root / "requirements" / "base.txt").read_text(encoding="utf-8"))
    return [
        {
            "type": "library",
            "bom-ref": purl,
            "name": name,
            "version": version,
            **({"scope": "optional"} if marker else {}),
            "licenses": _licences(_licence_of_package(name)),
            "purl": purl,
            **({"properties": [{"name": "environment marker", "value": marker.strip()}]} if marker else {}),
        }
        for name, version, marker in pins
        for purl in [f"pkg:pypi/{name}@{version}"]
    ]


def _licence_of_package(name: str) -> str:
    """Return the SPDX expression in the metadata of an installed package."""
    try:
        found = metadata(name)
    except PackageNotFoundError:
        return _LICENCES_FOR_OTHER_PLATFORMS[name]
    if expression := found.get("License-Expression"):
        return expression
    (licence,) = (
        _CLASSIFIED_LICENCES[classifier]
        for classifier in found.get_all("Classifier", [])
        if classifier.startswith("License ::")
    )
    return licence


def _licences(expression: str) -> list[dict[str, Any]]:
    """Return an SPDX expression in the form of CycloneDX, which has another one for a single licence."""
    return [{"expression": expression} if " " in expression else {"license": {"id": expression}}]


def _files_of_the_page(root: Path) -> list[dict[str, Any]]:
    listed = json.loads((root / "src/drivebus/web/vendor/VERSIONS.json").read_text(encoding="utf-8"))["files"]
    return [
        {
            "type": "library",
            "bom-ref": f"{purl}#{each['file']}",
            "name": each["package"],
            "version": each["version"],
            "description": f"{each['file']} of the page",
            "hashes": [{"alg": "SHA-256", "content": each["sha256"]}],
            "licenses": _licences(each["licence"]),
            "purl": purl,
        }
        for each in listed
        for purl in [f"pkg:npm/{quote(each['package'], safe='/')}@{each['version']}"]
    ]


def _data_files(root: Path) -> list[dict[str, Any]]:
    return [
        {
            "type": "data",
            "bom-ref": each["file"],
            "name": Path(each["file"]).name,
            "description": f"made from {each['source']}",
            "hashes": [
                {"alg": "SHA-256", "content": sha256((root / "src/drivebus" / each["file"]).read_bytes()).hexdigest()}
            ],
            "licenses": _licences(each["licence"]),
            "externalReferences": [{"type": "source-distribution", "url": each["url"]}],
        }
        for each in _DATA_FILES
    ]
