"""`sunarc reanalyse`: what it asks for, what it shows, and what it exits with."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.archives.in_process import InProcess, use
from tests.fixtures.command_line import Sunarc, sunarc
from tests.fixtures.packed_archives import GREY, encoded, folder_of

from sunarc.archives.results import Summary
from sunarc.cli import reanalyse as command
from sunarc.sources.index import Indexed

__all__ = ["sunarc"]

SITE = ("--latitude", "36.6", "--longitude", "-97.5")
IMAGES = {f"20130513T18{minute:02d}00Z.png": encoded(GREY, ".png") for minute in range(5)}


@pytest.fixture
def images(tmp_path: Path) -> Path:
    return folder_of(IMAGES, tmp_path / "roof")


def test_a_folder_without_suns_has_no_calibration_and_exits_1(
    sunarc: Sunarc, images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(InProcess(), monkeypatch)
    answer = sunarc("reanalyse", str(images), *SITE, "-o", str(tmp_path / "out"), "--yes", "--json")
    assert answer.code == 1
    (camera,) = json.loads(answer.out)["cameras"]
    assert (camera["camera"], camera["images"], camera["accepted"]) == ("roof", 5, 0)
    assert [one["code"] for one in camera["findings"]] == ["too_few_sightings"]
    assert "2013-05-13T18:00:00Z" in answer.err
    assert "5 images of " in answer.err
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"report.html", "report.json", "ledger.sqlite"}


def test_times_are_confirmed_or_the_command_ends(sunarc: Sunarc, images: Path, tmp_path: Path) -> None:
    answer = sunarc("reanalyse", str(images), *SITE, "-o", str(tmp_path / "out"))
    assert answer.code == 2
    assert "--yes" in answer.err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ((), "SOURCE"),
        (("IMAGES",), "--latitude"),
        (("IMAGES", "--latitude", "36.6"), "--longitude"),
        (("/nowhere", *SITE), "/nowhere"),
        (("IMAGES", *SITE, "--image-size", "wide"), "--image-size"),
        (("IMAGES", *SITE, "--mirrored", "perhaps"), "--mirrored"),
        (("IMAGES", *SITE, "--mirrored", "yes", "--mirrored", "yes"), "--mirrored"),
        (("IMAGES", *SITE, "--level-within", "100"), "calibration.level_within_deg"),
        (("--cameras", "/nowhere.toml"), "/nowhere.toml"),
    ],
)
def test_what_is_missing_or_wrong_is_named(
    sunarc: Sunarc, images: Path, tmp_path: Path, arguments: tuple[str, ...], field: str
) -> None:
    given = [str(images) if one == "IMAGES" else one for one in arguments]
    if not arguments:
        given = list(SITE)
    answer = sunarc("reanalyse", *given, "-o", str(tmp_path / "out"), "--yes")
    assert (answer.code, answer.err.splitlines()[-1].startswith(f"sunarc: {field}: ")) == (2, True)


@pytest.mark.parametrize(
    ("verdicts", "expected"),
    [((["accepted"] * 2,), 0), ((["accepted", "refused"],), 1), ((["accepted", "provisional"],), 0),
     ((["accepted"], []), 1), ((["accepted"], ["accepted"]), 0)],
)  # fmt: skip
def test_a_refused_epoch_or_a_camera_without_one_exits_1_beside_accepted_ones(
    sunarc: Sunarc,
    *,
    verdicts: tuple[list[str], ...],
    expected: int,
    images: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cameras = [
        {"epochs": [{name: name == one for name in ("accepted", "provisional")} for one in of_camera]}
        for of_camera in verdicts
    ]
    monkeypatch.setattr(command, "reanalyse", lambda *_, **__: Summary(report={"cameras": cameras}, documents={}))
    answer = sunarc("reanalyse", str(images), *SITE, "-o", str(tmp_path / "out"), "--yes", "--json")
    assert answer.code == expected


def test_a_source_without_an_image_that_can_be_used_exits_1_beside_an_accepted_camera(
    sunarc: Sunarc, images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    undated = folder_of({"sky.png": encoded(GREY, ".png")}, tmp_path / "mast")
    report = {"cameras": [{"camera": "roof", "epochs": [{"accepted": True}]}]}
    monkeypatch.setattr(command, "reanalyse", lambda *_, **__: Summary(report=report, documents={}))
    for sources, expected in (([images], 0), ([images, undated], 1)):
        asked = [str(one) for one in sources]
        answer = sunarc("reanalyse", *asked, *SITE, "-o", str(tmp_path / "out"), "--yes", "--json")
        assert answer.code == expected


def test_folders_of_days_are_one_camera(sunarc: Sunarc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [f"2013-05-{day}" for day in (13, 14, 15)]
    days = [folder_of({"183000.png": encoded(GREY, ".png")}, tmp_path / "roof" / name) for name in names]
    seen = list[Indexed]()

    def note(indexed: Indexed, *_: object, **__: object) -> Summary:
        seen.append(indexed)
        return Summary(report={"cameras": [], "failures": {}, "seconds": 0.0}, documents={})

    monkeypatch.setattr(command, "reanalyse", note)
    asked = ("--utc-offset", "0", "--time-pattern", "%Y-%m-%d/%H%M%S", "-o", str(tmp_path / "out"), "--yes")
    answer = sunarc("reanalyse", *map(str, days), *SITE, *asked)
    ((camera,),) = (one.cameras for one in seen)
    assert (camera.plan.name, len(camera.images)) == ("roof", 3)
    assert "3 sources" in answer.err


def test_a_pattern_is_for_one_camera_or_for_all(
    sunarc: Sunarc, images: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    other = folder_of({"day133 at 1801 of 2013.png": encoded(GREY, ".png")}, tmp_path / "mast")
    report: dict[str, object] = {"cameras": []}
    seen = []

    def note(indexed: Indexed, *_: object, **__: object) -> Summary:
        seen.append({one.plan.name: one.example[1] for one in indexed.cameras})
        return Summary(report=report | {"failures": {}, "seconds": 0.0}, documents={})

    monkeypatch.setattr(command, "reanalyse", note)
    asked = ("reanalyse", str(images), str(other), *SITE, "--utc-offset", "0", "-o", str(tmp_path / "out"), "--yes")
    sunarc(*asked, "--time-pattern", "mast=day%j at %H%M of %Y")
    sunarc(*asked, "--time-pattern", "mast=day%j at %H%M of %Y", "--time-pattern", "%Y%m%dT%H%M%SZ")
    expected = {"roof": "2013-05-13T18:00:00Z", "mast": "2013-05-13T18:01:00Z"}
    assert seen == [expected, expected]
    for wrong in (("--time-pattern", "hut=%Y"), ("--time-pattern", "%Y", "--time-pattern", "%j")):
        answer = sunarc(*asked, *wrong)
        assert (answer.code, answer.err.splitlines()[-1].startswith("sunarc: --time-pattern: ")) == (2, True)
