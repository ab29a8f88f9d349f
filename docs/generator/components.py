"""List of components (SBOM) in CycloneDX 1.6: what an installation with pinned versions, and the page, consist of."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path
from typing import Any
from urllib.parse import quote

FILE = Path("docs") / "security" / "sbom.cdx.json"
_PIN = re.compile(r"^([\w.-]+)==([^\s;]+)", re.MULTILINE)


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
                "licenses": [{"license": {"id": project["license"]}}],
            }
        },
        "components": [*_packages(root), *_files_of_the_page(root)],
    }
    return json.dumps(document, indent=1) + "\n"


def _packages(root: Path) -> list[dict[str, Any]]:
    """Return the Python packages; the hashes of their files are in the requirements."""
    pins = _PIN.findall((root / "requirements" / "base.txt").read_text(encoding="utf-8"))
    return [
        {"type": "library", "bom-ref": purl, "name": name, "version": version, "purl": purl}
        for name, version in pins
        for purl in [f"pkg:pypi/{name}@{version}"]
    ]


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
            "licenses": [{"license": {"id": each["licence"]}}],
            "purl": purl,
        }
        for each in listed
        for purl in [f"pkg:npm/{quote(each['package'], safe='/')}@{each['version']}"]
    ]
