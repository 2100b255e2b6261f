"""The file of --cameras: what it has goes before the command line; what it cannot have is refused by name."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.common.errors import InputError
from sunarc.lab.simulation.truth import SGP
from sunarc.sources.image_times import TimeRules
from sunarc.sources.index import CameraPlan, Selector, read_cameras

COMMON = CameraPlan(
    name="all",
    site=SGP,
    selector=Selector(("common.zip",)),
    rules=TimeRules("%Y", timedelta(hours=1)),
    image_size=(9, 9),
)


def read(text: str, folder: Path) -> list[CameraPlan]:
    path = folder / "cameras.toml"
    path.write_text(text)
    return read_cameras(path, common=COMMON)


def test_what_a_camera_leaves_out_is_that_of_the_command_line(tmp_path: Path) -> None:
    (plan,) = read("[cameras.roof]\n", tmp_path)
    assert (plan.name, plan.site, plan.selector, plan.rules) == ("roof", SGP, COMMON.selector, COMMON.rules)
    assert (plan.image_size, plan.options, plan.method) == ((9, 9), COMMON.options, "auto")


def test_what_a_camera_has_goes_first(tmp_path: Path) -> None:
    text = """
        [cameras.roof]
        sources = ["a.zip", "s3://bucket/b"]
        files = "ccd1_*"
        utc_offset = -5.5
        time_pattern = "%Y%m%d%H"
        latitude = -10
        image_size = [640, 480]
        mirrored = "yes"
        level_within = 20
        method = "paper"
        [cameras.mast]
        altitude = 5.0
    """
    roof, mast = read(text, tmp_path)
    assert roof.selector == Selector((str(tmp_path / "a.zip"), "s3://bucket/b"), "ccd1_*")
    assert roof.rules == TimeRules("%Y%m%d%H", timedelta(hours=-5.5))
    assert (roof.site.latitude, roof.site.longitude) == (-10.0, SGP.longitude)
    assert (roof.image_size, roof.options.mirrored, roof.method) == ((640, 480), "yes", "paper")
    assert roof.options.level_within_deg == 20.0
    assert (mast.site.altitude, mast.image_size) == (5.0, (9, 9))


@pytest.mark.parametrize(
    ("options", "text", "said"),
    [
        (CalibrationOptions(mirrored="no"), 'mirrored = "yes"', "mirrored is 'yes', where --mirrored no is given"),
        (CalibrationOptions(projection="equisolid"), 'projection = "perspective"', "projection is 'perspective'"),
        (CalibrationOptions(mirrored="yes", projection="equisolid"), 'mirrored = "yes"', None),
        (CalibrationOptions(), 'mirrored = "yes"\nprojection = "equidistant"', None),
    ],
)
def test_what_is_stated_twice_and_differently_is_refused(
    tmp_path: Path, options: CalibrationOptions, text: str, said: str | None
) -> None:
    path = tmp_path / "cameras.toml"
    path.write_text(f"[cameras.roof]\n{text}\n")
    if said is None:
        (plan,) = read_cameras(path, common=replace(COMMON, options=options))
        assert plan.options.mirrored == "yes"
        return
    with pytest.raises(InputError) as refused:
        read_cameras(path, common=replace(COMMON, options=options))
    assert said in refused.value.problem


@pytest.mark.parametrize(("text", "lacking"), [("latitude = 3", "longitude"), ("latitude = 3\nlongitude = 8", None)])
def test_a_site_that_the_command_line_does_not_give_is_each_cameras(
    text: str, lacking: str | None, tmp_path: Path
) -> None:
    path = tmp_path / "cameras.toml"
    path.write_text(f"[cameras.roof]\n{text}\n")
    said = None
    try:
        read_cameras(path, common=COMMON, required=["latitude", "longitude"])
    except InputError as error:
        said = error.problem
    assert (said is None) is (lacking is None)
    assert said is None or str(lacking) in said


@pytest.mark.parametrize(
    "text",
    [
        "",
        "cameras = 3",
        "[cameras]\nroof = 3",
        "[cameras.roof]\nlattitude = 3",
        "[cameras.roof]\nlatitude = 95",
        '[cameras.roof]\nlatitude = "north"',
        '[cameras.roof]\nutc_offset = "Nowhere/Mast"',
        "[cameras.roof]\nimage_size = [640]",
        '[cameras.roof]\nsources = "a.zip"',
        "[cameras.roof]\nsources = []",
        '[cameras.roof]\nmirrored = "maybe"',
        '[cameras."../roof"]\n',
        "[cameras.roof",
    ],
)
def test_a_file_that_is_wrong_is_refused(text: str, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        read(text, tmp_path)
