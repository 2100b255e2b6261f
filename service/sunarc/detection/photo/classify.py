"""Which of the candidates is the sun's, and whether its position is worth using at its sigma."""

from __future__ import annotations

import math
from typing import NamedTuple

from sunarc.detection.photo.candidates import MIN_NEAR, OFF_GLARE, Candidate
from sunarc.detection.photo.part import MAX_SIGMA, REACH_PX, REACH_SIGMAS
from sunarc.detection.photo.rim import Rim
from sunarc.detection.values import Expectation, Verdict
from sunarc.findings import Finding

_MIN_SHARE = 0.5
"""Share of the rays on which the rim must follow the circle."""
_MAX_SCATTER = 0.16
"""Scatter of the rim over the radius; the sun's, thin cloud before it, had 0.15 and less on real images."""
_MAX_NEAR, _MAX_FAR = 0.915, 0.86
"""Light at 1.7 and 2.6 radii above which it does not stand out. Of 2,447 patches of real cloud half had more than 0.94
and 0.925; of the suns 19 of 20 had less than 0.91 and 0.86."""
_MIN_FAR = 0.5
"""Light at 2.6 radii below which it is a lamp or the moon at night: by day it had 0.6 and more on real images."""
_STEEPEST = 0.9
"""Fall of the light to 1.7 radii over that to 2.6, above which it is an edge and no glare: real suns had 0.23 to 0.89,
a white roof has 1."""
_AUREOLE, _AUREOLE_LIGHTER, _AUREOLE_FAR, _DAY = 1.15, 0.12, 0.33, 0.15
"""Light at 2.6 radii over the sky's median, part of the sky above it, that light and that median over the plateau. A
sun with an edge (short exposure) differs from a roof and from a lamp at night by its aureole: suns had 1.19, 0.33 and
0.12 and more, 0.09 and less (docs/studies.md, "A day of clouds"), lamps 0.30 and 0.13 and less. With none that part
was 0.07 and less about 40 suns, 0.15 and more about hills of cloud."""
_EDGED_LEAST = 0.01
"""Of the smaller side: what has an edge and a smaller radius is a gap in the cloud, not the middle of the glare."""
_MIN_FLAT, _MIN_FLAT_PREDICTED = 0.6, 0.2
"""Share of the plateau that is level: nine of ten real suns had 0.82 and more, nine of ten patches of cloud 0.54 and
less. A small sun in haze, which a prediction names, has 0.25."""
_MAX_SIGMA_RADIUS = 0.2
"""Of the radius: a less certain position is of no use either (0.01 of the smaller side is 1.9 degrees where that is
180)."""
_MAX_SIGMA_PX = 0.6  # a sigma up to this is always of use
_OFF_GLARE_RADIUS = 0.3  # of the radius: within it a plateau is in the middle of the glare
_MAX_RADIUS = 0.09
"""Of the smaller side, without a prediction: thin cloud before the sun gave 0.09 at most."""
_MAX_ELLIPTICITY = 0.35
"""1 - minor/major axis of a plateau without an edge, without a prediction: suns of five real series had 0.31 and less
(with an edge, in short exposures, 0.47), a contrail had 0.39."""
_OTHER_PLATEAUS, _OTHER_AREA = 2.0, 0.001
"""Plateau areas, and of the square of the smaller side, for what else is as light, without a prediction: real suns had
1.8 plateaus and less, text has up to 0.001; overcast is as light in many places."""


class Judged(NamedTuple):
    """A candidate with its verdict and what decided."""

    seen: Candidate
    verdict: Verdict
    finding: Finding


def best_of(seen: list[Candidate], expectation: Expectation | None) -> Judged:
    """Return the most sun-like candidate with its verdict.

    Those within a prediction's reach come first, what stands out from the sky before what does not.
    """
    judged = [Judged(each, *_verdict(each, expectation)) for each in seen]
    order = {"reflection": 2, "hidden": 1}
    return max(judged, key=lambda each: (-order.get(each.verdict, 0), each.seen.score))


def _verdict(seen: Candidate, expectation: Expectation | None) -> tuple[Verdict, Finding]:
    if expectation is None:
        return (
            _edge(seen, has_aureole=_has_aureole(seen))
            or _fault(seen)
            or _unlike_a_sun(seen, _MIN_FLAT, seen.off_glare_px)
            or _one_of_many(seen)
            or _clear(seen.rim)
        )
    distance = math.hypot(seen.rim.x - expectation.x_px, seen.rim.y - expectation.y_px)
    if distance > REACH_SIGMAS * math.hypot(expectation.uncertainty_px, seen.sigma_px) + REACH_PX:
        return "reflection", Finding("blob_displaced", {"distance_px": distance})
    return (
        _edge(seen, has_aureole=True)
        or _fault(seen)
        or _unlike_a_sun(seen, _MIN_FLAT_PREDICTED, seen.off_local_glare_px)
        or _clear(seen.rim)
    )


def _clear(rim: Rim) -> tuple[Verdict, Finding]:
    return "clear", Finding("blob_found", {"diameter_px": 2.0 * rim.radius, "share": rim.share})


def _edge(seen: Candidate, *, has_aureole: bool) -> tuple[Verdict, Finding] | None:
    """Return why a round region with an edge may be a white roof, a lamp at night, or a gap in the cloud."""
    rim = seen.rim
    if rim.near >= MIN_NEAR and rim.far >= _MIN_FAR and 1.0 - rim.near <= _STEEPEST * (1.0 - rim.far):
        return None
    if rim.edged and has_aureole and rim.radius >= _EDGED_LEAST * seen.size_px:
        return None
    return "hidden", Finding("blob_edged", {"near": rim.near, "far": rim.far})


def _has_aureole(seen: Candidate) -> bool:
    far = seen.rim.far
    is_lightest = far >= max(_AUREOLE * seen.sky, _AUREOLE_FAR) and seen.lighter <= _AUREOLE_LIGHTER
    return is_lightest and seen.rim.near >= far and seen.sky >= _DAY


def _fault(seen: Candidate) -> tuple[Verdict, Finding] | None:
    """Return why a round region is of no use, wherever it is."""
    rim = seen.rim
    if rim.near > _MAX_NEAR or rim.far > _MAX_FAR:
        return "hidden", Finding("blob_flat", {"near": rim.near, "far": rim.far})
    if rim.share < _MIN_SHARE:
        return "partly_covered", Finding("blob_one_sided", {"share": rim.share})
    if rim.scatter > _MAX_SCATTER * rim.radius:
        return "veiled", Finding("blob_uneven", {"scatter": rim.scatter / rim.radius})
    if seen.sigma_px > max(min(MAX_SIGMA * seen.size_px, _MAX_SIGMA_RADIUS * rim.radius), _MAX_SIGMA_PX):
        return "veiled", Finding("blob_centre_uncertain", {"sigma_px": seen.sigma_px})
    return None


def _unlike_a_sun(seen: Candidate, min_flat: float, off_px: float) -> tuple[Verdict, Finding] | None:
    """Return why a round region may be a patch of bright cloud."""
    if seen.rim.flat < min_flat:
        return "veiled", Finding("blob_not_clipped", {"flat": seen.rim.flat})
    if off_px > max(OFF_GLARE * seen.size_px, _OFF_GLARE_RADIUS * seen.rim.radius):
        return "veiled", Finding("blob_off_glare", {"distance_px": off_px})
    return None


def _one_of_many(seen: Candidate) -> tuple[Verdict, Finding] | None:
    """Return why a round region may be one of a cloud's: too wide, not alone, or not in the middle of an aureole."""
    radius = seen.rim.radius / seen.size_px
    if radius > _MAX_RADIUS:
        return "veiled", Finding("blob_wide", {"radius": radius})
    if not seen.rim.edged and seen.rim.ellipticity > _MAX_ELLIPTICITY:
        return "veiled", Finding("blob_elongated", {"ellipticity": seen.rim.ellipticity})
    if seen.other_area > max(_OTHER_PLATEAUS * math.pi * radius**2, _OTHER_AREA):
        return "veiled", Finding("blob_not_alone", {"area": seen.other_area})
    if seen.lighter > _AUREOLE_LIGHTER:
        return "veiled", Finding("blob_flat", {"near": seen.rim.near, "far": seen.rim.far})
    return None
