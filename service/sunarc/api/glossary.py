"""What names mean wherever they stand: for what says nothing itself in the OpenAPI document."""

from __future__ import annotations

from typing import Any

_CALIBRATION_ID = "20130514T150508Z-52ee44"
_TIME = "2013-05-13T18:30:00Z"

_FIELDS: dict[str, tuple[str, Any]] = {
    "accepted": ("Whether it may be used.", True),
    "address": ("Of the camera on its network; empty where not known.", "192.168.0.2"),
    "apparent_zenith": ("With refraction, degrees.", None),
    "arc_deg": ("Arc of the sky that was covered, degrees.", 131.2),
    "at": ("The moment to answer for; now where not given.", _TIME),
    "azimuth": ("Degrees clockwise from north.", None),
    "background_fraction": ("Of the sky beside the sun, share of full scale.", 0.03),
    "body": ("What was looked at.", "sun"),
    "calibration": ("Id of the calibration that answered, or that was made; null without one.", _CALIBRATION_ID),
    "epoch_id": ("Id of a pose epoch, as events and calibrations name it.", "imager-2"),
    "calibration_id": ("Id of a calibration, as /v1/calibrations lists them.", _CALIBRATION_ID),
    "calibrations": ("On this page, the newest first.", None),
    "camera": ("Name of the camera; null where it concerns all.", "imager"),
    "camera_name": ("Name of this service's camera.", "imager"),
    "cameras": ("By name.", None),
    "capture": ("What capture has counted since the service started; null before its first cycle.", None),
    "clock": ("The clock that dates the frames; null before it was looked at.", None),
    "clock_error_s": ("Bound of the error of its time, s.", 0.01),
    "code": ("Stable name of the reason.", "camera_lost"),
    "complete": ("Count of cycles whose normal exposures all succeeded.", 2870),
    "connected": ("Whether the camera answers.", True),
    "covariance_px2": ("Covariance of x and y, px².", [[[0.0016, 0.0], [0.0, 0.0016]]]),
    "cycles": ("Count of slots served by day.", 2880),
    "date": ("Local mean solar date; today's by the frames' time where not given.", "2013-05-13"),
    "days": ("On this page, the newest first.", None),
    "detail": ("This problem, in one sentence.", "at: no calibration answers for 1999-01-01T00:00:00+00:00"),
    "details": ("Numbers that belong to it; their names carry their units.", {"rmse_px": 0.04}),
    "direction_enu": ("Unit vectors, east-north-up.", None),
    "disk": ("The disk that the images are on; null before it was looked at.", None),
    "disk_free_bytes": ("Free space where the state is kept, bytes.", 82_000_000_000),
    "doubtful_clock": ("Sightings whose time is too doubtful for a fit.", 0),
    "doubts": ("Count of rounds of exposures whose brightness contradicted what they said.", 1),
    "ellipticity": ("Of the disc that was fitted: 0 is a circle.", 0.04),
    "events": ("On this page, the newest first.", None),
    "exposure_us": ("Exposure, µs; 0 where it is not known.", 47.0),
    "failures": ("Count of exposures that failed at every attempt.", 0),
    "finished_at": ("When it ended; null until then.", _TIME),
    "frames": ("Count of exposures that succeeded.", 14400),
    "free_bytes": ("Free space, bytes.", 82_000_000_000),
    "hdr_s": ("From the beginning of the last cycle to the end of its normal exposures, s.", 0.31),
    "health": ("The worst of the reasons' severities.", None),
    "heartbeat_age_s": ("Seconds since its last sign of life.", 0.4),
    "id": ("Its name in the archive.", _CALIBRATION_ID),
    "if-none-match": ("An ETag that was sent: what it names is not sent again.", '"9f86d081884c7d65"'),
    "image_size": ("Width, height of the camera's image, px.", [1748, 1748]),
    "images_bytes": ("What the images take, bytes.", 12_000_000_000),
    "inside": ("Within the image and the camera's field.", None),
    "jitter_max_s": ("The largest jitter since the service started, s.", 0.012),
    "jitter_s": ("From the last slot to its first exposure, s.", 0.002),
    "kind": ("Stable name of the kind of event.", "bump"),
    "last_day": ("The newest day that has a verdict.", None),
    "last_error": ("What it died of last; null where it never did.", "CameraLostError: no answer"),
    "last_frame_at": ("Time of the newest frame.", _TIME),
    "last_sighting_at": ("Time of the newest accepted sighting.", _TIME),
    "last_step_at": ("When that clock was last set; null where it was not seen.", _TIME),
    "last_step_s": ("By how much that clock was last set, s.", 0.8),
    "limit": ("At most so many rows on a page.", 100),
    "losses": ("Count of exposures without a frame, or with one that lacked packets.", 3),
    "max_error_s": ("Bound of the clock's error, s; null where not known.", 0.01),
    "message": ("How it ended, in a sentence; empty until then.", "1-sigma over the sky 0.0099 degrees"),
    "method": ("The detector, or the kind of fit.", "disc"),
    "missed": ("Count of slots that passed without a cycle.", 0),
    "sun_dropped": ("Count of sun exposures that were not evaluated, for detection was too slow.", 0),
    "sun_missed": ("Count of slots with the sun up in which no sun exposure was taken.", 0),
    "model": ("Vendor and model, as the camera tells them.", "Vendor Model"),
    "n": ("Accepted sightings.", 379),
    "n_cycles": ("Cycles with a sighting on the day's smooth arc.", 402),
    "n_observed": ("Cycles in which sun exposures were taken, with a sighting or without.", 418),
    "n_possible": ("Cycles that the day had room for.", 418),
    "name": ("Its name.", "capture"),
    "oldest_image_at": ("Time of the oldest image that is kept.", _TIME),
    "openings": ("How often the camera was opened, a count.", 1),
    "parent": ("Id of the calibration it was compared with, or copied from; null for the first.", _CALIBRATION_ID),
    "peak_fraction": ("Of the sun, share of full scale.", 0.62),
    "pinned": ("Whether it stays current whatever a refit finds.", False),
    "pixel": ("x, y in px; null outside the field.", [871.96, 883.0]),
    "pixel_format": ("As the camera is set; empty where not known.", "Mono12"),
    "pixels": ("x, y in px; null outside the field.", [[400.0, 912.5], None]),
    "pose_epoch": ("Id of the interval in which the camera did not move.", "imager-1"),
    "pose_offset_deg": ("How the camera stood turned, about east, north and up, degrees.", [0.003, -0.001, 0.002]),
    "pose_offset_sigma_deg": ("1-sigma of each, degrees.", [0.002, 0.002, 0.004]),
    "radius_px": ("Of the disc that was fitted, px.", 3.1),
    "reason": ("Why, in words.", "the dome is clean"),
    "reasons": ("Why, in sentences.", ["91 % of the possible sightings lie on the arc"]),
    "refit_id": ("Id of a refit, as the answer to the request has it.", "3f2a9c"),
    "refits": ("On this page, the newest first.", None),
    "refusals": ("Count of frames of a wrong size, count or exposure.", 0),
    "remedy": ("What to do about it.", "check power, cable and address"),
    "residual_chi2": ("Of the disc that was fitted: reduced chi-squared, 1 is noise alone.", 1.1),
    "restarts": ("How often it was made anew.", 0),
    "retries": ("Count of exposures tried again.", 3),
    "rmsd_px": ("Scatter about the day's smooth arc, px in distance.", 0.07),
    "rmse_px": ("Of the sightings used, 2-D distance, px.", 0.041),
    "saturated_px": ("Pixels at full scale, a count.", 0),
    "sd_px": ("Scatter about the day's smooth arc, px per axis.", 0.05),
    "serial": ("Serial number, as the camera tells it.", "SIM-0001"),
    "severity": ("How grave it is.", None),
    "sigma_px": ("1-sigma per axis, px.", 0.04),
    "since": ("From then on.", _TIME),
    "sky_rms_deg": ("1-sigma per axis over the sky, degrees.", 0.0099),
    "snr": ("Signal to noise, a ratio.", 310.0),
    "solid_angle_sr": ("Solid angle of the sky that the sightings used surround, sr.", 0.4),
    "started_at": ("When it began; null until then.", _TIME),
    "state": ("How it stands.", None),
    "status": ("How it stands.", None),
    "sun_points": ("On this page, the newest first.", None),
    "synchronised": ("Whether a time service disciplines that clock; null where not known.", True),
    "temperature_c": ("The camera's own, degrees Celsius.", 41.5),
    "text": ("What is the matter, or what happened, in a sentence.", "the camera does not answer"),
    "time": ("Mid-exposure, or the moment it happened.", None),
    "until": ("Before then.", _TIME),
    "valid_until": ("Until when it answers; null: until further notice.", _TIME),
    "verdict": ("In a word.", None),
    "version": ("The software's version.", "0.2.0"),
    "workers": ("The threads that do the work.", None),
    "x_px": ("To the right, px; null where there is no answer.", 871.96),
    "y_px": ("Down, px; null where there is no answer.", 883.0),
}


def explain(document: dict[str, Any]) -> None:
    """Add what the glossary says of a field or a parameter, where the OpenAPI document says nothing."""
    for schema in document["components"]["schemas"].values():
        for name, field in schema.get("properties", {}).items():
            _explain(name, field, field)
    for operations in document["paths"].values():
        for operation in operations.values():
            for parameter in operation.get("parameters", ()):
                _explain(parameter["name"], parameter, parameter["schema"])


def _explain(name: str, described: dict[str, Any], schema: dict[str, Any]) -> None:
    meaning, example = _FIELDS.get(name, ("", None))
    if meaning and "description" not in described:
        described["description"] = schema.get("description", meaning)
    if example is not None and "examples" not in schema and "example" not in described and _is_plain(schema):
        schema["examples"] = [example]


def _is_plain(schema: dict[str, Any]) -> bool:
    """Tell whether a schema needs an example of its own: those that another has, and lists of words, have them."""
    return not any(word in str(schema) for word in ("$ref", "'enum'", "'const'"))
