"""Many data sets of one geometry: detections at the same moments by cameras like one that is known.

Monte Carlo, for one: the same arc again and again, other noise. What the sets share is made once (directions, bins,
scales to try, the lens's prior), the search for a start is left out, since all begin at the known camera, and so is the
uncertainty: what is returned is the camera that `calibrate` returns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sunarc.array_types import FloatArray
from sunarc.calibration.fit.assemble import tidied
from sunarc.calibration.fit.hyperparameter_grid import HyperparameterGrid
from sunarc.calibration.fit.marginal_likelihood import prior_precision
from sunarc.calibration.fit.noise_by_sort import Course
from sunarc.calibration.fit.robust_fit import grid_of
from sunarc.calibration.fit.robust_rounds import robust_camera
from sunarc.calibration.initial_guess.candidates import camera_from_circle
from sunarc.calibration.initial_guess.coarse_search import field_angle
from sunarc.calibration.initial_guess.multistart import SMALLEST_SIGMA_PX, distance_sigmas
from sunarc.calibration.least_squares.priors import LensPrior, Whitened, lens_prior
from sunarc.calibration.least_squares.problem import Observations, Problem, observations, problem_for
from sunarc.calibration.least_squares.solve import information, most_probable
from sunarc.calibration.model.options import CalibrationOptions, ImageCircle
from sunarc.calibration.model.sightings import FilteredSightings, SunPoints, filter_sightings
from sunarc.calibration.paper.stages import fit_as_paper
from sunarc.calibration.robust_loss import robust_sigma
from sunarc.errors import InputError
from sunarc.optics.camera import Camera
from sunarc.sky.site import Site

_SETTLING = 3
_STEPS = 10


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Batch:
    """What fits of one geometry share.

    Attributes
    ----------
    camera : where all fits begin: the true camera of a simulation, or the first fit.
    options : of the fits.
    usable, observed : the sightings that count in every set; their detections are those of the first set.
    n_supplied : how many detections a set has.
    course, grid : of the robust rounds.
    prior : of the lens, about the first image circle.
    circle : that circle, or None: then no set has one.
    """

    camera: Camera
    options: CalibrationOptions
    usable: FilteredSightings
    observed: Observations
    n_supplied: int
    course: Course
    grid: HyperparameterGrid
    prior: LensPrior
    circle: ImageCircle | None

    @classmethod
    def near(
        cls,
        camera: Camera,
        points: SunPoints,
        *,
        site: Site,
        options: CalibrationOptions | None = None,
        circle: ImageCircle | None = None,
    ) -> Batch:
        """Return what the fits of sightings like these share.

        Parameters
        ----------
        camera : near the cameras that are sought: within some px over the sky.
        points : one set, of one pose.
        site : where the camera stands.
        options : how to fit; projection and mirroring are the camera's.
        circle : the image circle of the first set, where the sets have one.

        Raises
        ------
        InputError
            Where the points are of several poses.
        """
        effective = CalibrationOptions() if options is None else options
        effective = replace(effective, projection=camera.projection, mirrored="yes" if camera.mirrored else "no")
        usable = filter_sightings(points, site=site)
        if int(usable.epoch.max(initial=0)) > 0:
            raise InputError(field="epoch", problem="several poses", remedy="fit the sightings of one pose at a time")
        observed = observations(usable)
        prior = lens_prior(
            camera,
            tolerances=effective.tolerances,
            circle=circle,
            field_angle=field_angle(camera, observed, effective),
        )
        return cls(
            camera=camera.lens_alone(),
            options=effective,
            usable=usable,
            observed=observed,
            n_supplied=len(points),
            course=Course.of(usable),
            grid=grid_of(camera, effective),
            prior=prior,
            circle=circle,
        )

    def fitted(self, pixels: FloatArray, *, circle: ImageCircle | None = None) -> Camera:
        """Return the camera that a set of detections gives.

        Parameters
        ----------
        pixels : (n_supplied, 2) px, in the order of the points; finite.
        circle : the set's own image circle, in place of the first one.

        Raises
        ------
        InputError
            Where the detections are not those of the geometry, or a circle comes without a first one.
        """
        if np.shape(pixels) != (self.n_supplied, 2) or not np.all(np.isfinite(pixels)):
            raise InputError(
                field="pixels", problem=f"shape {np.shape(pixels)}", remedy=f"give {self.n_supplied} finite x, y"
            )
        if circle is not None and self.circle is None:
            raise InputError(field="image circle", problem="only of this set", remedy="give the first set one, too")
        observed = replace(self.observed, pixels=np.asarray(pixels, dtype=np.float64)[self.usable.index])
        if self.options.method == "paper":
            usable = replace(self.usable, pixels=observed.pixels)
            found = fit_as_paper(observed, usable, [self.camera], options=self.options, quickly=True).cameras[0]
        else:
            found = self._robust(observed, self._problem(circle))
        return tidied(found, self.options)

    def _problem(self, circle: ImageCircle | None) -> Problem:
        prior = self.prior
        if circle is not None:
            size = self.camera.width, self.camera.height
            first = camera_from_circle(circle, image_size=size, options=self.options)
            mean = prior.mean.copy()
            mean[: Whitened.RADIAL] = *first.focal_length_px, 0.0, *first.principal_point_px
            prior = replace(prior, mean=mean)
        return problem_for(self.camera, prior, n_epochs=1, max_angle=np.radians(self.options.max_angle_deg))

    def _robust(self, observed: Observations, problem: Problem) -> Camera:
        plain = self._without_field(observed, problem)
        found = robust_camera(problem, observed, plain, course=self.course, grid=self.grid, in_its_valley=True)
        camera = found.problem.camera(found.unknowns)
        if found.state.field_odds <= 0.0:
            return camera
        mean = found.field_mean(found.system(observed, self.course.bins).normal())
        return camera if mean is None else replace(camera, displacement=found.grid.basis.displacement(mean))

    def _without_field(self, observed: Observations, problem: Problem) -> FloatArray:
        """Return the unknowns of the robust fit from the known camera: the weights by turns with the bins' solution."""
        tolerances, bins = self.options.tolerances, self.course.bins
        precision = prior_precision(problem.size, tolerances.radial_px, tolerances.decentering_px)
        at = problem.unknowns([self.camera])
        for _ in range(_SETTLING):
            residual = problem.residuals(at, observed)
            sigma = robust_sigma(distance_sigmas(problem, observed, at), floor=SMALLEST_SIGMA_PX)
            gathered, mean = bins.gathered(observed, residual, information(residual, observed, sigma))
            means = replace(gathered, pixels=gathered.pixels + mean - problem.residuals(at, gathered))
            at = most_probable(problem, means, at, precision=precision, iterations=_STEPS, tolerance=1e-4).unknowns
        return at
