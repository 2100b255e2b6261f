"""mrcal's stereographic model is our stereographic projection without distortion; it runs on the system's python."""

from __future__ import annotations

import json
import subprocess

import numpy as np
import pytest

from sunarc.optics.camera import Camera
from sunarc.optics.forward import project
from sunarc.optics.inverse import unproject

CAMERA = Camera(
    width=1748,
    height=1748,
    projection="stereographic",
    focal_length_px=(480.0, 481.5),
    principal_point_px=(871.5, 880.25),
    rotation_cam_enu=(0.0, 0.0, 0.0),
)
PROGRAM = """\
import json, sys
import mrcal, numpy
rays = numpy.array(json.load(sys.stdin))
print(json.dumps(mrcal.project(rays, "LENSMODEL_STEREOGRAPHIC", numpy.array([480.0, 481.5, 871.5, 880.25])).tolist()))
"""


def test_projects_and_unprojects_as_mrcal_does() -> None:
    rng = np.random.default_rng(1)
    theta, phi = rng.uniform(0.0, np.radians(99.0), 300), rng.uniform(-np.pi, np.pi, 300)
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)
    done = subprocess.run(
        ["/usr/bin/python3", "-c", PROGRAM],
        input=json.dumps(rays.tolist()),
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    if "No module named 'mrcal'" in done.stderr:
        pytest.skip("mrcal is not installed: apt-get install python3-mrcal")
    theirs = np.array(json.loads(done.stdout))
    np.testing.assert_allclose(project(CAMERA, rays), theirs, atol=1e-7)
    np.testing.assert_allclose(unproject(CAMERA, theirs), rays, atol=1e-9)
