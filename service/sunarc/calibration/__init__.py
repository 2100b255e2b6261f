"""Fit of a camera to sightings of the sun: the camera, its uncertainty and a verdict.

`calibrate` the entry · `batch` many fits of one geometry · `model` values · `selection` of sightings ·
`initial_guess`, `least_squares`, `fit` the robust fit · `paper` the reference method · `quality` verdicts · `pose` a
known lens in a new pose · `change_detection` comparison of every sighting with the calibration · `ensemble` joint
draws of the errors · `pose_change_points`, `pose_step_search`, `pose_step_evidence` pose changes within a record ·
`projection_choice` the projection of an unknown lens · `lens_library` types of lens, joint fits, first poses ·
`star_prediction` pixels of the stars · `blind_start` a camera by the stars ·
`reproduce` a stored fit again. The maths: docs/maths.md.
"""

from sunarc.calibration.batch import Batch
from sunarc.calibration.blind_start import BlindOptions, BlindStart, NightImage, blind_start
from sunarc.calibration.calibrate import calibrate
from sunarc.calibration.ensemble import MOST_DRAWS, Ensemble, draw_ensemble
from sunarc.calibration.initial_guess.image_circle import find_image_circle
from sunarc.calibration.least_squares.priors import prior_knowledge
from sunarc.calibration.lens_library import (
    LENS_SCHEMA,
    Entry,
    FirstPoseOptions,
    Joint,
    LensType,
    Unit,
    UnitSpread,
    calibrate_jointly,
    calibrate_with_lens,
    first_pose,
    lens_type_from_json,
    lens_type_of,
    north_sigma_deg,
    top_azimuth_deg,
)
from sunarc.calibration.model.backward import BackwardModel, back_project, camera_sees, fit_backward
from sunarc.calibration.model.covariance import (
    hemisphere,
    project_with_covariance,
    sigma_deg,
    sigma_px,
    sun_with_covariance,
    unproject_with_sigma,
)
from sunarc.calibration.model.direction_table import BACK_PROJECTED, PROJECTED, Lookup, lookup
from sunarc.calibration.model.document import READ_SCHEMAS, SCHEMA, from_document, to_document
from sunarc.calibration.model.kinds import Kind, kinds_of
from sunarc.calibration.model.maps import BackProjectionMap, back_projection_map
from sunarc.calibration.model.metrics import Metrics, measures
from sunarc.calibration.model.options import (
    CalibrationOptions,
    ImageCircle,
    LensTolerances,
    Method,
    Mirrored,
    PaperOptions,
)
from sunarc.calibration.model.residual_field import Field, WaveBasis
from sunarc.calibration.model.result import Calibration, Move, Provenance, Verdict
from sunarc.calibration.model.sightings import MAX_CLOCK_ERROR_S, SunPoints, apparent_directions
from sunarc.calibration.pose import PoseOffset, PriorTolerances, calibrate_with_prior, daily_pose_offset, estimate_pose
from sunarc.calibration.pose.sun_motion import site_contradiction
from sunarc.calibration.pose_change_points import Moved, calibrate_moved
from sunarc.calibration.pose_step_search import PoseStep, find_pose_steps
from sunarc.calibration.projection_choice import calibrate_unknown_lens, choose_projection
from sunarc.calibration.quality.acceptance import accept, disagreement, distance_px, unseen_points
from sunarc.calibration.quality.day_quality import (
    DOUBTFUL_CLOCK_SHARE,
    DayMeasure,
    DayVerdict,
    days_left_out,
    decide_day,
    measure_day,
    smooth_arc,
)
from sunarc.calibration.quality.pose_drift import pose_spread_deg, with_pose_spread
from sunarc.calibration.quality.tilt import tilt_question
from sunarc.calibration.reproduce import reproduce_calibration
from sunarc.calibration.selection.selection import Candidates, Selection, SelectionOptions, select_sightings
from sunarc.calibration.selection.star_selection import (
    MOST_STARS,
    image_parts,
    sky_parts,
    surest_of_epochs,
    surest_of_parts,
)
from sunarc.calibration.star_prediction import predict_stars
from sunarc.calibration.star_views import MatchedView, StarView, match_views

__all__ = [
    "BACK_PROJECTED",
    "DOUBTFUL_CLOCK_SHARE",
    "LENS_SCHEMA",
    "MAX_CLOCK_ERROR_S",
    "MOST_DRAWS",
    "MOST_STARS",
    "PROJECTED",
    "READ_SCHEMAS",
    "SCHEMA",
    "BackProjectionMap",
    "BackwardModel",
    "Batch",
    "BlindOptions",
    "BlindStart",
    "Calibration",
    "CalibrationOptions",
    "Candidates",
    "DayMeasure",
    "DayVerdict",
    "Ensemble",
    "Entry",
    "Field",
    "FirstPoseOptions",
    "ImageCircle",
    "Joint",
    "Kind",
    "LensTolerances",
    "LensType",
    "Lookup",
    "MatchedView",
    "Method",
    "Metrics",
    "Mirrored",
    "Move",
    "Moved",
    "NightImage",
    "PaperOptions",
    "PoseOffset",
    "PoseStep",
    "PriorTolerances",
    "Provenance",
    "Selection",
    "SelectionOptions",
    "StarView",
    "SunPoints",
    "Unit",
    "UnitSpread",
    "Verdict",
    "WaveBasis",
    "accept",
    "apparent_directions",
    "back_project",
    "back_projection_map",
    "blind_start",
    "calibrate",
    "calibrate_jointly",
    "calibrate_moved",
    "calibrate_unknown_lens",
    "calibrate_with_lens",
    "calibrate_with_prior",
    "camera_sees",
    "choose_projection",
    "daily_pose_offset",
    "days_left_out",
    "decide_day",
    "disagreement",
    "distance_px",
    "draw_ensemble",
    "estimate_pose",
    "find_image_circle",
    "find_pose_steps",
    "first_pose",
    "fit_backward",
    "from_document",
    "hemisphere",
    "image_parts",
    "kinds_of",
    "lens_type_from_json",
    "lens_type_of",
    "lookup",
    "match_views",
    "measure_day",
    "measures",
    "north_sigma_deg",
    "pose_spread_deg",
    "predict_stars",
    "prior_knowledge",
    "project_with_covariance",
    "reproduce_calibration",
    "select_sightings",
    "sigma_deg",
    "sigma_px",
    "site_contradiction",
    "sky_parts",
    "smooth_arc",
    "sun_with_covariance",
    "surest_of_epochs",
    "surest_of_parts",
    "tilt_question",
    "to_document",
    "top_azimuth_deg",
    "unproject_with_sigma",
    "unseen_points",
    "with_pose_spread",
]
