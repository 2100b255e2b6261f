"""compliance-checker on our NetCDF: no fault in CF, and in ACDD only names that the CF table does not have."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from tests.formats.conftest import LENS, document_of

from sunarc.formats.formats import export

CHECKER = Path(sys.executable).with_name("compliance-checker")
CONVENTIONS = ("cf:1.11", "acdd:1.3")
WITHOUT_STANDARD_NAME = {f'variable "{name}" missing the following attributes:' for name in ("covariance", "direction")}

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(not CHECKER.is_file(), reason="compliance-checker is not installed: run deploy/setup"),
]


@pytest.fixture
def document() -> dict[str, Any]:
    return document_of(LENS)


def faults(path: Path) -> dict[str, set[str]]:
    """Return what each of the conventions finds wrong, required or recommended: the checks that fail."""
    asked = [argument for one in CONVENTIONS for argument in ("-t", one)]
    command = [str(CHECKER), *asked, "-c", "strict", "-f", "json_new", "-o", "report.json", path.name]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60.0, check=False, cwd=path.parent)
    assert (path.parent / "report.json").is_file(), done.stderr
    found: dict[str, Any] = json.loads((path.parent / "report.json").read_text())
    return {
        one: {
            check["name"]
            for priority in ("high", "medium")
            for check in found[path.name][one][f"{priority}_priorities"]
            if check["value"][0] != check["value"][1]
        }
        for one in CONVENTIONS
    }


@pytest.mark.parametrize("kind", ["calibration", "map"])
def test_the_netcdf_files_keep_cf_and_acdd(document: dict[str, Any], tmp_path: Path, kind: str) -> None:
    path = tmp_path / "calibration.nc"
    path.write_bytes(export(document, "map-netcdf" if kind == "map" else "netcdf").content)
    found = faults(path)
    assert found["cf:1.11"] == set()
    assert found["acdd:1.3"] <= WITHOUT_STANDARD_NAME


def test_a_fault_is_found(document: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "calibration.nc"
    path.write_bytes(export(document, "netcdf").content)
    with pytest.importorskip("h5netcdf").File(path, "a") as file:
        file.variables["zenith"].attrs["units"] = "furlong"
    assert faults(path)["cf:1.11"] != set()
