"""Licences of the pinned packages, and a software bill of materials (CycloneDX 1.6).

Usage: python tools/licences.py LOCKFILE BOM.json. Reads the metadata of the installed packages;
exit code 1 names pinned packages that are not installed in the pinned version.
"""

from __future__ import annotations

import json
import re
import sys
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

_PIN = re.compile(r"^([A-Za-z0-9._-]+)==([^\s;\\]+)")


def pins(lock: Path) -> dict[str, str]:
    """Version of every pinned package."""
    found = filter(None, map(_PIN.match, lock.read_text().splitlines()))
    return {match[1]: match[2] for match in found}


def licence_of(name: str) -> str:
    """The licence that an installed package states: expression, classifier or free text."""
    metadata = distribution(name).metadata
    if expression := metadata.get("License-Expression"):
        return expression
    stated = [c.rpartition(" :: ")[2] for c in metadata.get_all("Classifier", [])
              if c.startswith("License ::")]  # fmt: skip
    free = (metadata.get("License") or "").strip().split("\n")[0]
    return ", ".join(stated) or free[:80] or "not stated"


def component(name: str, version: str, licence: str) -> dict[str, object]:
    """A CycloneDX component."""
    url = f"pkg:pypi/{re.sub(r'[-_.]+', '-', name).lower()}@{version}"
    return {"type": "library", "bom-ref": url, "name": name, "version": version, "purl": url,
            "licenses": [{"license": {"name": licence}}]}  # fmt: skip


def main(lock: Path, bom: Path) -> int:
    """Print a line a package, and write the bill of materials."""
    components, absent = [], []
    for name, version in pins(lock).items():
        try:
            there = distribution(name).version.partition("+")[0]  # a local build, such as +cpu
        except PackageNotFoundError:
            there = "none"
        if there != version:
            absent.append(f"{name} {version} (installed: {there})")
            continue
        licence = licence_of(name)
        components.append(component(name, version, licence))
        print(f"{name} {version}: {licence}")
    bom.parent.mkdir(parents=True, exist_ok=True)
    content = {"bomFormat": "CycloneDX", "specVersion": "1.6", "version": 1,
               "components": components}  # fmt: skip
    bom.write_text(json.dumps(content, indent=1) + "\n")
    if absent:
        print(f"not in the pinned version: {', '.join(absent)}", file=sys.stderr)
    return 1 if absent else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), Path(sys.argv[2])))
