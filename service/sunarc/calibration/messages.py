"""The messages of fits and of their acceptance."""

from __future__ import annotations

from sunarc.common.findings import Message, Messages

_ACTIVE_STAYS = "The fit is refused, or kept as a candidate where the verdict is marginal; the active one stays."
_REFUSED = "The fit is refused."
_ASKED = "A tilt of more than 5° that is not stated refuses a first fit, see `tilt_in_doubt`; a stated one is used."
_TILTED = "the sightings fit a camera tilted by {tilt_deg:.1f}°; "
_ODDS = ", which is {odds:.2g} times as probable as such a tilt"
_OR_TILTED = "; where the camera is tilted, give --level-within {level_within_deg:.0f}"
_MORE_DAYS = "collect sightings on further clear days"

MESSAGES = Messages(
    uncoded=Message("{text}", "A sentence stored by version 0.2 or before, which had no codes."),
    # what makes a fit pointless
    too_few_sightings=Message(
        "{n} usable sightings; at least {least} are needed",
        _REFUSED,
        "collect more sightings of the sun; see the verdicts of those rejected",
    ),
    static_sightings=Message(
        "{n} of {n_all} sightings do not move with the sun ({places}): a text overlay, a reflection or a hot pixel",
        _REFUSED,
        "mask these positions, or leave these sightings out",
    ),
    sightings_below_horizon=Message(
        "the sun was below the horizon at {n} of {n_all} sightings ({share:.0%}, at most {limit:.0%}): the site (a "
        "sign, or latitude and longitude exchanged) or the clock (its zone) is wrong",
        _REFUSED,
        "check --latitude (north is positive), --longitude (east is positive) and the times (UTC, or --utc-offset)",
    ),
    arc_too_short=Message(
        "the sun moved {arc_deg:.1f}°; at least {least_deg:.0f}° are needed", _REFUSED, "collect sightings for longer"
    ),
    spread_too_small=Message(
        "the detections extend over {spread_px:.1f} px of the image (at least {least_px:.0f} px are needed): what is "
        "detected does not move with the sun",
        _REFUSED,
        "look at the detected positions in the images; mask what stands still",
    ),
    no_camera_fits=Message(
        "no camera of this projection fits the sightings",
        _REFUSED,
        "check the times, the site and the projection",
    ),
    not_evaluated=Message("the fit is not evaluated yet", "Never in a stored document."),
    # what a fit says of itself
    fit_rmse=Message("{n:sighting} on {days:day} fit with an RMSE of {rmse_px:~2} px", "Summary of the fit."),
    direction_sigma=Message(
        "direction uncertainty {sigma_deg:~2}° (1-sigma per axis, RMS over the sky)", "Summary of the fit."
    ),
    dropped_not_finite=Message("{n} sightings without a finite time or pixel were left out", "Input of the fit."),
    dropped_outside_image=Message(
        "{n} sightings outside the image were left out", "Input of the fit.", "correct the rows, or the image size"
    ),
    dropped_below_horizon=Message(
        "{n} sightings with the sun below the horizon were left out",
        "Input of the fit.",
        "check the clock and the site if there are many",
    ),
    dropped_duplicate_time=Message(
        "{n} sightings with the time of another sighting were left out", "Input of the fit."
    ),
    dropped_static=Message("{n} sightings that do not move with the sun were left out", "Input of the fit."),
    night_contradicts_day=Message(
        "{n} sightings of the night contradict those of the day: {cause} {value:.2f}, limit {limit:.2f}",
        "The fit is of the day's sightings alone. pose_difference and star_offset: of the night, in 1-sigma of their "
        "priors (0.02° an axis; 0.15 px a coefficient); rejected: share of the night's sightings; sun_scatter: of the "
        "sun's track over that of its own fit; sky: change over the sky in 1-sigma of the day's fit.",
        "check the mount and the clock of the night",
    ),
    day_contradicts_night=Message(
        "{n} sightings of the day contradict those of the night: the night's camera is within {night_sigmas:.1f} sigma "
        "of the day's fit, the day's {day_sigmas:.0f} sigma from the night's",
        "The fit is of the night's sightings alone: those of the sun are too few, or biased by what they state.",
        "collect sightings of the sun on a whole clear day",
    ),
    sigma_of_parts=Message(
        "fits without a part of the sightings are off by {factor:.2g} times what they state; the larger one is stated",
        "The fit is used, its covariance widened.",
        _MORE_DAYS,
    ),
    parts_disagree=Message(
        "the camera of a half or a third of the sightings lies {sigmas:.1f} stated sigmas from that of all of them (at "
        "most {limit:g})",
        _REFUSED,
        _MORE_DAYS,
    ),
    sigma_of_thinned_set=Message(
        "every second sighting alone gives {factor:.2g} times the uncertainty that its number explains; the larger one "
        "is stated",
        "The fit is used, its covariance widened. Of calibrations before version 0.4.",
        _MORE_DAYS,
    ),
    static_positions=Message(
        "a text overlay, a reflection or a hot pixel at {places}",
        "The fit is used, without these sightings.",
        "mask these positions",
    ),
    provisional=Message(
        "provisional: the lens is taken from an earlier pose, or from its type, within its uncertainty",
        "The pose was estimated from few sightings.",
        "none: a full fit replaces it after the day",
    ),
    provisional_where_sure=Message(
        "provisional, as was asked: directions are answered where their 1-sigma is at most {limit_deg:.2g}° per axis, "
        "{share:.0%} of the sky in the image",
        "The sightings contradict nothing, and determine no more: the fit is kept as a candidate, with this limit.",
        "`sunarc calibrations activate ID` serves it until a fit is accepted; collect sightings on further clear days",
    ),
    provisional_tilted=Message(
        "not kept as provisional: a camera tilted by {tilt_deg:.1f}°, which may stand for a wrong time or place",
        "The fit is refused.",
        "check clock and site; where the camera is tilted, give --level-within",
    ),
    tilt_in_doubt=Message(
        "the camera is tilted by {tilt_deg:.1f}° (1-sigma {pose_deg:~2}°), which is not stated: by the sun alone a "
        "tilted camera and a wrong place or clock are the same",
        _REFUSED,
        "check clock and site; where the camera is tilted, give --level-within {level_within_deg:.0f} "
        "(calibration.level_within_deg)",
    ),
    mirrored=Message("the image is mirrored", "Both were tried, and one fits."),
    not_mirrored=Message("the image is not mirrored", "Both were tried, and one fits."),
    pose_changed=Message(
        "the camera was moved between {before} and {after}, by {turn_deg:.3f}°; the pose is the one after it",
        "A pose change within the sightings of the fit.",
    ),
    projection_chosen=Message(
        "the sightings determine the projection {projection}: it is 10^{log10_odds:.1f} times as probable as {next}",
        "No projection was named; those that could be fitted were compared.",
    ),
    simulated_camera=Message("the camera of a simulation", "The document states a simulated camera's true parameters."),
    # why a fit refuses itself
    mirroring_ambiguous=Message(
        "the mirrored and the unmirrored camera fit the sightings equally well",
        _REFUSED,
        "if writing in the picture is readable give --mirrored no, if it is mirror writing --mirrored yes "
        "(settings: calibration.mirrored)",
    ),
    projection_ambiguous=Message(
        "the sightings do not determine the lens's projection: from {n} (at least {least} are needed) {projection} is "
        "10^{log10_odds:.1f} times as probable as {next} (at least 10^{least_log10_odds:.1f} are needed); the "
        "difference to the possible ones, {off_deg:~2}° over the sky, is in the stated uncertainty",
        "The most probable one is fitted; the fit is refused only where its uncertainty is too large.",
        "name the projection with --projection, or collect sightings of a whole clear day",
    ),
    other_handedness_fits=Message(
        "the sightings fit far better with --mirrored {mirrored} (--mirrored {stated} is set or assumed): the sign of "
        "the latitude or the image's mirroring is not as stated, or x and y are swapped",
        _REFUSED,
        "give --latitude {latitude:.6g} where its sign is wrong;\n"
        "or --mirrored {mirrored} (settings: calibration.mirrored) where writing in the picture says so; or swap x_px "
        "and y_px",
    ),
    latitude_of_other_sign_fits=Message(
        "a camera that is not mirrored fits the sightings about as well at latitude {latitude:.6g}",
        "The fit of a mirrored image is refused, unless its mirroring is stated.",
        "give --latitude {latitude:.6g} where its sign is wrong;\n"
        "or --mirrored yes (settings: calibration.mirrored) where writing in the picture is mirror writing",
    ),
    rmse_too_large=Message(
        "the RMSE of the sightings is {rmse_px:.2f} px (at most {limit_px:g} px allowed)",
        _REFUSED,
        "check the clock, the site and the projection",
    ),
    too_many_rejected=Message(
        "{share:.0%} of the sightings do not fit (at most {limit:.0%})", _REFUSED, "check what the detector finds"
    ),
    epoch_does_not_explain_its_days=Message(
        "{share:.0%} of {n} sightings of clear days do not fit (at most {limit:.0%}); {n_far} of {n_half_days} "
        "half-days deviate by more than {far:g} sigma, most of all on {day}, by {off_px:.1f} px ({sigmas:.1f} sigma)",
        _REFUSED,
        "look for a change of lens, focus, mount or image size within these days, and fit the sightings before and "
        "after it separately; where rows of two cameras are mixed, give one camera's",
    ),
    direction_sigma_too_large=Message(
        "direction uncertainty {sigma_deg:~2}° (at most {limit_deg:g}°), of {n:sighting} on {days:day} that scatter by "
        "{scatter_px:~2} px",
        "The fit is refused. 1.5° is three times the sun's diameter (2° with a known lens): with more, clouds cannot "
        "be located. `sunarc reanalyse` searches a camera's changes with fits of up to 30°, and serves none of them.",
        "collect sightings on further clear days; where they scatter by pixels, check times, site and mirroring",
    ),
    direction_sigma_unknown=Message(
        "the direction uncertainty cannot be computed from {n:sighting} on {days:day}",
        _REFUSED,
        _MORE_DAYS,
    ),
    camera_turned=Message(
        "the sightings of one part are those of a camera turned by {turn_deg:.3f}° against the others; chi-square is "
        "{chi_square:.0f} (at most {limit:.0f})",
        "The fit is refused. Parts are thirds of a day, or whole days in five groups at most.",
        "check the mount; fit the sightings before and after a move as two epochs",
    ),
    held_out_contradicts=Message(
        "held-out check: the worst predicted part, {n} sightings, is missed by {rmse_px:.2f} px RMS where "
        "{stated_px:.2f} px are stated; the test statistic over all parts is {excess:.2f} (at most {limit:.2f})",
        "The fit is refused. Thirds of a day, or whole days, were predicted by fits of the other sightings. The "
        "statistic is the largest of three: the largest independent error over 5 sigma, the root of chi-square over "
        "its 1e-4 quantile, and that of the turn of one part over 25.",
        "collect sightings of whole clear days; check the clock, the mount and the projection",
    ),
    hours_missing=Message(
        "on {date} the sightings cover {covered_h:.1f} of {up_h:.1f} hours of sun; none at {missing} UTC",
        "In addition to the reason for which the fit is refused; of the day with most sightings.",
        "collect sightings in these hours, or on further clear days",
    ),
    sightings_determine=Message(
        "the sightings determine directions along their arc to {arc_deg:~2}° (1-sigma per axis), and the camera's pose "
        "to {pose_deg:~2}° (1-sigma about the least certain axis)",
        "In addition to the reason for which the fit is refused; with the projection that was fitted.",
    ),
    declinations_alike=Message(
        "on {days:day} of sightings the sun's declination is {least_deg:.1f} to {most_deg:.1f}° (a range of "
        "{limit_deg:g}° is wanted): the sun runs over one band of the sky",
        "In addition to the reason for which the fit is refused.",
        "collect sightings on days a month or more apart; at the solstices, further apart",
    ),
    image_size_doubtful=Message(
        "the principal point is {off_px:.0f} px, {share:.0%} of the image's shorter side, from the image's centre",
        "The fit is used.",
        "check the image size, and that the image is neither cropped nor scaled",
    ),
    tilt_too_large=Message(
        "camera tilt {tilt_deg:.1f}° (at most {limit_deg:g}°, --level-within): if the camera is level, the times "
        "(clock, time zone), the sign of longitude or latitude, or the handedness is wrong; residuals cannot "
        "distinguish these",
        _REFUSED,
        "check clock, site and mirroring, or raise --level-within",
    ),
    pixels_not_square=Message(
        "the pixels are {aspect:.4f} times as wide as high (log odds {log_odds:.0f})",
        "The fit is used.",
        "check that no program scales the images; where it must, by the same factor in width and height",
    ),
    clock_drifts=Message(
        "the clock is not within its bound, or drifts on a day (log odds {log_odds:.0f})",
        "The fit is used, with what the clock may be off in its uncertainty.",
        "synchronise the camera's clock (NTP, PTP), and state its bound",
    ),
    site_assumed=Message(
        "the camera is tilted by {tilt_deg:.1f}° if it stands at latitude {latitude:g}, longitude {longitude:g}; a "
        "site that is wrong by 1° turns every direction by 1°, which no sighting shows",
        "The fit is used. Said of a camera's first fit.",
        "check the site",
    ),
    clock_unbounded=Message(
        "the clock is assumed right to {clock_error_s:g} s: each minute of a constant error turns the camera about the "
        "pole by {turn_deg_per_minute:.2f}°, which no sighting shows; state another bound by --clock-error",
        "The fit is used; its uncertainty holds no larger error of the clock.",
        "state the bound of the clock (--clock-error S, folder.clock_error_s)",
    ),
    mount_drifts=Message(
        "the camera turns all the time, by {turn_deg:.2f}° in {days:.1f} days (log odds {log_odds:.0f})",
        "The epoch is refused: no camera holds for all of its days.",
        "fix the mount; calibrate a few days alone",
    ),
    clock_drifts_on=Message(
        "the clock gains {s_per_day:.1f} s a day, or the camera turns about the celestial pole, by {turn_deg:.2f}° in "
        "{days:.1f} days (log odds {log_odds:.0f}): the sun does not tell which",
        "The epoch is refused: no camera holds for all of its days.",
        "synchronise the camera's clock (NTP, PTP), or fix the mount",
    ),
    mount_sways=Message(
        "the mount stands otherwise from day to day, by {east_deg:.3f}° about east, {north_deg:.3f}° about north and "
        "{up_deg:.3f}° about the vertical (log odds {log_odds:.0f})",
        "The fit is used, with what the mount may stand otherwise in its uncertainty.",
        "fix the mount, or wait until it has settled; calibrate the days since alone",
    ),
    detections_biased=Message(
        "the sun is detected inwards or outwards of its place (log odds {log_odds:.0f})",
        "The fit is used, with the bias taken out.",
        "check the exposure of the sun's frames and the focus",
    ),
    camera_tilted=Message(
        _TILTED + "at latitude {latitude:.1f}, longitude {longitude:.1f} it is level",
        _ASKED,
        "check --latitude (north is positive) and --longitude (east is positive)" + _OR_TILTED,
    ),
    camera_tilted_by_exchange=Message(
        _TILTED + "with latitude and longitude exchanged it is level to {level_deg:.1f}°" + _ODDS,
        _ASKED,
        "give --latitude {latitude:g} --longitude {longitude:g}" + _OR_TILTED,
    ),
    camera_tilted_by_clock=Message(
        _TILTED + "with clocks ahead by {minutes:.0f} ± {minutes_sigma:.0f} minutes ({hours:+.1f} h), or a longitude "
        "that is off by {longitude_off_deg:.1f} ± {longitude_sigma_deg:.1f}° (no camera can distinguish these), it is "
        "level to {level_deg:.1f}°" + _ODDS,
        _ASKED,
        "check the clock and its zone (--utc-offset), and --longitude (east is positive)" + _OR_TILTED,
    ),
    camera_tilted_by_longitude=Message(
        _TILTED
        + "with a longitude that is off by {longitude_off_deg:.1f} ± {longitude_sigma_deg:.1f}°, or clocks ahead "
        "by {minutes:.0f} ± {minutes_sigma:.0f} minutes ({hours:+.1f} h; no camera can distinguish these), it is level "
        "to {level_deg:.1f}°" + _ODDS,
        _ASKED,
        "give --longitude {longitude:.2f} (east is positive), or check the clock and its zone (--utc-offset)"
        + _OR_TILTED,
    ),
    camera_tilted_by_latitude=Message(
        _TILTED + "at a latitude of {latitude:.1f} it is level to {level_deg:.1f}°" + _ODDS,
        _ASKED,
        "check the latitude (north is positive): --latitude {latitude:.2f}" + _OR_TILTED,
    ),
    camera_tilted_shown=Message(
        "the camera is tilted by {tilt_deg:.1f}°: refraction and horizon make that 10^{log10_odds:.1f} times as "
        "probable as a level camera at another place",
        "The fit is used.",
    ),
    camera_sees_sun_below_horizon=Message(
        "{n} of {n_all} sightings are where the camera sees the sun, and it was below the horizon: the site or the "
        "clock is wrong",
        _REFUSED,
        "check --latitude (north is positive), --longitude (east is positive) and the times (UTC, or --utc-offset)",
    ),
    principal_point_outside=Message(
        "the principal point ({x_px:.0f}, {y_px:.0f}) px is outside the image", _REFUSED, _MORE_DAYS
    ),
    sightings_of_one_radius=Message(
        "all sightings are {lowest_deg:.1f} to {highest_deg:.1f}° from the optical axis (a range of at least "
        "{least_deg:.0f}° is needed): they show the lens at one radius alone",
        "The fit is refused. Any projection fits a ring: of the sun at a pole, or of a camera that is pointed at one.",
        "collect sightings of further months, or of the night; or state the lens (--start, --lens-prior)",
    ),
    radius_not_rising=Message(
        "the radius stops rising at {angle_deg:.0f}° from the axis (at least {least_deg:.0f}° are needed)",
        _REFUSED,
        "check the projection",
    ),
    prior_contradicted=Message(
        "the sightings contradict the stated camera: {departure:.1f} times its tolerances (at most {limit:g})",
        _REFUSED,
        "check --start, clock, site and mirroring; widen --lens-within or --pose-within, or fit without a prior",
    ),
    # a fit with a type of lens, and a first pose
    lens_prior_used=Message("with the lens prior of {n} cameras ({cameras})", "The lens prior file was used."),
    lens_prior_left_out=Message(
        "the lens prior of {n} cameras ({cameras}) was left out: with it the sightings fit worse",
        "The fit is the one without the lens prior.",
        "check that the lens is of this type",
    ),
    lens_prior_contradicted=Message(
        "the sightings contradict the lens prior: {part} differs by {departure:.1f} sigma (at most {limit:.1f})",
        _REFUSED,
        "check the type of lens, clock, site and mirroring; or fit without --lens-prior",
    ),
    first_pose=Message(
        "first pose, from {n} sightings: 1-sigma of north {north_sigma_deg:.1f}°; the top of the image looks "
        "towards azimuth {top_azimuth_deg:.0f}°",
        "The pose is provisional: lens and level are assumed within their spread.",
        "compare the top of the image with a map; a full fit replaces the pose after a clear day",
    ),
    first_pose_mirrored=Message(
        "the sun moves as in a mirrored image, 10^{log10_odds:.1f} times as probable",
        "No first pose is served.",
        "set the camera's image back (reverse X, reverse Y), or set calibration.mirrored; check the sign of the site",
    ),
    north_ambiguous=Message(
        "two azimuths fit the sightings, the one 10^{log10_odds:.1f} times as probable as the other",
        "No first pose is served.",
        "none: further sightings decide",
    ),
    north_not_as_mounted=Message(
        "the top of the image looks towards azimuth {top_azimuth_deg:.0f} ± {north_sigma_deg:.1f}°, {off_deg:.0f}° "
        "from the azimuth {expected_deg:.0f}° that it was mounted with",
        "No first pose is served.",
        "check how the camera is mounted, the clock, and first_pose.top_azimuth_deg",
    ),
    # a fit beside the active one
    first_calibration=Message("first calibration of this camera", "It becomes the active one."),
    direction_sigma_compared=Message(
        "the RMS 1-sigma of directions is {now_deg:~3}° ({before_deg:~3}° for the calibration in use)",
        "The fit becomes the active one.",
    ),
    replaces_damaged=Message(
        "it replaces a damaged calibration",
        "The stored document of the active one could not be read.",
        "check the disk",
    ),
    cross_validation_rmse=Message(
        "cross-validation RMSE {rmse_px:~2} px (expected {expected_px:~2} px)", _ACTIVE_STAYS, _MORE_DAYS
    ),
    handedness_differs=Message(
        "image handedness differs from the active calibration",
        _ACTIVE_STAYS,
        "set the camera's image back (reverse X, reverse Y), or activate the candidate if the setting was changed",
    ),
    no_change=Message(
        "no significant change: camera and uncertainty are those of the active calibration to {limit:.1%}",
        _ACTIVE_STAYS,
    ),
    direction_sigma_increased=Message(
        "direction uncertainty increased: {now_deg:~3}° (was {before_deg:~3}°)", _ACTIVE_STAYS, _MORE_DAYS
    ),
    contradicts_active=Message(
        "{share:.0%} of the sky contradicts the active calibration, by up to {distance_px:.2f} px: the camera may have "
        "moved",
        _ACTIVE_STAYS,
        "check the mount; if the camera moved, wait for its new pose",
    ),
    change_not_confirmed=Message(
        "differs from the active calibration by {change_px:.3f} px over the sky ({stated_px:.3f} px are stated); later "
        "sightings do not confirm it",
        _ACTIVE_STAYS,
        "none: later sightings confirm it, or not",
    ),
    moved_since=Message(
        "the camera was moved at {time}, and there is no usable sighting since",
        _ACTIVE_STAYS,
        "wait for sightings of the new pose",
    ),
    active_unreadable=Message(
        "the active calibration {calibration} cannot be read by this version: {error}",
        _ACTIVE_STAYS,
        "install the version that wrote it, or activate another one",
    ),
    pose_or_clock=Message(
        "stars do not tell a clock that is wrong from a camera that is turned about the pole: within {clock_error_s:g} "
        "s by {turn_deg:~2}° (north {north_deg:~2}°, tilt {tilt_deg:~2}°), which the stated uncertainty holds",
        "The lens does not depend on it; directions are as right as the times.",
        "state the bound of the clock (--clock-error); sightings of the sun by a clock that is right give the pose",
    ),
    # days
    day_too_few_sightings=Message(
        "{n} sightings on a smooth arc (at least {least} are needed)", "The day is unusable."
    ),
    day_arc_too_short=Message("{arc_deg:.0f}° of arc observed (at least {least_deg:g}°)", "The day is unusable."),
    day_clock_uncertain=Message(
        "the clock error exceeds the limit in {share:.0%} of the sightings (at most {limit:.0%})",
        "The day is unusable.",
        "start a time service; see the conditions of the clock",
    ),
    day_share_on_arc=Message(
        "{share:.0%} of the {n_observed} observed slots lie on the arc", "Decides between clear, partly and cloudy."
    ),
    day_slots_missed=Message(
        "{n_missed} of {n_possible} possible slots were not observed",
        "The day is evaluated by the others.",
        "free processor time, or set a longer capture.cadence_s",
    ),
    day_scatter=Message(
        "the sightings scatter about the arc by {sd_px:.2f} px (on a clear day by at most {limit_px:g} px)",
        "Decides between clear and partly.",
    ),
    day_share_uncertain=Message(
        "{n_observed} observed slots show at least {share:.0%} with 95 % confidence (clear: {limit:.0%})",
        "Too few slots were observed for a clear day.",
    ),
)

text_of = MESSAGES.text_of
