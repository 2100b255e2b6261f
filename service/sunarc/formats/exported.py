"""A calibration in another format, and the origin that every file states (CF conventions 1.11, ACDD 1.3).

References: CF conventions 1.11; Attribute Convention for Data Discovery 1.3.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sunarc.common.utc import parse_time
from sunarc.formats.view import Differences

PLACE = "latitude longitude altitude"
"""Names of the scalar coordinates of every variable."""

FAR_PAST, FAR_FUTURE = "1970-01-01T00:00:00Z", "2199-12-31T00:00:00Z"
"""Written for a validity without a start or an end."""
_NOT_STATED = (
    *("creator_url", "creator_email", "institution", "project", "license"),
    *("publisher_name", "publisher_url", "publisher_email"),
)
"""Attributes that the convention recommends and a calibration does not say."""
_CONVENTIONS = (
    "pixel (0, 0) is the centre of the top-left one, x right, y down; azimuth clockwise from north; directions are "
    "apparent (refracted) unit vectors, east-north-up; a sigma is per axis; NaN outside the camera's field"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variable:
    """An array, the names of its dimensions, and its meaning.

    Attributes
    ----------
    dimensions : names; a dimension with a variable of its name has it as its coordinate.
    values : the array.
    attributes : units, long_name and others of the CF conventions.
    """

    dimensions: tuple[str, ...]
    values: NDArray[Any]
    attributes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Table:
    """Variables that belong together.

    Attributes
    ----------
    variables : by name.
    attributes : of the whole.
    """

    variables: Mapping[str, Variable]
    attributes: Mapping[str, Any]


def discovery_variables(document: Mapping[str, Any]) -> dict[str, Variable]:
    """Return the camera model, the place, and the time of validity.

    `time` is the start and the end of the validity, and `time_bnds` the interval itself; without an end it lasts to
    2199.
    """
    site = document["site"]
    times = np.array([time.timestamp() for time in _parse_validity(document)])

    def scalar(name: str, units: str, **more: str) -> Variable:
        return Variable(
            dimensions=(),
            values=np.array(float(site[name])),
            attributes={"standard_name": name, "long_name": f"{name} of the camera", "units": units, **more},
        )

    return {
        "camera": _make_model_variable(document),
        "latitude": scalar("latitude", "degrees_north"),
        "longitude": scalar("longitude", "degrees_east"),
        "altitude": scalar("altitude", "m", positive="up", axis="Z"),
        "time": Variable(
            dimensions=("time",),
            values=times,
            attributes={
                "standard_name": "time",
                "long_name": "start and end of the time in which the calibration is valid",
                "units": "seconds since 1970-01-01 00:00:00",
                "calendar": "standard",
                "units_metadata": "leap_seconds: none",
                "bounds": "time_bnds",
                "axis": "T",
            },
        ),
        "time_bnds": Variable(dimensions=("time", "bound"), values=np.stack([times, times]), attributes={}),
    }


def discovery_attributes(document: Mapping[str, Any], *, title: str) -> dict[str, Any]:
    """Return the attributes of the whole."""
    software, site, evidence = document["software"], document["site"], document["evidence"]
    program = f"{software['name']} {software['version']}"
    start, end = _parse_validity(document)
    point = {"lat": site["latitude"], "lon": site["longitude"], "vertical": site["altitude"]}
    extent = {f"geospatial_{name}_{side}": float(value) for name, value in point.items() for side in ("min", "max")}
    duration = f"PT{round((end - start).total_seconds())}S"
    return dict.fromkeys(_NOT_STATED, "not stated") | {
        "Conventions": "CF-1.11, ACDD-1.3",
        "title": title,
        "summary": f"{title}: camera {document['camera']}, calibrated from sightings of the sun",
        "keywords": "all-sky imager, geometric calibration, view direction, zenith angle, azimuth",
        "source": program,
        "history": f"{document['created_at']}: calibrated by {program}",
        "comment": _CONVENTIONS,
        "acknowledgment": "method: Urquhart et al., Atmospheric Measurement Techniques 9 (2016) 4279",
        "id": document["id"],
        "naming_authority": "sunarc",
        "product_version": software["version"],
        "processing_level": "calibration",
        "provenance": json.dumps({name: evidence[name] for name in ("days", "n_used", "n_rejected")}),
        "creator_name": program,
        "date_created": document["created_at"],
        "standard_name_vocabulary": "CF Standard Name Table v93",
        "geospatial_bounds": f"POINT ({site['latitude']} {site['longitude']})",
        "geospatial_bounds_crs": "EPSG:4326",
        "geospatial_bounds_vertical_crs": "EPSG:5714",
        "geospatial_vertical_positive": "up",
        **extent,
        "time_coverage_start": document["valid_from"] or FAR_PAST,
        "time_coverage_end": document["valid_until"] or FAR_FUTURE,
        "time_coverage_duration": duration,
        "time_coverage_resolution": duration,
        "camera_name": document["camera"],
        "calibration": document["id"],
        "valid_from": document["valid_from"] or "",
    }


def _parse_validity(document: Mapping[str, Any]) -> tuple[datetime, datetime]:
    start, end = document["valid_from"] or FAR_PAST, document["valid_until"] or FAR_FUTURE
    return parse_time(start, where="valid_from"), parse_time(end, where="valid_until")


def _make_model_variable(document: Mapping[str, Any]) -> Variable:
    """Return the variable whose attributes are the camera model; the CF conventions have no grid mapping for it."""
    model, image, site = document["model"], document["image"], document["site"]
    return Variable(
        dimensions=(),
        values=np.array(0, dtype=np.int32),
        attributes={
            "long_name": "camera model (schema sunarc.calibration/2)",
            "mirrored": int(image["mirrored"]),
            "latitude": float(site["latitude"]),
            "longitude": float(site["longitude"]),
            "altitude": float(site["altitude"]),
            **{name: np.asarray(value) if isinstance(value, list) else value for name, value in model.items()},
        },
    )


PIXELS = "pixel (0, 0) is the centre of the top-left one, x right, y down; azimuth clockwise from north"
_ZIP_TIME = (1980, 1, 1, 0, 0, 0)
"""The earliest that a zip file can say: the same calibration always makes the same bytes."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Exported:
    """A calibration in another format.

    Attributes
    ----------
    content : the file.
    error : how far it is from the calibration, in one sentence; the file says it too.
    difference : the same in numbers; None for the calibration itself, and where nothing was compared.
    name : what the file is called in a set.
    beside : files that belong with it, by the names that it calls them.
    """

    content: bytes
    error: str
    difference: Differences | None = None
    name: str = ""
    beside: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def files(self) -> dict[str, bytes]:
        """Return the files of a set by name."""
        return {self.name: self.content, **self.beside}

    @property
    def sent(self) -> bytes:
        """Return the one file that is sent: a set as a zip file."""
        if not self.beside:
            return self.content
        target = io.BytesIO()
        with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in self.files.items():
                archive.writestr(zipfile.ZipInfo(name, _ZIP_TIME), content)
        return target.getvalue()


def file_notes(document: Mapping[str, Any]) -> list[str]:
    """Return the notes at the head of every file: the writing program, the calibration, and the conventions."""
    software, limit = document["software"], document["uncertainty"].get("sigma_limit_deg")
    return [
        f"{software['name']} {software['version']}: camera {document['camera']}, calibration {document['id']}",
        f"conventions of the service: {PIXELS}",
        *([] if limit is None else [f"provisional: use no direction with a 1-sigma above {limit:g} degrees"]),
    ]
