"""The camera that most of a folder's sightings agree on, and where it predicts the sun in each image."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from sunarc.archive.archive import Archive
from sunarc.archive.sightings import FileSighting
from sunarc.calibration.answers.covariance import project_with_covariance
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.model.options import ImageCircle
from sunarc.calibration.model.result import Calibration
from sunarc.calibration.model.sightings import Sightings
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.detection.values import Detection, Expectation
from sunarc.findings import Finding
from sunarc.optics.forward import local_stretch, project
from sunarc.reanalysis.index import ImageFile
from sunarc.settings.model import Settings
from sunarc.sky.site import Site
from sunarc.sky.sun import sun_angles, sun_directions
from sunarc.utc import DAY_S

_MOST_SIGHTINGS = 240
"""The sun's track in so many sightings fixes a camera to a fraction of a pixel; more only take longer."""
_LEAST_UNCERTAINTY_PX = 1.0
"""1-sigma of a prediction, at least."""
_CONSISTENT_SIGMAS = 3.5
"""Of sighting and prediction together: two in a thousand right ones are farther away (Rayleigh's distribution), and so
are round gaps in cloud that were taken for the sun (docs/studies.md, "A day of clouds")."""
_LOOSE: dict[str, Any] = {
    "method": "robust", "mirrored": "auto", "level_within_deg": 90.0, "max_rmse_px": 30.0, "max_sky_deg": 10.0,
    "max_rejected": 0.75, "max_unexplained": 1.0, "max_below_horizon": 1.0,
}  # fmt: skip
"""A prediction need not be a calibration: what the second pass finds decides about that."""
_STRETCH_S = 10.0 * DAY_S
_FEW = 5
_MOST_AGREE = 0.6
"""Share of a stretch's accepted sightings that agree with a camera where it stands for the stretch: fewer where the
camera was moved, hardly fewer by false ones."""


Found = tuple[ImageFile, FileSighting]


class WithPosition(Protocol):
    """What a prediction is compared with."""

    @property
    def accepted(self) -> bool:
        """Whether fits may use the position."""

    @property
    def x_px(self) -> float | None:
        """Of the sun's centre."""

    @property
    def y_px(self) -> float | None:
        """Of the sun's centre."""

    @property
    def sigma_px(self) -> float | None:
        """1-sigma per axis."""


class Agreed(NamedTuple):
    """Images of a stretch of time, and the camera that their sightings agree on; None with the findings why not."""

    found: Sequence[Found]
    calibration: Calibration | None
    findings: tuple[Finding, ...] = ()


def agreed_cameras(archive: Archive, settings: Settings, found: Iterable[Found]) -> list[Agreed]:
    """Return the camera of each stretch of ten days: the camera may have been moved in a long series.

    A camera that most accepted sightings of a stretch agree with is taken over from the stretch before, or from the
    archive; otherwise it is fitted to them. A stretch with too few of them gets that of its neighbour.
    """
    stretches = itertools.groupby(sorted(found, key=lambda one: one[0].key), lambda one: one[0].unix_s // _STRETCH_S)
    agreed, latest = list[Agreed](), archive.calibrations.current_model(settings.name)
    for _, members in stretches:
        agreed.append(_agreed(archive, settings, list(members), latest))
        latest = agreed[-1].calibration or latest
    following: Calibration | None = None
    for number, one in reversed(list(enumerate(agreed))):
        if one.calibration is None and following is not None:
            agreed[number] = Agreed(one.found, following)
        following = agreed[number].calibration or following
    return agreed


def _agreed(archive: Archive, settings: Settings, found: Sequence[Found], known: Calibration | None) -> Agreed:
    accepted = [one for one in found if one[1].accepted]
    if known is not None and _share_consistent(known, accepted, settings.site) >= _MOST_AGREE:
        return Agreed(found, known)
    fitted = _fitted(archive, settings, accepted)
    if isinstance(fitted, Calibration):
        return Agreed(found, fitted)
    return Agreed(found, known if len(accepted) < _FEW else None, fitted)


def _share_consistent(calibration: Calibration, found: Sequence[Found], site: Site) -> float:
    expected = expectations(calibration, [image for image, _ in found], site=site)
    agreeing = [is_consistent(sighting, one) for (_, sighting), one in zip(found, expected, strict=True)]
    return sum(agreeing) / len(agreeing) if len(agreeing) >= _FEW else 0.0


def _fitted(archive: Archive, settings: Settings, found: Sequence[Found]) -> Calibration | tuple[Finding, ...]:
    record = archive.cameras.get(settings.name)
    if record is None or not found:
        return (Finding("no_accepted_sightings"),)
    some = [found[n] for n in np.unique(np.linspace(0, len(found) - 1, _MOST_SIGHTINGS).astype(int))]
    points = Sightings.of(
        unix_s=np.array([image.unix_s for image, _ in some]),
        pixels=np.array([[one.x_px, one.y_px] for _, one in some], dtype=np.float64),
        sigma_px=np.array([np.nan if one.sigma_px is None else one.sigma_px for _, one in some]),
    )
    circle = settings.refit.image_circle_px
    solved = calibrate(
        points,
        site=settings.site,
        image_size=record.image_size,
        options=replace(settings.calibration, **_LOOSE),
        circle=None if circle is None else ImageCircle(x=circle[0], y=circle[1], radius=circle[2]),
        parts=False,
    )
    return solved if solved.verdict.accepted else solved.verdict.findings


def misfit_px(calibration: Calibration, found: Iterable[Found], *, site: Site) -> float:
    """Return by how much accepted sightings scatter about a camera beyond what they state, px per axis.

    That of the fit where they are too few to tell.
    """
    accepted = [(image, one) for image, one in found if one.accepted and one.sigma_px is not None]
    if len(accepted) < _FEW:
        return float(np.nan_to_num(calibration.evidence.sigma_px))
    directions = sun_directions(np.array([image.unix_s for image, _ in accepted]), site)
    pixels = np.array([[one.x_px, one.y_px] for _, one in accepted], dtype=np.float64)
    sigma_px = np.array([one.sigma_px for _, one in accepted], dtype=np.float64)
    ratio = np.linalg.norm(pixels - project(calibration.camera, directions), axis=-1) / sigma_px
    factor = robust_sigma(ratio[np.isfinite(ratio)], floor=1.0)
    return math.sqrt(factor**2 - 1.0) * float(np.median(sigma_px))


def expectations(
    calibration: Calibration, images: Sequence[ImageFile], *, site: Site, misfit: float | None = None
) -> list[Expectation | None]:
    """Return where the sun should be in each image; None outside the camera's field or image.

    Parameters
    ----------
    calibration : the camera.
    images : at whose times.
    site : of the camera.
    misfit : px by which the camera is wrong beyond its covariance, per axis; None for the scatter of the sightings that
        it was fitted to.
    """
    if not images:
        return []
    unix_s = np.array([image.unix_s for image in images])
    directions = sun_directions(unix_s, site)
    pixels, covariance = project_with_covariance(calibration, directions)
    stretch = local_stretch(calibration.camera, directions)
    zenith = np.radians(np.asarray(sun_angles(unix_s, site).apparent_zenith))
    scatter = np.nan_to_num(calibration.evidence.sigma_px) if misfit is None else misfit
    sigma = np.hypot(np.sqrt(np.trace(covariance, axis1=-2, axis2=-1) / 2.0), scatter)
    camera = calibration.camera
    inside = np.all((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5), axis=-1)
    return [
        Expectation(
            x_px=float(pixels[n, 0]),
            y_px=float(pixels[n, 1]),
            uncertainty_px=max(float(sigma[n]), _LEAST_UNCERTAINTY_PX),
            stretch_px_per_rad=_two_by_two(stretch[n].tolist()),
            apparent_zenith=float(zenith[n]),
        )
        if inside[n] and np.isfinite(sigma[n])
        else None
        for n in range(len(images))
    ]


def is_consistent(sighting: WithPosition, expected: Expectation | None) -> bool:
    """Return whether an accepted sighting lies where the sun should be: it need not be looked for again."""
    if not sighting.accepted or expected is None or sighting.x_px is None or sighting.y_px is None:
        return False
    sigma = math.hypot(expected.uncertainty_px, sighting.sigma_px or 0.0)
    distance = math.hypot(sighting.x_px - expected.x_px, sighting.y_px - expected.y_px)
    return distance <= _CONSISTENT_SIGMAS * sigma


def as_predicted(found: Detection, expected: Expectation | None) -> Detection:
    """Return a detection in an ordinary image, refused where it is farther from the prediction than both state."""
    if not found.accepted or found.method != "paper" or expected is None or is_consistent(found, expected):
        return found
    distance = math.hypot((found.x_px or 0.0) - expected.x_px, (found.y_px or 0.0) - expected.y_px)
    displaced = (Finding("blob_displaced", {"distance_px": distance}),)
    return replace(found, accepted=False, verdict="reflection", findings=displaced)


def _two_by_two(rows: list[list[float]]) -> tuple[tuple[float, float], tuple[float, float]]:
    return (rows[0][0], rows[0][1]), (rows[1][0], rows[1][1])
