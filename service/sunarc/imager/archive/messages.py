"""The messages of what the archive decides on sightings, calibrations and pose epochs, and of what it stores."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, get_args

from sunarc.calibration import messages as calibration
from sunarc.changes import messages as changes
from sunarc.changes.values import ChangeKind
from sunarc.common.findings import Finding, Message, Messages
from sunarc.detection import messages as detection

MESSAGES = Messages(
    # sightings
    two_pictures_of_one_time=Message(
        "{file} and {other} are pictures of one time",
        "Where their suns are within 1 px of one another one counts, else neither.",
        "set [folder] path (or ingest's folder) to that of one camera's unprocessed pictures",
    ),
    sighting_superseded=Message(
        "another method's sighting of the same image is accepted", "Set aside: an image counts once."
    ),
    star_not_named_again=Message(
        "not named when its image was looked at again", "The sighting of a star was set aside."
    ),
    sighting_ambiguous=Message(
        "ambiguous: the camera moved between {earliest} and then", "Set aside: it may be of either pose."
    ),
    camera_had_moved=Message(
        "the camera had moved", "Seen elsewhere, and accepted once the camera was known to have moved."
    ),
    sighting_imported=Message("imported from {file}", "The sighting comes from a file (`sunarc points import`)."),
    # calibrations, nights
    activated_by_operator=Message(
        "activated by an operator: {reason}", "An operator activated this calibration (POST …/activate)."
    ),
    served_again=Message("served again: {reason}", "A pose epoch was closed as wrong; the one before it continues."),
    document_damaged=Message(
        "the stored document is damaged: it does not match its checksum",
        "This calibration is not served.",
        "restore a copy with `sunarc db restore --latest`, or request a refit; check the disk",
    ),
    night_damaged=Message(
        "the stored night is damaged: its {field} cannot be read",
        "Nothing is known of this night.",
        "judge it again (`sunarc ingest --reprocess`), or restore a copy of the database; check the disk",
    ),
    # events
    calibration_reinstated=Message(
        "{calibration} was activated by an operator: {reason}",
        "An operator activated this calibration (POST …/activate).",
    ),
    calibration_pinned=Message("{calibration} was pinned: {reason}", "Refits make candidates until it is unpinned."),
    calibration_unpinned=Message("{calibration} was unpinned: {reason}", "Refits may replace it again."),
    epoch_closed=Message(
        "pose epoch {pose_epoch} (from {started_at}) was closed as wrong: {reason}",
        "The epoch before it continues, and the calibration served before is current again.",
    ),
)

_ALL = Messages(detection.MESSAGES | calibration.MESSAGES | changes.MESSAGES | MESSAGES)

text_of = _ALL.text_of


def reason_of(findings: Iterable[Finding]) -> str:
    """Return the findings of a sighting in a sentence."""
    return detection.reason_of(findings, _ALL)


def code_of_event(kind: str, details: Mapping[str, Any]) -> str:
    """Return the code of a stored event, of which the archive has the kind: several codes may share one."""
    if kind not in get_args(ChangeKind):
        return kind
    return "pose_changed" if details.get("searched") else f"changed_{kind}"
