"""Directions to pixels and back, by a calibration document alone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TextIO

import numpy as np

from sunarc.archive.csv_files import read_pairs, write_columns
from sunarc.calibration.model.backward import camera_sees
from sunarc.calibration.model.covariance import project_with_covariance, sigma_px, unproject_with_sigma
from sunarc.calibration.model.document import from_document
from sunarc.calibration.model.result import Calibration
from sunarc.errors import InputError
from sunarc.offline.files import read_file
from sunarc.sky.directions import angles_from_direction, direction_from_angles

_PLACES = 10


def project_csv(calibration: Path, source: TextIO, target: TextIO) -> None:
    """Read zenith_deg,azimuth_deg and write x_px,y_px,sigma_px,cov_xx,cov_xy,cov_yy,inside."""
    solved = read_calibration(calibration)
    angles = read_pairs(source, columns=("zenith_deg", "azimuth_deg"), name="standard input")
    direction = direction_from_angles(zenith_deg=angles[:, 0], azimuth_deg=angles[:, 1])
    pixels, covariance = project_with_covariance(solved, direction)
    columns = {
        "x_px": pixels[:, 0],
        "y_px": pixels[:, 1],
        "sigma_px": sigma_px(covariance),
        "cov_xx": covariance[:, 0, 0],
        "cov_xy": covariance[:, 0, 1],
        "cov_yy": covariance[:, 1, 1],
        "inside": camera_sees(solved.camera, pixels).astype(np.float64),
    }
    write_columns(target, columns, places=dict.fromkeys(columns, _PLACES) | {"inside": 0})


def unproject_csv(calibration: Path, source: TextIO, target: TextIO) -> None:
    """Read x_px,y_px and write zenith_deg,azimuth_deg,sigma_deg,inside."""
    pixels = read_pairs(source, columns=("x_px", "y_px"), name="standard input")
    direction, sigma_deg, inside = unproject_with_sigma(read_calibration(calibration), pixels)
    zenith, azimuth = angles_from_direction(direction)
    columns = {
        "zenith_deg": zenith,
        "azimuth_deg": azimuth,
        "sigma_deg": sigma_deg,
        "inside": np.asarray(inside, dtype=np.float64),
    }
    write_columns(target, columns, places=dict.fromkeys(columns, _PLACES) | {"inside": 0})


def read_calibration(path: Path) -> Calibration:
    """Return the calibration of a document's file; InputError when it is none."""
    try:
        document = json.loads(read_file(path))
    except ValueError:
        raise InputError(field=str(path), problem="is not JSON", remedy="give a calibration document") from None
    return from_document(document)
