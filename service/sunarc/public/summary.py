"""The text of a calibration: the output of `sunarc calibrate` and of `print(calibration)`."""

from __future__ import annotations

from typing import Any

from sunarc.common.findings import parse_findings
from sunarc.common.messages import significant
from sunarc.formats.calibration_document import from_document
from sunarc.optics.mounting import pose_text


def summarize_verdict(document: dict[str, Any]) -> str:
    """Return the verdict on a calibration in a word."""
    verdict = document["verdict"]
    if verdict["marginal"] and document["uncertainty"].get("sigma_limit_deg") is not None:
        return "provisional"
    return "accepted" if verdict["accepted"] else "marginal" if verdict["marginal"] else "refused"


def calibration_text(document: dict[str, Any]) -> str:
    """Return the main numbers of a calibration document, its verdict and the remedies, a line each.

    One that is not accepted shows no number of its camera, which would be read as an answer.
    """
    metrics, verdict = document["metrics"], document["verdict"]
    lens, sky = _make_camera_rows(document) if summarize_verdict(document) in {"accepted", "provisional"} else ([], [])
    rows: list[list[str]] = [
        *lens,
        ["sightings used", f"{document['evidence']['n_used']} of {metrics['n'] + document['evidence']['n_rejected']}"],
        ["RMSE", _format_rmse(metrics)],
        *sky,
        ["verdict", summarize_verdict(document)],
        *(["", reason] for reason in verdict["reasons"]),
        *(["remedy", remedy] for remedy in _list_remedies(verdict)),
    ]
    width = max(len(name) for name, _ in rows) + 2
    return "\n".join(f"{name:{width}}{value}" for name, value in rows)


def _make_camera_rows(document: dict[str, Any]) -> tuple[list[list[str]], list[list[str]]]:
    """Return the rows of lens and pose, and those of their uncertainty."""
    model, sky = document["model"], document["uncertainty"]
    lens = [
        ["projection", model["projection"] + (", mirrored" if document["image"]["mirrored"] else "")],
        ["focal length", "{:.2f}, {:.2f} px".format(*model["focal_length_px"])],
        ["principal point", "{:.2f}, {:.2f} px".format(*model["principal_point_px"])],
        ["pose", pose_text(from_document(document).camera)],
        *([name.removesuffix("_deg"), f"{value:.3f}°"] for name, value in document["pose"].items()),
    ]
    extent = f"{significant(sky['sky_rms_deg'], 2)}° RMS, {significant(sky['sky_max_deg'], 2)}° at most"
    return lens, [["1-sigma over the sky", extent], ["residual field", field_text(sky["field"])]]


def _list_remedies(verdict: dict[str, Any]) -> list[str]:
    """Return the remedies of a calibration that is not accepted, each once."""
    found = [] if verdict["accepted"] else [finding.remedy for finding in parse_findings(verdict)]
    return [one for one in dict.fromkeys(found) if one != "none"]


def field_text(field: dict[str, Any]) -> str:
    """Return how large and how smooth the field is, and whether the prediction has its mean."""
    if field["amplitude_px"] == 0.0:
        return "none"
    part = "in the prediction" if any(map(any, field["mean"])) else "not in the prediction"
    return f"1-sigma {field['amplitude_px']:.3f} px over {field['length_px']:.0f} px, {part}"


def _format_rmse(metrics: dict[str, Any]) -> str:
    """Return the RMSE in words; a calibration refused before a fit has no value."""
    if metrics["rmse_px"] is None or metrics["rmse_deg"] is None:
        return "no fit"
    return f"{significant(metrics['rmse_px'], 2)} px, {significant(metrics['rmse_deg'], 2)}°"
