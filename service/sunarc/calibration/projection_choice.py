"""Choice of the projection of a lens for which none is stated, by the evidence of the sightings.

Cameras are compared by their log evidence (`compared_fits`): first about the start with each projection; the two most
probable ones, and what comes near them, are fitted, and compared again.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from sunarc.calibration.answers.covariance import replace_covariance, seen_sky, sky_sigma_deg
from sunarc.calibration.compared_fits import ComparedLens, closest, compare_log_evidences, log_evidences
from sunarc.calibration.fit.assemble import Job
from sunarc.calibration.fit.robust_fit import fit_robustly, make_hyperparameter_grid
from sunarc.calibration.handedness import Fitted
from sunarc.calibration.model.options import CalibrationOptions
from sunarc.calibration.model.result import STRONG_EVIDENCE, Calibration, Verdict
from sunarc.calibration.noise import NoiseGroups, measured_noise
from sunarc.calibration.plausible_start import Start, most_plausible_start
from sunarc.calibration.quality.fit_checks import JudgedFit
from sunarc.calibration.start.initial_guess import single_problem
from sunarc.calibration.verdict import UNCERTAIN, before_fit, findings
from sunarc.common.array_types import FloatArray
from sunarc.common.findings import Finding
from sunarc.optics.camera import PARAMETER_NAMES, Camera
from sunarc.optics.forward import project, project_with_rows_fast
from sunarc.optics.inverse import unproject
from sunarc.optics.projections import PROJECTIONS, Projection
from sunarc.sky.directions import angular_distance

_IMPOSSIBLE = -1e4
"""Log evidence below which the odds are not given any more."""
_NEAR = 20.0
"""Log evidence at the start, against the best, within which a projection is fitted. Of 200 it rose by 44 at most by the
fit, and never changed which one is the best."""
_LEAST_PROBABILITY = 0.01
"""Probability above which the difference to another projection's camera enters the stated uncertainty."""
_RIDGE = 1e-6
"""Share of the largest singular value below which a direction of the parameters images nothing."""
_RIM = 0.1
"""Share of the seen sky that another lens may leave out without a difference: the rim beyond 90° of a tilted camera."""
_FEWEST = 60
"""Usable sightings that a choice needs: of 35, a third of them drawn aside by cloud, a wrong lens was made by far the
most probable one."""


class ProjectionChoice(NamedTuple):
    """The most probable projection, and the log evidence of each over its: 0 for itself, negative for the others.

    `n` is the number of sightings that were used.
    """

    projection: Projection
    log_evidence: dict[Projection, float]
    n: int

    @property
    def compared(self) -> bool:
        """True where two projections or more could be fitted."""
        return sum(math.isfinite(value) for value in self.log_evidence.values()) > 1

    @property
    def possible(self) -> tuple[Projection, ...]:
        """The other projections whose probability is above a hundredth; of few sightings all that come near it."""
        total = sum(math.exp(value) for value in self.log_evidence.values())
        least = math.log(_LEAST_PROBABILITY * total) if self.n >= _FEWEST else -_NEAR
        return tuple(name for name, value in self.log_evidence.items() if name != self.projection and value > least)

    def finding(self, off_deg: float) -> Finding:
        """Return how far the sightings decide: `projection_chosen` or `projection_ambiguous`, with the next best one.

        `off_deg` is the difference to the possible ones that the stated uncertainty holds.
        """
        others = {name: value for name, value in self.log_evidence.items() if name != self.projection}
        name = max(others, key=lambda one: others[one])
        decided = self.n >= _FEWEST and others[name] < -STRONG_EVIDENCE
        return Finding(
            "projection_chosen" if decided else "projection_ambiguous",
            {
                "projection": self.projection,
                "next": name,
                "log10_odds": -max(others[name], _IMPOSSIBLE) / math.log(10.0),
                "off_deg": off_deg,
                "n": self.n,
                "least": _FEWEST,
                "least_log10_odds": STRONG_EVIDENCE / math.log(10.0),
            },
        )


class ChosenLens(NamedTuple):
    """Job with a stated or chosen projection, and the fits compared for the choice (None where stated)."""

    job: Job
    choice: ProjectionChoice | None = None
    fits: Mapping[Projection, Fitted] = MappingProxyType({})

    @property
    def fitted(self) -> Fitted | None:
        """The fit with the projection; None before it is fitted."""
        return None if self.choice is None else self.fits.get(self.choice.projection)

    def allowed_for(self, calibration: Calibration) -> Calibration:
        """Return the calibration with the choice in its verdict, and possible projections in its uncertainty.

        The difference to the cameras with other projections that are probable above 1 % enters the covariance. The fit
        is refused where the sum is too large.
        """
        if self.choice is None or not self.choice.compared:
            return calibration
        cameras = [self.fits[name].fit.camera() for name in self.choice.possible if name in self.fits]
        widened, off_deg = _add_differences(calibration, cameras)
        verdict, finding = widened.verdict, self.choice.finding(off_deg)
        judged = JudgedFit(calibration=widened, usable=self.job.usable, options=self.job.options)
        against = findings(UNCERTAIN, judged) if verdict.accepted else ()
        if against:
            return replace(widened, verdict=Verdict(accepted=False, findings=(*against, finding)))
        found = (_replace_sigma(one, widened.sky_rms_deg) for one in verdict.findings)
        return replace(widened, verdict=replace(verdict, findings=(*found, finding)))


def chosen_lens(job: Job) -> ChosenLens:
    """Return a job with the projection that is stated, that of its start, or the most probable one."""
    if job.start is not None:
        return ChosenLens(job._replace(options=replace(job.options, projection=job.start.projection)))
    if job.options.projection != "auto":
        return ChosenLens(job)
    choice, fits = compare_projections(job)
    return ChosenLens(job._replace(options=replace(job.options, projection=choice.projection)), choice, fits)


def options_as_served(options: CalibrationOptions, served: Calibration | None) -> CalibrationOptions:
    """Return options that state the projection and the handedness of a calibration, where they state none themselves.

    One that is provisional states neither, and one whose sightings did not determine the projection states none.
    """
    if served is None or served.sigma_limit_deg is not None:
        return options
    undecided = any(one.code == "projection_ambiguous" for one in served.verdict.findings)
    if options.projection == "auto" and not undecided:
        options = replace(options, projection=served.camera.projection)
    if options.mirrored not in {"no", "yes"}:
        options = replace(options, mirrored="yes" if served.camera.mirrored else "no")
    return options


def _replace_sigma(finding: Finding, sigma_deg: float) -> Finding:
    """Return a finding, that of the stated uncertainty with another value."""
    return Finding(finding.code, {"sigma_deg": sigma_deg}) if finding.code == "direction_sigma" else finding


def _add_differences(calibration: Calibration, others: Sequence[Camera]) -> tuple[Calibration, float]:
    """Return a calibration whose covariance holds its mean square difference to other cameras, and that in degrees."""
    if not others:
        return calibration, 0.0
    camera = calibration.camera
    directions = seen_sky(camera)
    pixels, by_parameters = project_with_rows_fast(camera, directions)
    rows = by_parameters[..., [PARAMETER_NAMES.index(name) for name in calibration.parameter_names]]
    seen = np.all(np.isfinite(pixels), axis=-1) & np.all(np.isfinite(rows), axis=(1, 2))
    if not np.any(seen):
        return calibration, 0.0
    directions, pixels, rows = directions[seen], pixels[seen], rows[seen]
    scale = np.sqrt(np.maximum(np.diag(calibration.covariance), np.finfo(float).tiny))
    more, squares = np.zeros_like(calibration.covariance), []
    for other in others:
        there = _project_by_other_camera(other, directions, pixels)
        off = np.degrees(angular_distance(unproject(camera, there), directions))
        compared = np.isfinite(off)
        if not np.any(compared):
            continue
        design, apart = (rows[compared] * scale).reshape(-1, scale.size), (there - pixels)[compared].ravel()
        change = scale * np.linalg.lstsq(design, apart, rcond=_RIDGE)[0]
        more += np.outer(change, change)
        squares.append(float(np.mean(off[compared] ** 2)))
    n_compared = max(len(squares), 1)
    widened = replace_covariance(calibration, calibration.covariance + more / n_compared)
    rms, most = sky_sigma_deg(widened)
    return replace(widened, sky_rms_deg=rms, sky_max_deg=most), math.sqrt(sum(squares) / n_compared)


def _project_by_other_camera(other: Camera, directions: FloatArray, pixels: FloatArray) -> FloatArray:
    """Return (n, 2), px: where another camera images directions that are imaged at some pixels, within the image.

    NaN at the rim that it does not image; where it does not image more than that, it is half the image off.
    """
    size = np.array([other.width, other.height], dtype=np.float64)
    # another lens may image the horizon far outside of the image
    there = np.clip(project(other, directions), 0.0, size - 1.0)
    missing = ~np.all(np.isfinite(there), axis=-1)
    if np.mean(missing) > _RIM:
        outward = pixels[missing] - 0.5 * (size - 1.0)
        outward /= np.maximum(np.linalg.norm(outward, axis=-1, keepdims=True), 1.0)
        there[missing] = pixels[missing] - 0.5 * np.min(size) * outward
    return np.asarray(there)


def compare_projections(job: Job) -> tuple[ProjectionChoice, dict[Projection, Fitted]]:
    """Return the projection that the sightings make most probable, all five being as probable before them, and fits.

    The job's projection has no effect but where no fit is possible: it is then the answer. The fits are those with the
    most probable projections.
    """
    observed, groups = job.usable, NoiseGroups.of(job.usable)
    jobs = {name: job._replace(options=replace(job.options, projection=name)) for name in PROJECTIONS}
    tried = {} if before_fit(job.usable, job.options) else {n: most_plausible_start(jobs[n]) for n in jobs}
    starts: dict[Projection, Start] = {name: start for name, start in tried.items() if start is not None}
    if not starts:
        return _make_choice({job.options.assumed_projection: 0.0}, len(observed)), {}
    lenses: dict[Projection, ComparedLens] = {}
    for name, (cameras, _) in starts.items():
        options = jobs[name].options
        problem = single_problem(observed, cameras[0], options, job.circle, n_epochs=len(cameras))
        lenses[name] = ComparedLens(
            problem, observed, problem.unknowns(cameras), make_hyperparameter_grid(problem.template, options)
        )
    best = lenses[closest(lenses)]
    noise = measured_noise(best.problem.residuals(best.unknowns, observed), observed, groups)
    rough = log_evidences(lenses, groups.bins, noise.information)
    order = sorted(rough, key=lambda name: -rough[name])
    near = [name for k, name in enumerate(order) if k < 2 or rough[name] > -_NEAR]
    fits = {
        name: Fitted(starts[name], fit_robustly(observed, starts[name].cameras, jobs[name].options, job.circle))
        for name in near
    }
    exact = compare_log_evidences({name: one.fit for name, one in fits.items()})
    return _make_choice({**rough, **exact}, len(observed)), fits


def _make_choice(evidence: dict[Projection, float], n: int) -> ProjectionChoice:
    best = max(evidence, key=lambda name: evidence[name])
    return ProjectionChoice(best, {name: evidence.get(name, -math.inf) for name in PROJECTIONS}, n)
