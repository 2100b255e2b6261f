"""How far every format is from a calibration, for calibration documents and for lenses drawn with decentering p3, p4.

    PYTHONPATH=docs/studies .venv/bin/python docs/studies/formats.py --lenses 5 --seed 17 [CALIBRATION.json …]

Each file is read back and compared with the camera on 5003 directions to which no format was fitted. Prints, for each
format, the RMS and the largest difference in px and degrees over all cameras, the RMS by zenith angle in degrees, and
how far the stated RMS in px is from what is found.
"""

from __future__ import annotations

import argparse
import json
import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from population import random_camera

from sunarc.calibration.model.residual_field import Field
from sunarc.calibration.model.result import Calibration, Metrics, Provenance, Verdict
from sunarc.formats.calibration_document import from_document, to_document
from sunarc.formats.exported import Exported
from sunarc.formats.formats import FORMATS, export, read_view
from sunarc.formats.view import Comparison, camera_view, compare
from sunarc.optics.backward import BackwardModel
from sunarc.optics.camera import Camera
from sunarc.optics.displacement import WaveBasis
from sunarc.optics.pose import pose_angles
from sunarc.sky.site import Site

HEAD = "| format | px RMS | px, largest | degrees RMS | largest | 0-30 | 30-60 | 60-80 | 80-90 | stated |"


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("documents", nargs="*", type=Path)
    parser.add_argument("--lenses", type=int, default=5)
    parser.add_argument("--seed", type=int, default=17)
    chosen = parser.parse_args()
    rng = np.random.default_rng(chosen.seed)
    drawn = [document_of(random_camera(rng)) for _ in range(chosen.lenses)]
    cases = {path.name: [json.loads(path.read_text())] for path in chosen.documents} | {"drawn lenses": drawn}
    for name, documents in cases.items():
        print(f"\n{name}\n{HEAD}")
        print("|---|---|---|---|---|---|---|---|---|---|")
        for form in (one for one in FORMATS if one != "json" and not one.startswith("map-")):
            print(row(form, [measured(form, document) for document in documents]))


def measured(form: Any, document: dict[str, Any]) -> tuple[Comparison, float]:  # noqa: ANN401 - a format
    """Return the comparison of a camera with its own file, and how far the stated RMS is from it, relatively."""
    made: Exported = export(document, form)
    view = read_view(made.content, name=made.name or form, beside=made.beside.get)
    found = compare(camera_view(from_document(document).camera), view)
    stated = float(made.error.partition(" by ")[2].partition(" px RMS")[0])
    return found, abs(stated / found.total.rms_px - 1.0)


def row(form: str, found: list[tuple[Comparison, float]]) -> str:
    """Return a row of the table: RMS over the cameras, and the largest."""

    def rms(values: list[float]) -> float:
        return math.sqrt(np.mean(np.square(values)))

    totals = [one.total for one, _ in found]
    numbers = [
        rms([one.rms_px for one in totals]), max(one.max_px for one in totals),
        rms([one.rms_deg for one in totals]), max(one.max_deg for one in totals),
        *(rms([one.by_zenith[k].rms_deg for one, _ in found]) for k in range(4)),
    ]  # fmt: skip
    worst = f"{100.0 * max(stated for _, stated in found):.0f} %"
    return f"| `{form}` | " + " | ".join([*(f"{value:.2g}" for value in numbers), worst]) + " |"


def document_of(camera: Camera) -> dict[str, Any]:
    """Return a calibration document of a camera; its uncertainty is of no interest here."""
    basis = WaveBasis(center_px=(0.0, 0.0), half_px=(1400.0, 1400.0), orders=np.array([[1, 1]]))
    names = ("principal_point_x_px",)
    made = Calibration(
        camera=camera, poses=(camera.rotation_cam_enu,), parameter_names=names, covariance=np.array([[1e-4]]),
        field=Field(amplitude_px=0.0, length_px=425.0, basis=basis, cross=np.zeros((2, 1, 1))),
        sky_rms_deg=0.01, sky_max_deg=0.02,
        metrics=Metrics(n=1, rmse_px=0.0, rmse_all_px=0.0, mae_px=0.0, sd_px=0.0, sd_of_distance_px=0.0, rmse_deg=0.0),
        pose=pose_angles(camera.rotation_cam_enu),
        backward=BackwardModel(radial=(0.0,) * 8, decentering=(0.0,) * 5, max_error_px=0.0),
        evidence=Provenance(
            days=(), n_supplied=1, n_used=1, n_rejected=0, options={}, sigma_px=0.03, inflation=1.0, radial_px=1.7,
            clock_error_s=0.01,
        ),
        verdict=Verdict(accepted=True, findings=()), method="robust",
        site=Site(latitude=36.604043, longitude=-97.484856, altitude=318.0),
    )  # fmt: skip
    day = datetime(2013, 5, 13, tzinfo=UTC)
    return to_document(
        made, id="drawn", camera="drawn", state="current", created_at=day, valid_from=day, valid_until=None,
        pose_epoch="1", software_version="0",
    )  # fmt: skip


if __name__ == "__main__":
    main()
