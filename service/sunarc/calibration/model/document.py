"""The calibration document: what is served, stored and printed; it alone suffices to project and to unproject."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields
from datetime import datetime
from typing import Any

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.model.backward import BackwardModel
from sunarc.calibration.model.metrics import Metrics
from sunarc.calibration.model.residual_field import Field, WaveBasis
from sunarc.calibration.model.result import Calibration, Move, Provenance, Verdict
from sunarc.errors import InputError
from sunarc.findings import Finding, from_json
from sunarc.optics import PARAMETER_NAMES, Camera, pose_angles
from sunarc.sky import Site
from sunarc.utc import rfc3339

SCHEMA = "sunarc.calibration/1"

Document = dict[str, Any]

_SMALLEST_SHARE = 1e-5
"""Waves that hang together with no parameter by more than this share of the one that does most do not travel."""


def to_document(
    calibration: Calibration,
    *,
    id: str,  # noqa: A002 - the document's own name for it
    camera: str,
    state: str,
    created_at: datetime,
    valid_from: datetime | None,
    valid_until: datetime | None,
    pose_epoch: str,
    software_version: str,
) -> Document:
    """Return the document of a calibration (DESIGN, section 6): plain values, ready for JSON.

    Parameters
    ----------
    calibration : the calibration.
    id, camera, pose_epoch : names.
    state : candidate, current, retired or refused.
    created_at, valid_from, valid_until : aware times; None where there is none.
    software_version : the version that made it.
    """
    return {
        "schema": SCHEMA,
        "id": id,
        "camera": camera,
        "state": state,
        "method": calibration.method,
        "created_at": rfc3339(created_at),
        "valid_from": _time(valid_from),
        "valid_until": _time(valid_until),
        "pose_epoch": pose_epoch,
        "site": asdict(calibration.site),
        "image": {
            "width": calibration.camera.width,
            "height": calibration.camera.height,
            "mirrored": calibration.camera.mirrored,
        },
        "model": _model(calibration.camera),
        "backward_model": {
            "radial": list(calibration.backward.radial),
            "decentering": list(calibration.backward.decentering),
            "max_error_px": _number(calibration.backward.max_error_px),
        },
        "pose": calibration.pose._asdict(),
        "uncertainty": _uncertainty(calibration),
        "metrics": {f.name: _number(getattr(calibration.metrics, f.name)) for f in fields(Metrics)},
        "evidence": {f.name: _plain(getattr(calibration.evidence, f.name)) for f in fields(Provenance)},
        "verdict": {
            "accepted": calibration.verdict.accepted,
            "marginal": calibration.verdict.marginal,
            "reasons": list(calibration.verdict.reasons),
            "findings": [finding.as_json() for finding in calibration.verdict.findings],
        },
        "software": {"name": "sunarc", "version": software_version},
    }


def _uncertainty(calibration: Calibration) -> Document:
    return {
        "parameters": list(calibration.parameter_names),
        "covariance": calibration.covariance.tolist(),
        "field": _field(calibration.field),
        "sky_rms_deg": _number(calibration.sky_rms_deg),
        "sky_max_deg": _number(calibration.sky_max_deg),
    }


def _model(camera: Camera) -> Document:
    return {
        "projection": camera.projection,
        "focal_length_px": list(camera.focal_length_px),
        "skew_px": camera.skew_px,
        "principal_point_px": list(camera.principal_point_px),
        "rotation_cam_enu": list(camera.rotation_cam_enu),
        "translation": list(camera.translation),
        "radial": list(camera.radial),
        "decentering": list(camera.decentering),
        "max_angle_deg": math.degrees(camera.max_angle),
    }


def _field(field: Field) -> Document:
    size = np.max(np.abs(field.cross), axis=0, initial=0.0)
    share = np.max(size / np.maximum(np.max(size, axis=1, keepdims=True, initial=0.0), 1e-300), axis=0, initial=0.0)
    significant = np.flatnonzero(share > _SMALLEST_SHARE) if field.amplitude_px > 0.0 else np.zeros(0, dtype=np.int64)
    return {
        "amplitude_px": field.amplitude_px,
        "length_px": field.length_px,
        "center_px": list(field.basis.center_px),
        "half_px": list(field.basis.half_px),
        "orders": field.basis.orders[significant].tolist(),
        "cross": [[[float(f"{v:.8g}") for v in row] for row in part] for part in field.cross[:, :, significant]],
    }


def _time(time: datetime | None) -> str | None:
    return None if time is None else rfc3339(time)


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _plain(value: object) -> object:
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, Move):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, tuple | list) else value


def from_document(document: object) -> Calibration:
    """Return the calibration that a document holds.

    Raises
    ------
    InputError
        Names the key that is missing or not what it should be.
    """
    read = _Reader(document)
    if read.value("schema") != SCHEMA:
        remedy = f"give a {SCHEMA} document, or use the version of sunarc that wrote this one"
        raise InputError(
            field="schema", problem=f"{read.value('schema')!r}, which this version does not read", remedy=remedy
        )
    camera = _read_camera(read)
    names = tuple(str(n) for n in read.items("uncertainty.parameters"))
    if any(n not in PARAMETER_NAMES for n in names):
        raise InputError(field="uncertainty.parameters", problem="an unknown name", remedy="use the model's parameters")
    method = read.value("method")
    if method not in ("robust", "paper"):
        raise InputError(field="method", problem=f"{method!r} is unknown", remedy="use robust or paper")
    return Calibration(
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        parameter_names=names,
        covariance=read.array("uncertainty.covariance", (len(names), len(names))),
        field=_read_field(read, len(names)),
        sky_rms_deg=read.number("uncertainty.sky_rms_deg"),
        sky_max_deg=read.number("uncertainty.sky_max_deg"),
        metrics=_read_metrics(read),
        pose=pose_angles(camera.rotation_cam_enu),
        backward=BackwardModel(
            radial=read.numbers("backward_model.radial", 8),
            decentering=read.numbers("backward_model.decentering", 5),
            max_error_px=read.number("backward_model.max_error_px"),
        ),
        evidence=_read_evidence(read),
        verdict=Verdict(
            accepted=bool(read.value("verdict.accepted")),
            findings=_read_findings(read),
            marginal=bool(read.value("verdict.marginal", needed=False)),
        ),
        method=method,
        site=Site(**read.numbers_of("site", Site)),
    )


def _read_findings(read: _Reader) -> tuple[Finding, ...]:
    """Return the findings; documents of version 0.2 have sentences alone."""
    coded = read.value("verdict.findings", needed=False) is not None
    return tuple(from_json(one) for one in read.items("verdict.findings" if coded else "verdict.reasons"))


def _read_camera(read: _Reader) -> Camera:
    width, height = read.number("image.width"), read.number("image.height")
    focal, center = read.numbers("model.focal_length_px", 2), read.numbers("model.principal_point_px", 2)
    rotation, shift = read.numbers("model.rotation_cam_enu", 3), read.numbers("model.translation", 3)
    return Camera(
        width=_size("image.width", width),
        height=_size("image.height", height),
        projection=read.value("model.projection"),
        focal_length_px=(focal[0], focal[1]),
        principal_point_px=(center[0], center[1]),
        rotation_cam_enu=(rotation[0], rotation[1], rotation[2]),
        skew_px=read.number("model.skew_px"),
        translation=(shift[0], shift[1], shift[2]),
        radial=read.numbers("model.radial", 8),
        decentering=read.numbers("model.decentering", 4),
        mirrored=bool(read.value("image.mirrored")),
        max_angle=math.radians(read.number("model.max_angle_deg")),
    )


def _size(key: str, value: float) -> int:
    if not (math.isfinite(value) and value >= 1.0):
        raise InputError(field=key, problem=f"{value} is no size", remedy="give px")
    return int(value)


def _read_field(read: _Reader, size: int) -> Field:
    key = "uncertainty.field"
    orders = read.array(f"{key}.orders", (len(read.items(f"{key}.orders")), 2)).astype(np.int64)
    if np.any(orders < 1):
        raise InputError(field=f"{key}.orders", problem="a number below 1", remedy="give numbers of half waves")
    center, half = read.numbers(f"{key}.center_px", 2), read.numbers(f"{key}.half_px", 2)
    return Field(
        amplitude_px=read.number(f"{key}.amplitude_px"),
        length_px=read.number(f"{key}.length_px"),
        basis=WaveBasis(center_px=(center[0], center[1]), half_px=(half[0], half[1]), orders=orders),
        cross=read.array(f"{key}.cross", (2, size, orders.shape[0])),
    )


def _read_metrics(read: _Reader) -> Metrics:
    numbers = read.numbers_of("metrics", Metrics)
    return Metrics(**numbers | {"n": read.count("metrics.n")})


def _read_evidence(read: _Reader) -> Provenance:
    options = read.value("evidence.options")
    return Provenance(
        days=tuple(str(d) for d in read.items("evidence.days")),
        n_supplied=read.count("evidence.n_supplied"),
        n_used=read.count("evidence.n_used"),
        n_rejected=read.count("evidence.n_rejected"),
        options=options if isinstance(options, dict) else {},
        sigma_px=read.number("evidence.sigma_px", needed=False),
        inflation=read.number("evidence.inflation", needed=False),
        radial_px=read.number("evidence.radial_px", needed=False),
        clock_error_s=read.number("evidence.clock_error_s", needed=False),
        circle=read.value("evidence.circle", needed=False),
        start=read.value("evidence.start", needed=False),
        selection=read.value("evidence.selection", needed=False) or {},
        pose_spread_deg=_read_spread(read),
        moves=tuple(_read_move(_Reader(each)) for each in read.value("evidence.moves", needed=False) or ()),
    )


def _read_move(read: _Reader) -> Move:
    x, y, z = read.numbers("pose_before", 3)
    numbers = {name: read.number(name) for name in ("before_unix_s", "after_unix_s", "turn_deg")}
    return Move(**numbers, pose_before=(x, y, z))


def _read_spread(read: _Reader) -> tuple[float, float, float] | None:
    if read.value("evidence.pose_spread_deg", needed=False) is None:
        return None
    east, north, up = read.numbers("evidence.pose_spread_deg", 3)
    return east, north, up


class _Reader:
    """Reads values by dotted keys, and names the key where one is wrong."""

    def __init__(self, document: object) -> None:
        self._document = document

    def value(self, key: str, *, needed: bool = True) -> Any:  # noqa: ANN401 - JSON holds anything
        found: Any = self._document
        for part in key.split("."):
            if not isinstance(found, Mapping) or part not in found:
                if not needed:
                    return None
                raise InputError(field=key, problem="missing", remedy="give a whole calibration document")
            found = found[part]
        return found

    def items(self, key: str) -> list[Any]:
        found = self.value(key)
        if not isinstance(found, list | tuple):
            raise InputError(field=key, problem="not a list", remedy="give a list")
        return list(found)

    def number(self, key: str, *, needed: bool = True) -> float:
        """Return a number; null is NaN."""
        found = self.value(key, needed=needed)
        if found is None:
            return math.nan
        if isinstance(found, bool) or not isinstance(found, int | float):
            raise InputError(field=key, problem=f"{found!r} is no number", remedy="give a number")
        return float(found)

    def numbers_of(self, key: str, kind: type[Metrics | Site]) -> dict[str, Any]:
        """Return the numbers that a dataclass holds, by name; those with a default only where there is one."""
        optional = {f.name: f.default is not MISSING for f in fields(kind)}
        found = {name: self.number(f"{key}.{name}", needed=not may_miss) for name, may_miss in optional.items()}
        return {name: number for name, number in found.items() if math.isfinite(number) or not optional[name]}

    def count(self, key: str) -> int:
        """Return a whole number; 0 where there is none."""
        found = self.number(key, needed=False)
        return int(found) if math.isfinite(found) else 0

    def numbers(self, key: str, count: int) -> tuple[float, ...]:
        return tuple(float(v) for v in self.array(key, (count,)))

    def array(self, key: str, shape: tuple[int, ...]) -> FloatArray:
        try:
            found = np.array(self.items(key), dtype=np.float64)
        except (TypeError, ValueError) as fault:
            raise InputError(field=key, problem="not an array of numbers", remedy=f"give shape {shape}") from fault
        if found.size == 0 and 0 in shape:
            return np.zeros(shape)
        if found.shape != shape:
            raise InputError(field=key, problem=f"shape {found.shape}", remedy=f"give shape {shape}")
        if not np.all(np.isfinite(found)):
            raise InputError(field=key, problem="a number is not finite", remedy="give finite numbers")
        return found
