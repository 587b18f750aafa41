"""Licences and the bill of materials come from the pinned packages as they are installed."""

import json
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

TOOL = Path(__file__).parents[1] / "tools" / "licences.py"


def test_bill_names_every_pinned_package_and_reports_other_versions(tmp_path):
    lock, bom = tmp_path / "a.lock", tmp_path / "out" / "bom.json"
    numpy = version("numpy")
    lock.write_text(f"# pins\nnumpy=={numpy}\nPyYAML==0.0.1\nno-such-package-of-ours==1.0\n")
    words = [sys.executable, str(TOOL), str(lock), str(bom)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 1 and done.stdout.startswith(f"numpy {numpy}: ")
    assert "BSD" in done.stdout
    assert "PyYAML 0.0.1" in done.stderr and "no-such-package-of-ours 1.0" in done.stderr
    (component,) = json.loads(bom.read_text())["components"]
    assert component["purl"] == f"pkg:pypi/numpy@{numpy}"
    assert component["licenses"][0]["license"]["name"]
