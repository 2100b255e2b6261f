"""The truth as a calibration document, so that everything that reads one can be held against it."""

from __future__ import annotations

import math
from datetime import datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from sunarc.calibration.model.backward import fit_backward
from sunarc.calibration.model.document import to_document
from sunarc.calibration.model.metrics import Metrics
from sunarc.calibration.model.residual_field import Field, WaveBasis
from sunarc.calibration.model.result import Calibration, Provenance, Verdict
from sunarc.findings import Finding
from sunarc.optics.camera import Camera
from sunarc.optics.pose import pose_angles
from sunarc.sky.site import Site


def truth_document(camera: Camera, site: Site, *, name: str, created_at: datetime) -> dict[str, Any]:
    """Return a camera as a calibration document ("sunarc.calibration/2"): without uncertainty, and without evidence."""
    truth = Calibration(
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        parameter_names=(),
        covariance=np.zeros((0, 0)),
        field=_no_field(camera),
        sky_rms_deg=0.0,
        sky_max_deg=0.0,
        metrics=_no_metrics(),
        pose=pose_angles(camera.rotation_cam_enu),
        backward=fit_backward(camera),
        evidence=_no_evidence(),
        verdict=Verdict(accepted=True, findings=(Finding("simulated_camera"),)),
        method="robust",
        site=site,
    )
    return to_document(
        truth,
        id="truth",
        camera=name,
        state="current",
        created_at=created_at,
        valid_from=created_at,
        valid_until=None,
        pose_epoch="truth",
        software_version=version("sunarc"),
    )


def _no_field(camera: Camera) -> Field:
    center = (camera.width / 2.0, camera.height / 2.0)
    basis = WaveBasis(center_px=center, half_px=center, orders=np.zeros((0, 2), dtype=np.int64))
    return Field(amplitude_px=0.0, length_px=1.0, basis=basis, cross=np.zeros((2, 0, 0)))


def _no_metrics() -> Metrics:
    return Metrics(
        n=0,
        rmse_px=math.nan,
        rmse_all_px=math.nan,
        mae_px=math.nan,
        sd_px=math.nan,
        sd_of_distance_px=math.nan,
        rmse_deg=math.nan,
        held_out_rmse_px=None,
    )


def _no_evidence() -> Provenance:
    return Provenance(
        days=(),
        n_supplied=0,
        n_used=0,
        n_rejected=0,
        options={},
        sigma_px=math.nan,
        inflation=math.nan,
        radial_px=math.nan,
        clock_error_s=math.nan,
    )
