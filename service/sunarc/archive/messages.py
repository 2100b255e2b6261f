"""The messages of what the archive decides: calibrations activated, served again or damaged, pose epochs closed."""

from __future__ import annotations

from sunarc.calibration import messages
from sunarc.findings import Message, Messages

MESSAGES = Messages(
    activated_by_operator=Message(
        "made current by hand: {reason}", "An operator activated this calibration (POST …/activate)."
    ),
    served_again=Message("served again: {reason}", "A pose epoch was closed as wrong; the one before it continues."),
    document_damaged=Message(
        "the stored document is damaged: it does not match its checksum",
        "This calibration is not served.",
        "restore a copy with `sunarc db restore --latest`, or request a refit; check the disk",
    ),
)

_ALL = Messages(messages.MESSAGES | MESSAGES)

text_of = _ALL.text_of
