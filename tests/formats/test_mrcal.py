from __future__ import annotations

import ast
import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.formats.conftest import FloatArray, worst_stated_px

from sunarc.formats.formats import export

PROGRAM = """\
import json, sys
import mrcal, numpy
model = mrcal.cameramodel(sys.argv[1])
rays = mrcal.transform_point_Rt(model.extrinsics_Rt_fromref(), numpy.array(json.load(sys.stdin)))
print(json.dumps(mrcal.project(rays, *model.intrinsics()).tolist()))
"""


def test_mrcal_projects_to_the_stated_error(
    document: dict[str, Any], sky: tuple[FloatArray, FloatArray], tmp_path: Path
) -> None:
    exported = export(document, "mrcal")
    path = tmp_path / "sunarc.cameramodel"
    path.write_bytes(exported.content)
    directions, pixels = sky
    done = subprocess.run(
        ["/usr/bin/python3", "-c", PROGRAM, path],
        input=json.dumps(directions.tolist()),
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )
    if "No module named 'mrcal'" in done.stderr:
        pytest.skip("mrcal is not installed: apt-get install python3-mrcal")
    assert done.returncode == 0, done.stderr
    off = np.linalg.norm(np.array(json.loads(done.stdout)) - pixels, axis=-1)
    assert off.max() < 1.2 * worst_stated_px(exported.error) + 1e-4
    assert worst_stated_px(exported.error) < 0.02


def test_the_file_is_a_python_literal_that_states_its_error(document: dict[str, Any]) -> None:
    exported = export(document, "mrcal")
    model = ast.literal_eval(exported.content.decode())
    assert model["imagersize"] == [1748, 1600]
    assert model["lensmodel"].startswith("LENSMODEL_SPLINED_STEREOGRAPHIC_order=3_Nx=40_Ny=40_fov_x_deg=")
    assert len(model["intrinsics"]) == 4 + 2 * 40 * 40
    assert exported.error in exported.content.decode()
