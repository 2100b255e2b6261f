"""The messages of the workers' conditions and events."""

from __future__ import annotations

from sunarc.calibration import messages as calibration
from sunarc.changes import messages as changes
from sunarc.common.findings import Finding, Message, Messages
from sunarc.detection import messages as detection
from sunarc.imager.runtime.status import Reason, Severity
from sunarc.imager.runtime.supervisor import worker_code

_BY_OTHERS = "Days are evaluated by the other slots."
_NO_NOTICE = "a restart ends this notice"

MESSAGES = Messages(
    # calibration
    no_calibration=Message(
        "no active calibration",
        "Directions cannot be given.",
        "wait for a clear day, or import sightings with `sunarc points import`",
    ),
    calibration_damaged=Message(
        "the stored document of calibration {calibration} does not match its checksum; {served} is served",
        "The newest undamaged calibration before it is served; a refit has been asked for.",
        "where it is refused, restore a copy with `sunarc db restore --latest`; check the disk",
    ),
    calibration_unreadable=Message(
        "the active calibration {calibration} was written by another version and cannot be used: {error}",
        "Directions cannot be given.",
        "install that version, or activate an older one with `sunarc calibrations activate ID`",
    ),
    evidence_changed=Message(
        "the sightings of calibration {calibration} were changed since it was made: {error}",
        "The calibration is served, but cannot be reproduced.",
        "restore a copy with `sunarc db restore`, or request a refit",
    ),
    tilt_unstated=Message(
        "the camera of calibration {calibration} is tilted by {tilt_deg:.1f}°, where calibration.level_within_deg is "
        "{stated}: a wrong site or clock looks the same",
        "It was accepted before, and is served on. A first fit of such a camera is refused.",
        "check site and clock; where the camera is tilted, write under [calibration]: "
        "level_within_deg = {level_within_deg:.0f}",
    ),
    provisional_pose=Message(
        "pose estimated from {n} sightings since the camera moved, 1-sigma {sigma_deg:.3f}°",
        "The stated uncertainty includes that of the pose.",
        "wait: every sighting improves it, and the fit after the day replaces it",
    ),
    provisional_calibration=Message(
        "provisional calibration from {n} sightings: directions are answered where their 1-sigma is at most "
        "{limit_deg:.2g}°",
        "Served since it was activated by hand. Elsewhere the answer is that of a direction beyond the camera's field.",
        "wait: the first fit that is accepted replaces it",
    ),
    first_sun=Message(
        "first sightings of the sun: {n} of {least} that a first pose needs, the last at x {x_px:.0f}, y {y_px:.0f}",
        "Directions cannot be given yet.",
        "check in the image that it is the sun, and which way it moves: north of the tropics counter-clockwise round "
        "the zenith, south of them clockwise; in a mirrored image the other way",
    ),
    first_pose_provisional=Message(
        "first pose, from {n} sightings: 1-sigma of north {north_sigma_deg:.1f}°, of directions {sigma_deg:.1f}°; the "
        "top of the image looks towards azimuth {top_azimuth_deg:.0f}°",
        "Served as provisional. The stated uncertainty includes that of the pose.",
        "compare the top of the image with a map; the sightings of the next minutes improve the pose, and the fit "
        "after a clear day replaces it",
    ),
    first_pose_refused=Message(
        "no first pose is served: {reason}",
        "Directions cannot be given yet; further sightings are tried.",
        "{remedy}",
    ),
    sun_seen_below_horizon=Message(
        "{n} sightings of the sun at times when, at the stated site, it is {zenith_deg:.0f}° from the zenith: below "
        "the horizon",
        "No calibration can come of these sightings.",
        "correct site.longitude (east is positive) or site.latitude (north is positive), or the clock and its zone",
    ),
    sun_contradicts_site=Message(
        "the sun in the image {seen}, {seen_zenith_deg:.0f}° from its centre; over the stated site it {expected}, "
        "{zenith_deg:.0f}° from the zenith: its path deviates by {off_deg:.0f}° (at most {limit_deg:.0f}°)",
        "A calibration of these sightings would be wrong, or is refused.",
        "check site.longitude (east is positive), site.latitude (north is positive), that they are not swapped, the "
        "clock, and calibration.mirrored; ignore this where the camera is tilted by more than 15°",
    ),
    daylight_at_night=Message(
        "daylight in the image ({level:.2f} of full scale in {exposure_us:.0f} µs) with the sun {below_deg:.0f}° below "
        "the horizon of the stated site",
        "The service takes the day for night, and makes no sightings.",
        "correct site.longitude (east is positive), or the clock and its zone; else look for a lamp at the camera",
    ),
    epoch_in_future=Message(
        "pose epoch {pose_epoch} begins at {started_at}, which is in the future: the clock was ahead when it was "
        "opened",
        "It is not used, but no other can begin.",
        "if the clock is right now: sunarc epochs close {pose_epoch}",
    ),
    day=Message("{date} was {verdict}: {reasons}", "A solar day has ended and was evaluated."),
    night=Message("the night of {date} was {verdict}: {reasons}", "A night has ended and was evaluated."),
    night_images=Message(
        "stars identified in {n} of {images} images; cloud fraction {cloud_fraction:.2f}",
        "The stars are used as sightings, in addition to the sun.",
    ),
    night_few_images=Message("{n} images, {limit} needed", "The night is not evaluated."),
    moon_few=Message("{n} sightings of the moon agree, {limit} needed", "The moon of this night is not used."),
    moon_outside=Message("the moon is outside of the image, or too low or thin", "The moon is not used."),
    night_frozen=Message(
        "the camera delivered the same image again {n} times", "Its repetitions are not used.", "power-cycle the camera"
    ),
    night_without_calibration=Message(
        "no calibration to identify the stars with", "The stars of this night are not used.", "wait for a clear day"
    ),
    night_given_up=Message(
        "the evaluation of the night was started {tries} times and never finished",
        "The {n} images of this night are not used.",
        "see the log for how the process ended; report it with the log",
    ),
    night_clock_not_trusted=Message(
        "the clock that dates the images is not trusted",
        "The stars of this night are not used.",
        "see clock_unsynchronised, clock_settling or camera_clock_offset in /readyz",
    ),
    night_focus_worse=Message(
        "for {nights} nights the stars have been {ratio:.2f} times as wide as before: {fwhm_px:.2f} px",
        "Sightings of stars are less precise; those of the sun hardly change.",
        "inspect lens and dome: focus, dirt, ice",
    ),
    night_dew_suspected=Message(
        "in the night of {date} the stars lost {fading_mag:.2f} magnitudes while they became {width_growth:.2f} times "
        "as wide and their halo grew by {halo_growth:.2f} of their light: dew, ice or haze",
        "Images of that night's end are less sharp; its sightings carry their own uncertainty.",
        "inspect the dome's heating and its seal; where the sky was hazy there is nothing to do",
    ),
    warm_pixels_unread=Message(
        "the list of warm pixels cannot be read, {file}: {error}",
        "Fewer stars are identified in the first hour and a half of the next night.",
        "none: the list is made again in the next night",
    ),
    warm_pixels_other_sensor=Message(
        "the list of warm pixels is of another sensor, {file}: {stored}; the images are {present}",
        "It is not used; fewer stars are identified in the first hour and a half of the next night.",
        "none: the list is made again in the next night",
    ),
    warm_pixels_unwritten=Message(
        "the list of warm pixels could not be written, {file}: {error}",
        "After a restart the former list is used.",
        "free disk space; it is written again after the next night",
    ),
    refit_accepted=Message("refit {refit} was accepted: {message}", "A refit made a calibration that may be served."),
    refit_marginal=Message(
        "refit {refit} is marginal: {message}",
        "A refit made a calibration that is kept as a candidate.",
        "`sunarc calibrations activate ID` serves it",
    ),
    refit_refused=Message(
        "refit {refit} was refused: {message}",
        "A refit made a calibration that is not served.",
        "see the findings of the calibration",
    ),
    refit_failed=Message("refit {refit} failed: {message}", "A refit made no calibration.", "see the text"),
    no_accepted_sightings=Message(
        "there are no accepted sightings yet",
        "A refit had nothing to solve.",
        "wait for a clear day, or import sightings with `sunarc points import`",
    ),
    no_usable_sightings=Message(
        "none of {n} sightings can be used: {n_doubtful_clock} with a doubtful clock, {n_other_days} of cloudy or "
        "unusable days",
        "A refit had nothing to solve.",
        "wait for a clear day; see the conditions of the clock",
    ),
    refit_waiting=Message(
        "{n:refit} cannot begin: the time of the frames is not known, or the host's clock is not trusted",
        "Refits wait for a time that dates their calibration; those that wait for {limit_h:.0f} hours fail.",
        "check the camera and the time service; see the conditions of camera and clock",
    ),
    refit_not_begun=Message(
        "the refit could not begin within {limit_h:.0f} hours: the time of the frames was not known, or the clock not "
        "trusted",
        "The refit failed.",
        "check the camera and the time service, and ask for the refit again",
    ),
    solve_failed=Message("the solve failed: {error}", "A refit made no calibration.", "see the log"),
    solve_too_long=Message(
        "the solve took longer than {limit_s:g} s",
        "A refit made no calibration.",
        "free processor time on the host (see its load)",
    ),
    solver_died=Message(
        "the solver process ended before it answered ({end})",
        "It was killed, or memory was short; it is started once more.",
        "free memory on the host (journalctl -k names what the kernel killed)",
    ),
    search_failed=Message(
        "the search for pose epochs failed: {error}", "The refit goes on with the known ones.", "see the log"
    ),
    active_is_pinned=Message(
        "the accepted fit is kept as a candidate: the active calibration is pinned",
        "An operator pinned the active one.",
        "`sunarc calibrations unpin ID` lets refits replace it",
    ),
    epochs_searched=Message(
        "the record was searched for pose changes: {steps} found", "Pose epochs of sightings before the start."
    ),
    # hub
    hub_unreachable=Message(
        "the hub has not been reached for {hours:g} h: {error}",
        "Rows wait in the outbox, without a limit; measurements continue.",
        "check the network, the hub, and hub.url",
    ),
    hub_refuses=Message(
        "the hub refuses this imager's rows ({status:g}): {error}",
        "Rows wait in the outbox, without a limit; measurements continue.",
        "see the hub's /v1/quarantine; make a token there with `sunarc hub token`, or accept the installation",
    ),
    hub_answer_invalid=Message(
        "the hub, or a proxy before it, answers {error}",
        "Rows wait in the outbox, without a limit; measurements continue.",
        "check hub.url, the proxies on the way, and the hub's version",
    ),
    hub_lacks_rows=Message(
        "the hub has fewer or other rows of {n_days:day}, though they were sent again; first {kind} of {first}",
        "Rows are in this archive and not on the hub; measurements continue.",
        "see the hub's /v1/quarantine and its journal",
    ),
    hub_rows_sent_again=Message(
        "the hub does not have what this archive has of {n_days:day} ({kinds}, first {first}): {n_rows:row} go again",
        "A comparison by night found it; nothing is lost.",
    ),
    hub_has_other_rows=Message(
        "the hub has {n_rows:row} of {n_days:day} (first {first}) that this archive does not have",
        "This archive was put back to an earlier copy, or lost rows; the hub keeps them.",
    ),
    hub_not_compared=Message(
        "rows are not compared with the hub's: {reason}",
        "Rows that the hub does not have for another reason than the feed's stay unnoticed.",
        "install one version on imagers and hub",
    ),
    # nightly work of a hub
    nightly_failed=Message(
        "nightly jobs of {night} failed: {jobs}; first error: {error}",
        "Summaries, cross-checks or retention of a hub are late; nothing is lost.",
        "it is tried again every hour; the log has the stack, /v1/nightly the errors",
    ),
    store_failed=Message(
        "no row can be stored: {error}",
        "A hub stores nothing; imagers keep their rows and send them again. Not ready.",
        "let the database answer and take rows (not read-only, no table locked); the hub then continues by itself",
    ),
    store_full=Message(
        "no row can be stored: {error}",
        "A hub stores nothing; imagers keep their rows and send them again. Not ready.",
        "free space on the database's disk; the hub then continues by itself",
    ),
    # messages to receivers
    push_failing=Message(
        "no message reached {name} for {hours:g} h: {error}",
        "Messages wait in the archive and are sent later, in their order.",
        "check the receiver, the network, and the settings in [push] (address, certificate, login)",
    ),
    push_unusable=Message(
        "messages cannot be sent to {name}: {error}",
        "A file or a library that this receiver needs is missing here; messages wait in the archive. Everything else "
        "continues.",
        "make the file that is named readable for the service's user, or correct [push]; retried every minute",
    ),
    push_refused=Message(
        "{name} refuses messages, {n:g} until now, the last of kind {kind}: {error}",
        "They are not sent again; later ones are.",
        "correct the receiver, or its address in push.webhooks; the next message that it accepts ends this notice",
    ),
    push_overflow=Message(
        "{lost} messages were deleted before a receiver had taken them: at most {most} are kept",
        "The oldest messages are lost to that receiver.",
        f"correct the receiver, or remove it from [push]; {_NO_NOTICE}",
    ),
    # camera and exposures
    gain_not_restored=Message(
        "the gain that was raised for a night exposure is not restored: {error}",
        "No exposure is taken until it is: the day's sightings would be wrong.",
        "it is tried again by itself; power-cycle the camera if it stays",
    ),
    camera_lost=Message(
        "{error}",
        "The camera does not answer; it is opened again automatically, at most 30 s apart.",
        "check the camera's power, cable and address; it is retried automatically",
    ),
    exposures_contradicted=Message(
        "{error}",
        "The camera answers, but the brightness of its frames contradicts their exposure times; it is opened again "
        "automatically.",
        "check that nothing else sets the camera's exposure, gain or automatic functions; none where clouds are the "
        "cause",
    ),
    camera_refused=Message(
        "{error}",
        "Camera and settings do not fit (image size, pixel format, exposures); nothing is stored. Not ready.",
        "{remedy}",
    ),
    exposures_failing=Message(
        "last {cycles} cycles incomplete, no composite written: {error}",
        "An exposure failed in every attempt, frames were suspect, or the camera was lost in between.",
        "check the network between host and camera, and the log; sunarc check --camera tries each exposure",
    ),
    sun_exposures_failing=Message(
        "no sun exposure succeeded in the last {cycles} cycles: {error}",
        "No sighting can come of these slots; the normal exposures are taken.",
        "see the error; sunarc check --camera tries each exposure",
    ),
    packets_too_large=Message(
        "no frame came whole with stream packets of {lost} bytes; {used} are used",
        "Frames arrive; receiving them takes more of the host's time.",
        "set camera.packet_size = {used}, or let jumbo frames pass all the way: camera, switches, host",
    ),
    cycle_too_long=Message(
        "for {cycles} cycles the normal exposures ({hdr_s:.3g} s in the last one) left no time for sun exposures: no "
        "sightings, so no calibration",
        "Ten cycles or more without a sun exposure.",
        "set a longer capture.cadence_s, fewer or shorter capture.hdr_exposures_us, a larger camera.packet_size, or a "
        "smaller camera.region",
    ),
    slots_missed=Message(
        "{missed} of the last {slots} slots with the sun up had no cycle",
        _BY_OTHERS,
        "free processor time on the host (see its load), or set a longer capture.cadence_s",
    ),
    no_sightings=Message(
        "no sighting was stored in the last {slots} slots with the sun up",
        "Not even a rejected one, with the sun 10° or more above the horizon.",
        "see the other conditions and the log for why exposures fail or are rejected; check the camera (sunarc check "
        "--camera), the disk and the host's processor load",
    ),
    black_frames=Message(
        "the last {slots} slots by day are black at {exposure_us:g} µs; the sun cannot be detected",
        "Neither sightings nor composites. Not ready.",
        "take the lens cap off, open the dome or shutter, check iris and filter; with a dense filter set longer "
        "capture.hdr_exposures_us",
    ),
    sun_too_bright=Message(
        "sun saturates at the shortest exposure ({exposure_us:g} µs); its disc is not detected",
        "20 cycles without a usable sun exposure.",
        "put a neutral filter (optical density 2 to 3) before the lens, or lower the gain; where saturated pixels "
        "spill into others, set sensor.blooming",
    ),
    camera_frozen=Message(
        "the camera repeats its images: {n} in a row are copies of earlier ones (the last: of {time})",
        "No sighting is accepted.",
        "restart the camera (power), and update its firmware if it happens again",
    ),
    image_rows_repeated=Message(
        "{n} rows of the last images, one below the other, are the same",
        "The sun is not seen there, as behind cloud.",
        "restart the camera (power); check its cable and network, and update its firmware",
    ),
    image_levels_missing=Message(
        "the last images have {n} levels of brightness in all",
        "The place of the sun is coarse, or it is not seen, as behind cloud.",
        "restart the camera (power); check its pixel format, digital gain and contrast settings, and its cable",
    ),
    # disk and database
    images_not_written=Message(
        "images are not kept: {error}",
        "Images are missing; the sun is looked for in each all the same.",
        "free space on the disk of the state folder, or make it writable",
    ),
    images_unreadable=Message(
        "{error}",
        "The image folder cannot be read.",
        "give the folder back to the service's user and mount its disk; rechecked automatically",
    ),
    disk_low=Message(
        "disk of {folder}: {free_mb:.0f} MB free, less than disk.keep_free_mb; images take {images_mb:.0f} MB",
        "No composite is kept.",
        "free space on this disk, or lower disk.keep_free_mb; rechecked automatically",
    ),
    disk_full=Message(
        "disk of {folder} full ({free_mb:.0f} MB free, images take {images_mb:.0f} MB); using the reserved space for "
        "the database",
        "No composite is kept.",
        "free space on this disk, soon; rechecked automatically",
    ),
    disk_no_inodes=Message(
        "the file system of {folder} has no free inodes ({free_mb:.0f} MB free); no file can be created",
        "No composite is kept.",
        "remove small files (df -i shows the file system); rechecked automatically",
    ),
    sightings_not_stored=Message(
        "{waiting} sightings not written, held in memory ({lost} lost): {error}",
        "They are stored later.",
        "free space on the disk of the state folder, or make it writable; do not restart until written, or they are "
        "lost",
    ),
    database_missing=Message(
        "{error}",
        "The database was deleted, replaced or emptied, or cannot be reached; sightings wait in memory.",
        "check the disk and the state folder; retried automatically, do not restart before",
    ),
    database_slow=Message(
        "storing took up to {seconds:.1f} s at once; {waiting} images or sightings wait",
        "Nothing is lost: exposures continue, and sightings wait in memory.",
        "check the disk of the state folder (journalctl -k, smartctl, iostat), or move the folder to another one",
    ),
    database_salvaged=Message(
        "{text}",
        "A page of the database could not be read; what could be was written into a new one.",
        "check the disk (smartctl, journalctl -k); sunarc db check; a restart ends this notice",
    ),
    database_written_back=Message(
        "{text}",
        "A database deleted or replaced under the service was written back from the open connection.",
        f"find out what removed it; {_NO_NOTICE}",
    ),
    database_restored=Message(
        "{text}",
        "A missing or empty database was restored from the newest copy; what came after that copy is lost.",
        f"find out what removed it, see `sunarc calibrations list`; {_NO_NOTICE}",
    ),
    database_new=Message(
        "{text}",
        "A database was missing or empty and there was no copy.",
        f"to go on with a copy: stop the service, then sunarc db restore SOURCE --state DIR; {_NO_NOTICE}",
    ),
    # clock
    clock_step=Message(
        "{clock} clock stepped by {step_s:+.3f} s {how}",
        "The clock that dates the frames was set.",
        "check what sets the clock; sightings around the step carry its size as their error",
    ),
    clock_stepped=Message(
        "{clock} clock stepped by {step_s:+.3f} s {how} at {at}",
        "The clock that dates the frames was set within the last hour.",
        "check what sets the clock; sightings around the step carry its size as their error",
    ),
    clock_settling=Message(
        "host clock stepped by a minute or more, or gradually; not used for calibration for another {wait_s:.0f} s",
        "Sightings made meanwhile are left out of fits, and no day is evaluated.",
        "check the host's time (timedatectl); if it is wrong, correct it: a return to the former time shortens the "
        "wait to 10 min",
    ),
    clock_unsynchronised=Message(
        "{clock} clock not synchronised (1 s of error = 0.004° of sun position); daily evaluation and calibration are "
        "suspended",
        "Sightings made meanwhile are left out of fits.",
        "host clock: start a time service (systemd-timesyncd or chrony) and let it reach its servers; camera clock: "
        'check the PTP master, or set camera.timestamps = "host", then restart the service',
    ),
    camera_clock_offset=Message(
        "camera timestamps differ from the host clock by {offset_s:+.3f} s (limit {limit_s:g} s){cause}",
        "Sightings carry this difference as their clock error.",
        "{remedy}",
    ),
)

_ALL = Messages(detection.MESSAGES | calibration.MESSAGES | changes.MESSAGES | MESSAGES)

text_of = _ALL.text_of


def condition_of(code: str, name: str, **data: float | str) -> Reason:
    """Return a condition of one receiver, whose name ends its code."""
    return Reason.of(Finding(code, {"name": name, **data}), MESSAGES, code=worker_code(code, name))


def condition(code: str, *, severity: Severity = "degraded", **data: float | str) -> Reason:
    """Return a condition for the status board."""
    return Reason.of(Finding(code, data), MESSAGES, severity=severity)
