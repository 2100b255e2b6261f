"""Which images are whose; what is no camera's, or of a camera that cannot be used, with what was seen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from datetime import timedelta
from pathlib import Path

import pytest
from tests.fixtures.packed_archives import GREY, encoded, folder_of, zip_of

from sunarc.common.errors import InputError
from sunarc.lab.simulation.truth import SGP
from sunarc.sky.site import Site
from sunarc.sources import index as index_module
from sunarc.sources.image_times import TimeRules
from sunarc.sources.index import CameraPlan, Indexed, Selector, index_archive

PICTURE = encoded(GREY, ".png")
DAY = [f"20130513T18{minute:02d}00Z.png" for minute in range(10, 50, 4)]


def indexed(where: Path, *, site: Site = SGP, offset_h: float | None = None, files: str = "*") -> Indexed:
    offset = None if offset_h is None else timedelta(hours=offset_h)
    plan = CameraPlan(name="roof", site=site, selector=Selector((str(where),), files), rules=TimeRules(None, offset))
    return index_archive([plan])


def named(names: Iterable[str], content: bytes = PICTURE) -> dict[str, bytes]:
    return dict.fromkeys(names, content)


def codes(found: Indexed) -> list[tuple[str, str]]:
    return [(one.file, one.finding.code) for one in found.failures]


def refusals(found: Indexed) -> list[tuple[str, str]]:
    return [(one.file, one.finding.code) for one in found.refused]


def test_images_of_one_camera_are_in_the_order_of_time_whatever_their_names(tmp_path: Path) -> None:
    names = [f"{letter}/{name}" for letter, name in zip("zyxwvutsrq", DAY, strict=True)]
    (camera,) = indexed(folder_of(named(names), tmp_path / "a")).cameras
    assert [image.file for image in camera.images] == names
    assert (camera.plan.name, camera.size, camera.family) == ("roof", (24, 20), "date and time, UTC")
    assert camera.example == ("a/q/20130513T184600Z.png", "2013-05-13T18:46:00Z")


def test_a_fits_file_without_a_time_is_named_beside_pictures_that_need_none(tmp_path: Path) -> None:
    fits = pytest.importorskip("astropy.io.fits")
    folder = folder_of({**named(DAY), "latest.png": PICTURE}, tmp_path / "all")
    assert indexed(folder).untimed == []
    fits.PrimaryHDU(GREY).writeto(folder / "frame.fits")
    found = indexed(folder)
    assert [len(one.images) for one in found.cameras] == [len(DAY)]
    assert [one.file for one in found.untimed] == ["all/frame.fits"]
    assert ("all/latest.png", "file_time_unknown") in codes(found)


def test_two_cameras_in_one_folder_are_told_apart_by_their_names(tmp_path: Path) -> None:
    names = [f"{camera}_{name}" for camera in ("ccd1", "ccd2") for name in DAY]
    found = indexed(folder_of(named(names), tmp_path))
    assert [(one.plan.name, len(one.images)) for one in found.cameras] == [("roof-ccd1", 10), ("roof-ccd2", 10)]


def test_two_cameras_whose_files_have_the_same_names_are_refused_with_an_example(tmp_path: Path) -> None:
    found = indexed(folder_of(named([f"{camera}/{name}" for camera in "ab" for name in DAY]), tmp_path / "all"))
    assert found.cameras == []
    assert refusals(found) == [("roof", "cameras_mixed")]
    assert found.refused[0].finding.data == {
        "copies": 10, "images": 20, "file": f"all/b/{DAY[0]}", "other": f"all/a/{DAY[0]}",
    }  # fmt: skip


def test_one_copy_is_left_out_alone(tmp_path: Path) -> None:
    found = indexed(folder_of(named([*DAY, f"copy/{DAY[3]}"]), tmp_path / "all"))
    assert [len(one.images) for one in found.cameras] == [10]
    assert codes(found) == [(f"all/copy/{DAY[3]}", "file_copy")]


def test_two_exposures_of_one_time_both_count(tmp_path: Path) -> None:
    found = indexed(folder_of(named(["20130513183000_11.png", "20130513183000_12.png"]), tmp_path), offset_h=0.0)
    assert [[image.file for image in one.images] for one in found.cameras] == [
        ["20130513183000_11.png", "20130513183000_12.png"]
    ]


def test_a_pattern_of_names_selects_files(tmp_path: Path) -> None:
    names = [f"{camera}_{name}" for camera in ("ccd1", "ccd2") for name in DAY]
    folder = folder_of(named(names), tmp_path)
    assert [(one.plan.name, len(one.images)) for one in indexed(folder, files="ccd2_*").cameras] == [("roof", 10)]
    assert refusals(indexed(folder, files="ccd3_*")) == [("roof", "camera_without_files")]


def test_times_without_a_zone_are_left_out_until_one_is_given(tmp_path: Path) -> None:
    folder = folder_of(named(["20130513123000.png"]), tmp_path / "all")
    found = indexed(folder)
    assert (codes(found), refusals(found)) == (
        [("all/20130513123000.png", "file_time_zone")],
        [("roof", "camera_without_images")],
    )
    assert indexed(folder, offset_h=-6.0).cameras[0].images[0].unix_s == 1_368_469_800.0  # 18:30 UTC


@pytest.mark.parametrize(
    ("site", "why"),
    [
        (SGP, "night"),
        (Site(latitude=SGP.latitude, longitude=-SGP.longitude, altitude=0.0), "sign of the longitude"),
    ],
)
def test_an_archive_whose_images_are_all_of_the_night_is_left_to_its_stars(
    site: Site, why: str, tmp_path: Path
) -> None:
    names = [name.replace("T18", "T06") if why == "night" else name for name in DAY]
    found = indexed(folder_of(named(names), tmp_path), site=site)
    (camera,) = found.cameras
    assert (camera.images, len(camera.nights), camera.size) == ((), len(DAY), (24, 20))
    assert (refusals(found), codes(found)) == ([], [])


def test_an_archive_whose_images_are_all_of_dusk_is_refused(tmp_path: Path) -> None:
    names = [f"20130514T01{minute}00Z.png" for minute in range(36, 46)]
    found = indexed(folder_of(named(names), tmp_path))
    assert refusals(found) == [("roof", "camera_at_night")]
    assert {code for _, code in codes(found)} == {"file_at_night"}
    assert 90.0 < float(found.refused[0].finding.data["zenith_deg"]) < 102.0


def test_images_of_the_night_wait_for_the_calibration_of_the_day(tmp_path: Path) -> None:
    dusk, night = "20130514T014000Z.png", "20130514T060000Z.png"
    folder = folder_of(named([*DAY, night, dusk]), tmp_path / "all")
    found = indexed(folder)
    assert [image.file for image in found.cameras[0].nights] == [night]
    assert [image.file for image in found.cameras[0].images] == DAY
    assert codes(found) == [(f"all/{dusk}", "file_at_night")]


def test_the_size_is_what_most_images_have(tmp_path: Path) -> None:
    files = named(DAY) | {"20130513T190000Z.png": encoded(GREY[::2], ".png"), "20130513T191000Z.png": b"none"}
    (camera,) = indexed(folder_of(files, tmp_path)).cameras
    assert (camera.size, len(camera.images)) == ((24, 20), 12)


@pytest.mark.parametrize(("small", "of"), [(range(5, 10), "roof"), (range(0, 10, 2), None)])
def test_sizes_one_after_the_other_are_of_one_camera_and_sizes_by_turns_of_two(
    small: Sequence[int], of: str | None, tmp_path: Path
) -> None:
    files = {name: encoded(GREY[::2] if n in small else GREY, ".png") for n, name in enumerate(DAY)}
    found = indexed(folder_of(files, tmp_path))
    assert {(one.plan.part_of, one.size, len(one.images)) for one in found.cameras} == {
        (of, (24, 20), 5), (of, (24, 10), 5),
    }  # fmt: skip
    assert len({one.plan.name for one in found.cameras}) == 2
    assert [one.code for camera in found.cameras for one in camera.findings] == ["image_size_changed"] * 2


def test_files_that_hold_no_images_are_not_looked_at(tmp_path: Path) -> None:
    found = indexed(folder_of(named(DAY) | {"notes.txt": b"", "map.kml": b""}, tmp_path))
    assert codes(found) == []


def test_a_file_beyond_all_images_is_left_out_unread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(index_module, "MOST_BYTES", 1000)
    files = named(DAY) | {"20130513T190000Z.png": bytes(1001)}
    found = indexed(zip_of(files, tmp_path / "all.zip"))
    assert codes(found) == [("all.zip/20130513T190000Z.png", "file_too_large")]


def test_a_source_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        indexed(tmp_path / "nowhere")
    assert refused.value.field == str(tmp_path / "nowhere")
