"""The report of a run: one page of HTML with everything in it, and its numbers as JSON."""

from __future__ import annotations

import base64
import math
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import sunarc
from sunarc.archives.leaning import seen_directions
from sunarc.archives.passes import FoundSun
from sunarc.archives.results import CameraResult, Summary
from sunarc.archives.states import Epoch, State
from sunarc.calibration.answers.covariance import sky_share_within
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import disk_errors
from sunarc.common.findings import Finding
from sunarc.common.json_text import json_text
from sunarc.common.robust_statistics import fast_median
from sunarc.common.utc import DAY_S, utc_time
from sunarc.optics.forward import project
from sunarc.optics.mounting import pose_text
from sunarc.optics.pose import pose_angles
from sunarc.sky.days import solar_date, solar_days
from sunarc.sky.sun import sun_directions
from sunarc.sources.image_files import images_in
from sunarc.sources.sources import open_source

_PICTURE_PX = 320
_COMMAND = re.compile("`([^`]+)`")
_IN_ONE_LINE = re.compile(r"(?<=\d) (?=[°%±]|(?:px|s|min|h|m|km|MB|GB|UTC)\b)|(?<=±) | (?=±)")
_TRACK_S = 600.0
_MOST_DAYS = 40
"""Days of a camera that are listed; the tables have all."""
_STYLE = """body{font:15px sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}th,td{border:1px solid #bbb;padding:.25em .6em;text-align:left}
td.n{text-align:right}figure{display:inline-block;margin:.5em 0}img{max-width:min(320px,100%)}h2{margin-top:2em}
.wide{overflow-x:auto}svg{min-width:600px}td:nth-child(5){min-width:5em}"""


def write_report(target: Path, summary: Summary, results: Sequence[CameraResult]) -> None:
    """Write `report.html` and `report.json` into a folder.

    Raises
    ------
    OutsideError : they cannot be written.
    """
    page = report_page(summary, results)
    with disk_errors(target):
        (target / "report.html").write_text(page, encoding="utf-8")
        (target / "report.json").write_text(json_text(summary.report))


def report_page(summary: Summary, results: Sequence[CameraResult]) -> str:
    """Return the report as HTML that needs no other file."""
    cameras = summary.report["cameras"]
    parts = [_overview(summary.report)]
    parts += [_camera(numbers, result) for numbers, result in zip(cameras, results, strict=True)]
    return (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1"><title>Archive analysed again</title>'
        f"<style>{_STYLE}</style></head><body><main><h1>Archive analysed again</h1>{''.join(parts)}"
        f"<p>sunarc {escape(sunarc.__version__)}. Tables: sightings.csv, epochs.json, failures.csv; calibrations and "
        "exports in the folders of these names.</p></main></body></html>"
    )


def write_prose(text: str) -> str:
    """Return a text as HTML: commands between backticks as code, a number and its unit in one line."""
    return _IN_ONE_LINE.sub("\u00a0", _COMMAND.sub(r"<code>\1</code>", escape(text)))


def _overview(report: dict[str, Any]) -> str:
    rows = [
        (
            one["camera"],
            one["images"],
            one["accepted_first_pass"],
            one["second_pass"]["found"],
            one["second_pass"]["refused"],
            one["accepted"],
            len(one["epochs"]),
        )
        for one in report["cameras"]
    ]
    header = ("camera", "images", "suns, first pass", "found with prediction", "refused with it", "suns", "epochs")
    failures = [(code, n) for code, n in report["failures"].items()]
    refused = "".join(
        f"<p><b>{escape(one['camera'])}</b>: {write_prose(one['reason'])}</p>" for one in report["refused"]
    )
    return (
        _table(header, rows)
        + refused
        + (_table(("files left out (why: failures.csv)", "number"), failures) if failures else "")
    )


def _camera(numbers: dict[str, Any], result: CameraResult) -> str:
    findings = "".join(f"<p>{write_prose(one['reason'])}</p>" for one in numbers["findings"])
    verdicts = ", ".join(f"{n} {verdict}" for verdict, n in numbers["by_verdict"].items())
    head = f"<h2>{escape(result.name)}</h2>{findings}<p>Images that were looked at: {escape(verdicts or '0')}.</p>"
    night = numbers["nights"]
    if night["images"]:
        head += (
            f"<p>Images of the night: {night['images']}, of which {night['looked_at']} were looked at; "
            f"{night['stars']} stars named in {night['accepted']}.</p>"
        )
    if result.final is None:
        return head + "<p>No calibration.</p>"
    line = time_line(
        [(result.epoch_name(n), one.cause, one.start_unix_s, one.end_unix_s) for n, one in enumerate(result.epochs)]
    )
    return (
        head
        + line
        + _epochs(numbers["epochs"])
        + _poses(result)
        + _residuals(result)
        + _days(result)
        + _pictures(result)
    )


def _refusal(epoch: dict[str, Any]) -> str:
    return ("" if epoch["provisional"] else "refused: ") + "; ".join(epoch["reasons"])


def _epochs(epochs: Iterable[dict[str, Any]]) -> str:
    rows = [
        (
            one["epoch"],
            one["cause"],
            _time(one["start"]),
            _time(one["end"]),
            f"{one['clock_offset_s']:+.1f}",
            one["sightings"],
            _number(one["rmse_px"]),
            _number(one["sky_rms_deg"]),
            "accepted" if one["accepted"] else _refusal(one),
        )
        for one in epochs
    ]
    header = (
        "epoch",
        "cause",
        "from, UTC",
        "to, UTC",
        "clock ahead, s",
        "suns",
        "RMSE, px",
        "sky error, °",
        "calibration",
    )
    return _table(header, rows)


def _poses(result: CameraResult) -> str:
    """Return the pose of each epoch in words and angles, with the 1-sigma of directions over the sky."""
    assert result.final is not None  # noqa: S101 - the caller asked
    limit_deg = result.camera.plan.options.max_sky_deg
    rows = []
    for number, epoch in enumerate(result.epochs):
        found = result.final.states[epoch.state].calibration
        angles = pose_angles(found.camera.rotation_cam_enu)
        rows.append(
            (
                result.epoch_name(number),
                _number(found.sky_rms_deg),
                _number(found.sky_max_deg),
                f"{math.floor(100.0 * sky_share_within(found, limit_deg))} %",
                pose_text(found.camera),
                *(f"{angle:.2f}" for angle in angles),
            )
        )
    header = (
        "epoch",
        "1-sigma RMS, °",
        "at worst, °",
        f"sky within {limit_deg:g}°",
        "pose",
        "φxz, °",
        "θzz, °",
        "ψz, °",
    )
    return "<p>1-sigma of directions over the sky, and pose:</p>" + _table(header, rows)


def _time(written: str) -> str:
    """Return a time of RFC 3339 to the minute, which no line is broken within."""
    return written[:16].replace("T", "\N{NO-BREAK SPACE}").replace("-", "\N{NON-BREAKING HYPHEN}")


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _residuals(result: CameraResult) -> str:
    assert result.final is not None  # noqa: S101 - the caller asked
    points, _ = result.looked.points()
    distance = np.zeros(len(points))
    for number, state in enumerate(result.final.states):
        rows = result.final.path == number
        distance[rows] = _distance(state, points.unix_s[rows], points.pixels[rows], result)
    return "<p>Distance of the sightings from their calibration, px:</p>" + residuals(points.unix_s, distance)


def _distance(state: State, unix_s: Any, pixels: Any, result: CameraResult) -> Any:  # noqa: ANN401 - arrays
    return np.nan_to_num(np.linalg.norm(pixels - _sun_pixels(state, unix_s, result), axis=-1))


def _sun_pixels(state: State, unix_s: FloatArray, result: CameraResult) -> FloatArray:
    """Return where a state predicts the sun at stated times, (n, 2) px."""
    times = unix_s - state.clock_offset_s
    seen = seen_directions(state.calibration, sun_directions(times, result.camera.plan.site), times)
    return project(state.calibration.camera, seen)


def _days(result: CameraResult) -> str:
    times = np.array([image.unix_s for image in result.looked.images])
    day = solar_days(times, longitude=result.camera.plan.site.longitude)
    seen = np.array([isinstance(one, FoundSun) and one.accepted for one in result.looked.found])
    days = np.unique(day)
    rows = [
        (
            solar_date(float(times[day == one][0]), longitude=result.camera.plan.site.longitude).isoformat(),
            int(np.count_nonzero(day == one)),
            int(np.count_nonzero(seen[day == one])),
        )
        for one in days[:: days.size // _MOST_DAYS + 1].tolist()
    ]
    title = (
        f"<p>{days.size} day{'s' * (days.size != 1)}"
        + (f", every {days.size // _MOST_DAYS + 1}th:" if days.size > _MOST_DAYS else ":")
        + "</p>"
    )
    return title + _table(("day", "images", "suns"), rows)


def _pictures(result: CameraResult) -> str:
    """Return a picture of each epoch with the sun's track of its day, by the epoch's calibration."""
    figures = [_figure(result, n, epoch) for n, epoch in enumerate(result.epochs) if epoch.last >= epoch.first]
    return "".join(figures)


def _figure(result: CameraResult, number: int, held: Epoch) -> str:
    assert result.final is not None  # noqa: S101 - the caller asked
    _, rows = result.looked.points()
    image = result.looked.images[rows[(held.first + held.last) // 2]]
    source = open_source(image.address)
    ((_, found),) = images_in(source, image.file, [image.number], size=result.camera.size)
    if isinstance(found, Finding):
        return ""
    picture = _eight_bits(found)
    state = result.final.states[held.state]
    pixels = _sun_pixels(state, image.unix_s + np.arange(-0.5 * DAY_S, 0.5 * DAY_S, _TRACK_S), result)
    thickness = max(1, max(picture.shape[:2]) // 300)
    for x, y in pixels[np.all(np.isfinite(pixels), axis=1)].tolist():
        cv2.circle(picture, (round(x), round(y)), 2 * thickness, (0, 220, 255), -1)
    scale = min(1.0, _PICTURE_PX / max(picture.shape[:2]))
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    encoded = base64.b64encode(cv2.imencode(".jpg", small)[1].tobytes()).decode()
    epoch, caption = result.epoch_name(number), f"{result.epoch_name(number)}: {image.name}"
    return (
        f'<figure><img alt="Sun\'s track in epoch {epoch}" src="data:image/jpeg;base64,{encoded}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
    )


def _eight_bits(image: Any) -> Any:  # noqa: ANN401 - arrays
    """Return a picture in 8 bit colours, its median at a third of the scale where it is deeper."""
    light = image.astype(np.float64)
    if image.dtype != np.uint8:
        light *= 85.0 / max(fast_median(light.ravel()), 1.0)
    grey = np.clip(light, 0.0, 255.0).astype(np.uint8)
    return np.ascontiguousarray(grey if grey.ndim == 3 else cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))


def _table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = "".join(
        "<tr>" + "".join(f"<td{_align(cell)}>{write_prose(str(cell))}</td>" for cell in row) + "</tr>" for row in rows
    )
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
    return f'<div class="wide" tabindex="0" role="group" aria-label="Table of {escape(header[0])}">{table}</div>'


def _align(cell: object) -> str:
    return ' class="n"' if isinstance(cell, int | float) else ""


# Drawings of the report as SVG: epochs on a time line, residuals over time.

_WIDTH, _LEFT, _RIGHT = 960, 60, 12
_COLOURS = {
    "start": "#4477aa", "moved": "#ee6677", "lens": "#aa3377", "clock": "#ccbb44", "unexplained": "#bbbbbb",
    "resized": "#66ccee",
}  # fmt: skip
"""By the cause of an epoch: P. Tol's scheme, which people with a colour deficiency can tell apart."""
_MOST_POINTS = 4000


def time_line(epochs: Sequence[tuple[str, str, float, float]]) -> str:
    """Return epochs on a time line.

    Parameters
    ----------
    epochs : name, cause, begin and end (seconds since 1970-01-01 UTC) of each.
    """
    if not epochs:
        return ""
    at = _scale(epochs[0][2], epochs[-1][3])
    parts = []
    for name, cause, start, end in epochs:
        x, width = at(start), max(at(end) - at(start), 2.0)
        title = f"{name}, {cause}: {utc_time(start):%Y-%m-%d %H:%M} to {utc_time(end):%Y-%m-%d %H:%M}"
        parts.append(
            f'<rect x="{x:.1f}" y="6" width="{width:.1f}" height="22" fill="{_COLOURS[cause]}"><title>{escape(title)}'
            f'</title></rect><text x="{x + 3:.1f}" y="44">{escape(name)} {escape(cause)}</text>'
        )
    return _svg(60, "Epochs on a time line", "".join(parts))


def residuals(unix_s: FloatArray, distance_px: FloatArray) -> str:
    """Return how far sightings are from their calibration, (n,) px, over time."""
    if unix_s.size == 0:
        return ""
    some = np.unique(np.linspace(0, unix_s.size - 1, min(unix_s.size, _MOST_POINTS)).astype(int))
    top = max(float(np.quantile(distance_px, 0.98)) * 1.2, 0.1)
    at = _scale(float(unix_s[0]), float(unix_s[-1]))
    high = np.minimum(distance_px / top, 1.0)
    dots = "".join(
        f'<circle cx="{at(float(unix_s[n])):.1f}" cy="{150.0 - 140.0 * high[n]:.1f}" r="1.5"/>' for n in some.tolist()
    )
    axis = (
        f'<text x="2" y="16">{top:.2f} px</text><text x="2" y="154">0</text>'
        f'<text x="{_LEFT}" y="172">{utc_time(float(unix_s[0])):%Y-%m-%d}</text>'
        f'<text x="{_WIDTH - 90}" y="172">{utc_time(float(unix_s[-1])):%Y-%m-%d}</text>'
        f'<line x1="{_LEFT}" y1="150" x2="{_WIDTH - _RIGHT}" y2="150" stroke="#888"/>'
    )
    return _svg(
        180, "Distance of the sightings from their calibration over time", axis + f'<g fill="#4477aa">{dots}</g>'
    )


class _scale:  # noqa: N801 - called as a function
    """Times to horizontal places."""

    def __init__(self, start: float, end: float) -> None:
        self._start, self._span = start, max(end - start, 1.0)

    def __call__(self, unix_s: float) -> float:
        return _LEFT + (_WIDTH - _LEFT - _RIGHT) * (unix_s - self._start) / self._span


def _svg(height: int, title: str, content: str) -> str:
    return (
        f'<div class="wide" tabindex="0" role="group" aria-label="{escape(title)}">'
        f'<svg role="img" aria-label="{escape(title)}" viewBox="0 0 {_WIDTH} {height}" width="100%" font-size="11" '
        f'font-family="sans-serif"><title>{escape(title)}</title>{content}</svg></div>'
    )
