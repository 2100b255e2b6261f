"""The calibration document: the form in which a calibration is served, stored and printed, complete for projection."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, fields, replace
from datetime import datetime
from itertools import pairwise
from typing import Any

import numpy as np

from sunarc.calibration.answers.ageing import age_step_days, aged
from sunarc.calibration.model import result
from sunarc.calibration.model.pose_change import PoseChange, SteadyTurn, pose_before, turn_between
from sunarc.calibration.model.residual_field import Field
from sunarc.common.array_types import FloatArray
from sunarc.common.errors import InputError
from sunarc.common.findings import Finding, from_json
from sunarc.common.utc import rfc3339
from sunarc.optics.backward import BackwardModel
from sunarc.optics.camera import PARAMETER_NAMES, Camera
from sunarc.optics.displacement import HIGHEST_ORDER, Displacement, WaveBasis
from sunarc.optics.pose import pose_angles
from sunarc.sky.site import Site

# Values of a calibration document by dotted keys.


class DocumentReader:
    """Reads values by dotted keys, and names the key where one is wrong."""

    def __init__(self, document: object) -> None:
        self._document = document

    def value(self, key: str, *, needed: bool = True) -> Any:  # noqa: ANN401 - JSON holds anything
        """Return the value at a key; None where it is missing and not needed."""
        found: Any = self._document
        for part in key.split("."):
            if not isinstance(found, Mapping) or part not in found:
                if not needed:
                    return None
                raise InputError(field=key, problem="missing", remedy="give a whole calibration document")
            found = found[part]
        return found

    def items(self, key: str) -> list[Any]:
        """Return a list."""
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
            raise InputError(field=key, problem=f"{found!r} is not a number", remedy="give a number")
        try:
            return float(found)
        except OverflowError:
            raise InputError(field=key, problem="is out of range", remedy="give a number below 1e308") from None

    def read_numbers(self, key: str, kind: type[result.Metrics | Site]) -> dict[str, Any]:
        """Return the numbers that a dataclass holds, by name; those with a default only where there is one."""
        optional = {f.name: f.default is not MISSING for f in fields(kind)}
        found = {name: self.number(f"{key}.{name}", needed=not may_miss) for name, may_miss in optional.items()}
        return {name: number for name, number in found.items() if math.isfinite(number) or not optional[name]}

    def count(self, key: str) -> int:
        """Return a whole number; 0 where it is missing."""
        found = self.number(key, needed=False)
        return int(found) if math.isfinite(found) else 0

    def numbers(self, key: str, count: int) -> tuple[float, ...]:
        """Return a number of numbers."""
        return tuple(float(v) for v in self.array(key, (count,)))

    def array(self, key: str, shape: tuple[int, ...]) -> FloatArray:
        """Return finite numbers in a shape.

        Raises
        ------
        InputError
            Naming the key.
        """
        try:
            found = np.array(self.items(key), dtype=np.float64)
        except (TypeError, ValueError, OverflowError) as fault:
            raise InputError(field=key, problem="not an array of numbers", remedy=f"give shape {shape}") from fault
        if found.size == 0 and 0 in shape:
            return np.zeros(shape)
        if found.shape != shape:
            raise InputError(field=key, problem=f"shape {found.shape}", remedy=f"give shape {shape}")
        if not np.all(np.isfinite(found)):
            raise InputError(field=key, problem="a number is not finite", remedy="give finite numbers")
        return found


SCHEMA = "sunarc.calibration/2"
_EARLIER = "sunarc.calibration/1"
"""Without the field's mean: the prediction is the lens alone."""
READ_SCHEMAS = (SCHEMA, _EARLIER)
CAMERA_SCHEMA = "sunarc.camera/1"
"""Schema of the part of a calibration document that projects (`camera_document`)."""
_CAMERA_KEYS = (
    *("id", "camera", "state", "created_at", "valid_from", "valid_until", "pose_epoch"),
    *("site", "image", "model", "backward_model", "pose"),
)
_SKY_KEYS = ("sky_rms_deg", "sky_rms_without_clock_deg", "sky_max_deg", "sigma_limit_deg", "aged_days")
_DISPLACEMENT_KEYS = ("center_px", "half_px", "orders", "mean")
_ROUNDED_SHARES = 1e-3

Document = dict[str, Any]


def to_document(
    calibration: result.Calibration,
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
    """Return the document of a calibration (docs/formats.md): plain values, ready for JSON.

    Parameters
    ----------
    calibration : the calibration.
    id, camera, pose_epoch : names.
    state : candidate, current, retired or refused.
    created_at, valid_from, valid_until : aware times; None for an open end.
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
        "uncertainty": uncertainty_document(calibration),
        "night": None if calibration.night is None else _plain(asdict(calibration.night)),
        "metrics": {f.name: _number(getattr(calibration.metrics, f.name)) for f in fields(result.Metrics)},
        "evidence": _evidence(calibration),
        "verdict": {
            "accepted": calibration.verdict.accepted,
            "marginal": calibration.verdict.marginal,
            "reasons": list(calibration.verdict.reasons),
            "findings": [finding.as_json() for finding in calibration.verdict.findings],
        },
        "software": {"name": "sunarc", "version": software_version},
    }


def document_at(document: Document, time: datetime) -> Document:
    """Return a calibration document with the uncertainty that it has at a time, see `answers.ageing`."""
    model = from_document(document)
    now = aged(model, age_step_days(model, time.timestamp()))
    return document if now is model else {**document, "uncertainty": uncertainty_document(now)}


def camera_document(document: Mapping[str, Any]) -> Document:
    """Return the part of a calibration document that projects: its camera, its displacement and the sky's sigma.

    The keys are those of the whole document; covariance, mixture, evidence and verdict are absent.
    """
    uncertainty = document["uncertainty"]
    displacement = {key: uncertainty["field"][key] for key in _DISPLACEMENT_KEYS if key in uncertainty["field"]}
    sky = {key: uncertainty[key] for key in _SKY_KEYS if key in uncertainty}
    camera = {key: document[key] for key in _CAMERA_KEYS}
    return {"schema": CAMERA_SCHEMA, **camera, "uncertainty": {"field": displacement, **sky}}


def _evidence(calibration: result.Calibration) -> Document:
    """Return the provenance; of a camera that stands no turn is written."""
    evidence, turning = calibration.evidence, calibration.evidence.turning
    plain = {f.name: _plain(getattr(evidence, f.name)) for f in fields(evidence) if f.name != "turning"}
    return plain | {"moves": _moves(calibration)} | ({} if turning is None else {"turning": _plain(asdict(turning))})


def _moves(calibration: result.Calibration) -> list[Document]:
    """Return the moves, with the pose that each of them ended."""
    moves, pose = list[Document](), calibration.camera.rotation_cam_enu
    for move in reversed(calibration.evidence.moves):
        pose = pose_before(pose, move.rotation_deg)
        before, after = move.bracket
        moves.append(
            {"before_unix_s": before, "after_unix_s": after, "turn_deg": move.turn_deg, "pose_before": list(pose)}
        )
    return moves[::-1]


def uncertainty_document(calibration: result.Calibration) -> Document:
    """Return the part of a document that states the uncertainty."""
    return {
        "parameters": list(calibration.parameter_names),
        "covariance": calibration.covariance.tolist(),
        "field": field_document(calibration.field, calibration.camera.displacement),
        "mixture": None if calibration.mixture is None else _mixture_document(calibration.mixture),
        "sky_rms_deg": _number(calibration.sky_rms_deg),
        "sky_rms_without_clock_deg": _number(_without_clock_deg(calibration)),
        "sky_max_deg": _number(calibration.sky_max_deg),
        **({} if calibration.sigma_limit_deg is None else {"sigma_limit_deg": calibration.sigma_limit_deg}),
        **({"aged_days": calibration.aged_days} if calibration.aged_days else {}),
    }


def _without_clock_deg(calibration: result.Calibration) -> float:
    """Return the 1-sigma over the sky without the clock's error that is stated for all sightings, degrees."""
    without_deg = calibration.sky_rms_without_clock_deg
    return calibration.sky_rms_deg if without_deg is None else without_deg


def _mixture_document(mixture: result.ErrorMixture) -> Document:
    return {
        "shares": mixture.shares.tolist(),
        "pixels_px": np.round(mixture.pixels_px, 1).tolist(),
        "scales": _rounded(mixture.scales, digits=4),
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


def field_document(field: Field, displacement: Displacement | None = None) -> Document:
    """Return the field; that of amplitude 0 has the waves of the displacement, as a simulated camera's may."""
    if field.amplitude_px == 0.0:
        basis = replace(field.basis, orders=np.zeros((0, 2), dtype=np.int64))
        basis = basis if displacement is None else WaveBasis.of(displacement)
        cross = np.zeros((2, field.cross.shape[1], len(basis.orders)))
        field = Field(amplitude_px=0.0, length_px=field.length_px, basis=basis, cross=cross)
    return {
        "amplitude_px": field.amplitude_px,
        "length_px": field.length_px,
        "center_px": list(field.basis.center_px),
        "half_px": list(field.basis.half_px),
        "orders": field.basis.orders.tolist(),
        "mean": _rounded(field.basis.fit_coefficients(displacement), digits=10),
        "cross": _rounded(field.cross, digits=8),
        "known": _rounded(field.known, digits=8),
        "coupling": _rounded(field.coupling, digits=8),
    }


def _rounded(values: FloatArray, *, digits: int) -> list[Any]:
    """Return nested lists of numbers of some significant digits: a document is read by people, and sent often."""
    if values.ndim > 1:
        return [_rounded(part, digits=digits) for part in values]
    return [float(f"{value:.{digits}g}") for value in values]


def _time(time: datetime | None) -> str | None:
    return None if time is None else rfc3339(time)


def _number(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _plain(value: object) -> object:
    if isinstance(value, float):
        return _number(value)
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, tuple | list) else value


def from_document(document: object) -> result.Calibration:
    """Return the calibration that a document holds.

    Raises
    ------
    InputError
        Names the key that is missing or not what it should be.
    """
    read = DocumentReader(document)
    if read.value("schema") not in READ_SCHEMAS:
        remedy = f"give a {SCHEMA} document, or use the version of sunarc that wrote this one"
        raise InputError(
            field="schema", problem=f"{read.value('schema')!r}, which this version does not read", remedy=remedy
        )
    earlier = read.value("schema") == _EARLIER
    camera = _read_camera(read)
    names = tuple(str(n) for n in read.items("uncertainty.parameters"))
    unknown = [name for name in names if name not in PARAMETER_NAMES]
    if unknown:
        remedy = "use the version of sunarc that wrote this document"
        raise InputError(field="uncertainty.parameters", problem=f"{unknown[0]!r} is unknown", remedy=remedy)
    method = read.value("method")
    if method not in ("robust", "paper"):
        raise InputError(field="method", problem=f"{method!r} is unknown", remedy="use robust or paper")
    field = _read_field(read, len(names), earlier=earlier)
    if not earlier:
        camera = replace(camera, displacement=_read_mean(read, field.basis))
    return result.Calibration(
        camera=camera,
        poses=(camera.rotation_cam_enu,),
        parameter_names=names,
        covariance=read.array("uncertainty.covariance", (len(names), len(names))),
        field=field,
        sky_rms_deg=read.number("uncertainty.sky_rms_deg"),
        sky_max_deg=read.number("uncertainty.sky_max_deg"),
        metrics=_read_metrics(read),
        pose=pose_angles(camera.rotation_cam_enu),
        backward=BackwardModel(
            radial=read.numbers("backward_model.radial", 8),
            decentering=read.numbers("backward_model.decentering", 5),
            max_error_px=read.number("backward_model.max_error_px"),
        ),
        evidence=_read_evidence(read, camera),
        verdict=result.Verdict(
            accepted=bool(read.value("verdict.accepted")),
            findings=_read_findings(read),
            marginal=bool(read.value("verdict.marginal", needed=False)),
        ),
        method=method,
        site=Site(**read.read_numbers("site", Site)),
        mixture=_read_mixture(read),
        night=_read_night(read),
        sigma_limit_deg=_read_limit(read),
        sky_rms_without_clock_deg=_read_without_clock(read),
        aged_days=read.count("uncertainty.aged_days"),
    )


def _read_limit(read: DocumentReader) -> float | None:
    """Return the 1-sigma up to which a provisional calibration answers; None where it has no limit."""
    found = read.number("uncertainty.sigma_limit_deg", needed=False)
    return found if math.isfinite(found) else None


def _read_without_clock(read: DocumentReader) -> float | None:
    """Return the 1-sigma over the sky without the clock's error; None in documents of version 0.3 and before."""
    found = read.number("uncertainty.sky_rms_without_clock_deg", needed=False)
    return found if math.isfinite(found) else None


def _read_findings(read: DocumentReader) -> tuple[Finding, ...]:
    """Return the findings; documents of version 0.2 have sentences alone."""
    coded = read.value("verdict.findings", needed=False) is not None
    return tuple(from_json(one) for one in read.items("verdict.findings" if coded else "verdict.reasons"))


def _read_camera(read: DocumentReader) -> Camera:
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
        raise InputError(field=key, problem=f"{value} is not a size", remedy="give px")
    return int(value)


def _read_field(read: DocumentReader, size: int, *, earlier: bool) -> Field:
    key = "uncertainty.field"
    orders = read.array(f"{key}.orders", (len(read.items(f"{key}.orders")), 2)).astype(np.int64)
    if np.any((orders < 1) | (orders > HIGHEST_ORDER)):
        remedy = f"give numbers of half waves, 1 to {HIGHEST_ORDER}"
        raise InputError(field=f"{key}.orders", problem="a number is out of bounds", remedy=remedy)
    center, half = read.numbers(f"{key}.center_px", 2), read.numbers(f"{key}.half_px", 2)
    unseen = Field(
        amplitude_px=read.number(f"{key}.amplitude_px"),
        length_px=read.number(f"{key}.length_px"),
        basis=WaveBasis(center_px=(center[0], center[1]), half_px=(half[0], half[1]), orders=orders),
        cross=read.array(f"{key}.cross", (2, size, orders.shape[0])),
    )
    if earlier:
        # the waves that had next to no cross term did not travel
        basis = unseen.basis.completed(length_px=unseen.length_px) if unseen.amplitude_px > 0.0 else unseen.basis
        return replace(unseen, basis=basis, cross=unseen.basis.spread(unseen.cross, basis))
    rows = [len(one) if isinstance(one, list) else 0 for one in read.items(f"{key}.coupling")]
    return replace(
        unseen,
        known=read.array(f"{key}.known", (len(read.items(f"{key}.known")), orders.shape[0])),
        coupling=read.array(f"{key}.coupling", (2, max(rows, default=0), orders.shape[0])),
    )


def _read_mixture(read: DocumentReader) -> result.ErrorMixture | None:
    """Return how the errors are spread; None where they are as a Gaussian's, as in documents before version 0.4."""
    key = "uncertainty.mixture"
    if read.value(key, needed=False) is None:
        return None
    shares = read.array(f"{key}.shares", (len(read.items(f"{key}.shares")),))
    pixels = read.array(f"{key}.pixels_px", (len(read.items(f"{key}.pixels_px")), 2))
    scales = read.array(f"{key}.scales", (pixels.shape[0], shares.size))
    for name, right in (
        ("shares", shares.size and np.all(shares > 0.0) and abs(shares.sum() - 1.0) < _ROUNDED_SHARES),
        ("pixels_px", pixels.shape[0] > 0),
        ("scales", np.all(scales > 0.0)),
    ):
        if not right:
            remedy = "give shares that sum to 1, and at least one place with a positive scale for each"
            raise InputError(field=f"{key}.{name}", problem="a number is out of bounds", remedy=remedy)
    return result.ErrorMixture(shares=shares, pixels_px=pixels, scales=scales)


def _read_mean(read: DocumentReader, basis: WaveBasis) -> Displacement | None:
    """Return the displacement of the image; None where the mean is 0."""
    mean = read.array("uncertainty.field.mean", (2, basis.orders.shape[0]))
    return basis.displacement(mean) if np.any(mean) else None


def _read_metrics(read: DocumentReader) -> result.Metrics:
    numbers = read.read_numbers("metrics", result.Metrics)
    return result.Metrics(**numbers | {"n": read.count("metrics.n")})


def _read_evidence(read: DocumentReader, camera: Camera) -> result.Provenance:
    options = read.value("evidence.options")
    clock_s, beyond_s = (read.number(f"evidence.{name}", needed=False) for name in ("clock_error_s", "clock_beyond_s"))
    stated = read.value("evidence.clock_stated", needed=False)
    return result.Provenance(
        days=tuple(str(d) for d in read.items("evidence.days")),
        n_supplied=read.count("evidence.n_supplied"),
        n_used=read.count("evidence.n_used"),
        n_rejected=read.count("evidence.n_rejected"),
        options=options if isinstance(options, dict) else {},
        sigma_px=read.number("evidence.sigma_px", needed=False),
        inflation=read.number("evidence.inflation", needed=False),
        radial_px=read.number("evidence.radial_px", needed=False),
        clock_error_s=clock_s,
        clock_stated=clock_s > 0.0 if stated is None else bool(stated),
        clock_beyond_s=beyond_s if 0.0 <= beyond_s < math.inf else 0.0,
        circle=read.value("evidence.circle", needed=False),
        start=read.value("evidence.start", needed=False),
        selection=read.value("evidence.selection", needed=False) or {},
        pose_spread_deg=_read_spread(read),
        turning=_read_turning(read),
        moves=_read_moves(read, camera),
        log_odds=read.value("evidence.log_odds", needed=False) or {},
        held_out=read.value("evidence.held_out", needed=False) or {},
    )


def _read_night(read: DocumentReader) -> result.NightDifference | None:
    if read.value("night", needed=False) is None:
        return None
    turn, sigma = (read.numbers(f"night.{name}", 3) for name in ("pose_difference_deg", "pose_sigma_deg"))
    return result.NightDifference(
        n=read.count("night.n"),
        pose_difference_deg=(turn[0], turn[1], turn[2]),
        pose_sigma_deg=(sigma[0], sigma[1], sigma[2]),
        star_offset_px=read.number("night.star_offset_px"),
        star_offset_sigma_px=read.number("night.star_offset_sigma_px"),
    )


def _read_moves(read: DocumentReader, camera: Camera) -> tuple[PoseChange, ...]:
    """Return the moves, each to the pose that the next one ended, and the last one to the camera's."""
    stored = [DocumentReader(each) for each in read.value("evidence.moves", needed=False) or ()]
    poses = [*(tuple(move.numbers("pose_before", 3)) for move in stored), camera.rotation_cam_enu]
    brackets = [(move.number("before_unix_s"), move.number("after_unix_s")) for move in stored]
    return tuple(
        PoseChange(time=bracket[1], bracket=bracket, rotation_deg=turn_between(*between), cause="moved")
        for bracket, between in zip(brackets, pairwise(poses), strict=True)
    )


def _read_turning(read: DocumentReader) -> SteadyTurn | None:
    if read.value("evidence.turning", needed=False) is None:
        return None
    rate, sigma = (read.numbers(f"evidence.turning.{name}", 3) for name in ("deg_per_day", "sigma_deg_per_day"))
    return SteadyTurn(
        at_unix_s=read.number("evidence.turning.at_unix_s"),
        deg_per_day=(rate[0], rate[1], rate[2]),
        sigma_deg_per_day=(sigma[0], sigma[1], sigma[2]),
    )


def _read_spread(read: DocumentReader) -> tuple[float, float, float] | None:
    if read.value("evidence.pose_spread_deg", needed=False) is None:
        return None
    east, north, up = read.numbers("evidence.pose_spread_deg", 3)
    return east, north, up
