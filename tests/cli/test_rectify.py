from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from tests.formats.conftest import LENS, document_of

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc


def test_images_are_mapped_into_a_folder_and_an_unknown_grid_is_refused(sunarc: Sunarc, tmp_path: Path) -> None:
    small = replace(LENS, width=220, height=200, focal_length_px=(75.0, 75.0), principal_point_px=(110.0, 100.0))
    calibration, image = tmp_path / "calibration.json", tmp_path / "noon.png"
    calibration.write_text(json.dumps(document_of(small)))
    cv2.imwrite(str(image), np.full((200, 220), 90, dtype=np.uint8))
    arguments = (
        "rectify",
        str(image),
        "--calibration",
        str(calibration),
        "-o",
        str(tmp_path / "maps"),
        "--size",
        "100",
    )
    answer = sunarc(*arguments)
    assert (answer.code, "% of the grid" in answer.out) == (0, True)
    found = cv2.imread(str(tmp_path / "maps" / "noon_sky.png"), cv2.IMREAD_UNCHANGED)
    assert found is not None
    assert (found.shape, int(found[50, 50]), int(found[0, 0])) == ((100, 100), 90, 0)
    printed = json.loads(sunarc(*arguments, "--json").out)
    assert printed[0]["file"] == str(image)
    refused = sunarc(*arguments, "--grid", "moon")
    assert (refused.code, "--grid: 'moon' is unknown" in refused.err) == (2, True)
