"""Cameras in files are compared, and begun at."""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from tests.formats.conftest import LENS, document_of

from sunarc.common.errors import InputError, OutsideError
from sunarc.formats.formats import export
from sunarc.public.calibration_files import compare_files, read_view_file


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder, document = tmp_path_factory.mktemp("cameras"), document_of(LENS)
    (folder / "a.json").write_text(json.dumps(document))
    made = export(document, "asi-core")
    (folder / "b.yaml").write_bytes(made.content)
    for name, content in made.beside.items():
        (folder / name).write_bytes(content)
    return folder / "a.json", folder / "b.yaml"


def test_two_files_are_compared_by_the_names_that_programs_know(files: tuple[Path, Path], tmp_path: Path) -> None:
    target = tmp_path / "off.nc"
    found = compare_files(*files, differences=target)
    assert found["formats"] == ["json", "asi-core"]
    assert {"rms_deg", "max_deg", "rms_px", "max_px", "rotation_deg"} < set(found)
    assert 0.05 < found["rms_deg"] < 0.2
    table = xr.load_dataset(io.BytesIO(target.read_bytes()), engine="h5netcdf")
    assert float(np.sqrt(np.nanmean(table["off_angle"] ** 2))) == pytest.approx(found["rms_deg"])
    assert float(np.nanmax(np.hypot(table["off_x"], table["off_y"]))) == pytest.approx(found["max_px"])
    assert float(table["zenith"].max()) <= 90.0
    npz = tmp_path / "off.npz"
    compare_files(*files, differences=npz)
    assert np.load(npz)["off_x"].tolist() == table["off_x"].values.tolist()


def test_a_mask_beside_a_file_is_found(files: tuple[Path, Path], tmp_path: Path) -> None:
    alone = tmp_path / "b.yaml"
    alone.write_bytes(files[1].read_bytes())
    assert read_view_file(alone).width == LENS.width
    (tmp_path / "the_roof_s_20130513000000_mask.mat").write_bytes(b"no mask")
    with pytest.raises(InputError, match="Mask"):
        read_view_file(alone)


def test_differences_go_to_files_that_are_known_and_can_be_written(files: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        compare_files(*files, differences=tmp_path / "off.csv")
    assert refused.value.field == "--differences"
    with pytest.raises(OutsideError):
        compare_files(*files, differences=tmp_path / "none" / "off.npz")
