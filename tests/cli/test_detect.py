from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest
from astropy.io import fits

from sunarc.lab.simulation.options import SceneOptions
from sunarc.lab.simulation.scene import Scene
from sunarc.lab.simulation.truth import SGP, true_camera

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc

NOON = datetime(2013, 5, 13, 18, 30, tzinfo=UTC)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(true_camera(), SGP, options=SceneOptions(nd_transmission=0.01))


def test_the_sun_is_found_in_a_microsecond_frame_of_which_nothing_is_known(
    sunarc: Sunarc, scene: Scene, tmp_path: Path
) -> None:
    path = tmp_path / "noon.png"
    cv2.imwrite(str(path), scene.render(round(NOON.timestamp() * 1e6), exposure_us=20.0, full_scale=65535))
    answer = sunarc("detect", str(path), "--json")
    assert answer.code == 0
    (found,) = json.loads(answer.out)
    x, y = scene.sun_pixel(NOON.timestamp() + 10e-6)
    assert found["x_px"] == pytest.approx(x, abs=0.05)
    assert found["y_px"] == pytest.approx(y, abs=0.05)
    assert found["file"] == str(path)
    assert found["accepted"] is True


def test_what_a_program_made_of_images_is_left_out_unless_it_is_all(sunarc: Sunarc, tmp_path: Path) -> None:
    black = np.zeros((60, 80), dtype=np.uint8)
    made = [tmp_path / "keogram-20240611.jpg", tmp_path / "thumbnails" / "image-20240611044800.jpg"]
    for path in (*made, tmp_path / "image-20240611044800.jpg"):
        path.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(path), black)
    every = map(str, sorted(tmp_path.rglob("*.jpg")))
    (found,) = json.loads(sunarc("detect", *every, "--json").out)
    assert found["file"] == str(tmp_path / "image-20240611044800.jpg")
    alone = json.loads(sunarc("detect", *map(str, made), "--json").out)
    assert [one["file"] for one in alone] == [str(path) for path in made]


def test_an_image_without_the_sun_exits_1_and_says_why(sunarc: Sunarc, tmp_path: Path) -> None:
    path = tmp_path / "night.png"
    cv2.imwrite(str(path), np.zeros((200, 300), dtype=np.uint8))
    answer = sunarc("detect", str(path), "--json")
    assert answer.code == 1
    (found,) = json.loads(answer.out)
    assert found["x_px"] is None
    assert found["reason"]


@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n", b"not an image at all"])
def test_a_file_that_is_no_image_is_told_in_one_line(sunarc: Sunarc, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "torn.png"
    path.write_bytes(content)
    answer = sunarc("detect", str(path), "--json")
    assert answer.code == 2
    assert "torn.png: " in answer.err
    assert answer.err.count("\n") == 1


def test_a_file_that_is_not_there_is_told_in_one_line(sunarc: Sunarc, tmp_path: Path) -> None:
    answer = sunarc("detect", str(tmp_path / "absent.png"))
    assert answer.code == 2
    assert answer.err.count("\n") == 1


def test_an_overlay_shows_where_the_sun_was_found(sunarc: Sunarc, scene: Scene, tmp_path: Path) -> None:
    path, overlay = tmp_path / "noon.png", tmp_path / "overlay.png"
    cv2.imwrite(str(path), scene.render(round(NOON.timestamp() * 1e6), exposure_us=20.0, full_scale=65535))
    assert sunarc("detect", str(path), "--overlay", str(overlay)).code == 0
    drawn = cv2.imread(str(overlay))
    assert drawn is not None
    x, y = (round(float(value)) for value in scene.sun_pixel(NOON.timestamp()))
    blue, green, red = drawn[y, x + 20].tolist()
    assert green > max(blue, red) + 50


def test_a_saturated_twelve_bit_frame_is_taken_for_one(sunarc: Sunarc, tmp_path: Path) -> None:
    bare = Scene(true_camera(), SGP)
    path = tmp_path / "noon.png"
    cv2.imwrite(str(path), bare.render(round(NOON.timestamp() * 1e6), exposure_us=1.0, full_scale=4095))
    answer = sunarc("detect", str(path), "--json")
    (found,) = json.loads(answer.out)
    assert answer.code == 0, found
    assert found["saturated_px"] > 0
    assert (found["x_px"], found["y_px"]) == pytest.approx(tuple(bare.sun_pixel(NOON.timestamp())), abs=0.05)


def test_a_torn_file_among_others_is_listed_and_the_others_are_answered(
    sunarc: Sunarc, scene: Scene, tmp_path: Path
) -> None:
    good, torn = tmp_path / "noon.png", tmp_path / "torn.png"
    cv2.imwrite(str(good), scene.render(round(NOON.timestamp() * 1e6), exposure_us=20.0, full_scale=65535))
    torn.write_bytes(b"torn")
    answer = sunarc("detect", str(torn), str(good), "--json")
    assert answer.code == 0
    assert [row["verdict"] for row in json.loads(answer.out)] == ["no_frame", "clear"]
    assert "torn.png" in answer.err


@pytest.mark.parametrize(("option", "value"), [("--method", "magic"), ("--bayer", "XYZW")])
def test_an_unknown_choice_is_one_line_and_exit_2(sunarc: Sunarc, tmp_path: Path, option: str, value: str) -> None:
    answer = sunarc("detect", str(tmp_path / "x.png"), option, value)
    assert answer.code == 2
    assert f"{value!r} is unknown" in answer.err


def test_the_last_line_is_the_cause_that_took_most_images_and_no_word_is_cut(
    sunarc: Sunarc, scene: Scene, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    good = tmp_path / "noon.png"
    cv2.imwrite(str(good), scene.render(round(NOON.timestamp() * 1e6), exposure_us=20.0, full_scale=65535))
    dark = [tmp_path / f"night{number}.png" for number in range(2)]
    for path in dark:
        cv2.imwrite(str(path), np.zeros((200, 300), dtype=np.uint8))
    found = json.loads(sunarc("detect", str(dark[0]), "--json").out)
    answer = sunarc("detect", str(good), *map(str, dark))
    assert answer.code == 0
    assert found[0]["findings"][0]["code"]
    assert [found[0]["reason"] in line for line in answer.out.splitlines()[-3:]] == [True, True, True]
    assert answer.out.splitlines()[-1].startswith("1 of 3 images used, 2 refused: ")
    assert sunarc("detect", str(good), str(good), str(dark[0])).out.splitlines()[-1] == "2 of 3 images used"


def test_counts_of_8_bits_that_are_stored_as_16_show_the_same_sun(sunarc: Sunarc, tmp_path: Path) -> None:
    bare = Scene(true_camera(), SGP)
    eight = bare.render(round(NOON.timestamp() * 1e6), exposure_us=100.0, full_scale=255).astype(np.uint8)
    paths = [tmp_path / "8.png", tmp_path / "16.png", tmp_path / "16.fits"]
    cv2.imwrite(str(paths[0]), eight)
    cv2.imwrite(str(paths[1]), eight.astype(np.uint16))
    fits.PrimaryHDU(eight.astype(np.uint16)).writeto(paths[2])
    found = json.loads(sunarc("detect", *map(str, paths), "--json").out)
    assert found[0]["accepted"]
    assert [{**one, "file": ""} for one in found[1:]] == [{**found[0], "file": ""}] * 2
