"""What a run over a folder came to."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sunarc.archive.file_sightings import FileSighting, ImageKey
from sunarc.calibration.messages import MESSAGES as OF_CALIBRATION
from sunarc.findings import Finding
from sunarc.offline.ingest.index import ImageFile, Skipped
from sunarc.offline.ingest.nights import NightOutcome
from sunarc.offline.messages import MESSAGES
from sunarc.workers.messages import MESSAGES as OF_WORKERS

_TABLES = (MESSAGES, OF_CALIBRATION, OF_WORKERS)


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Counts of a folder's images.

    Attributes
    ----------
    accepted, rejected : images looked at in this run, by whether a fit may use their sighting.
    stacked : images looked at in this run whose sighting is that of another image of the same time.
    known : images that were in the archive before, and were left as they were.
    by_verdict : all images of the folder in the archive, those known before among them, by the verdict on them.
    skipped : images that were left out, with the reason.
    contact_sheet : picture with examples of each verdict; None where there is no image.
    camera_findings : why no camera could predict the sun in some images, and what of it has to be set.
    nights : nights whose images were looked at in this run.
    nights_known : images of nights that were looked at before.
    """

    accepted: int
    rejected: int
    stacked: int
    known: int
    by_verdict: Mapping[str, int]
    skipped: tuple[Skipped, ...]
    contact_sheet: Path | None
    camera_findings: tuple[Finding, ...] = ()
    nights: tuple[NightOutcome, ...] = ()
    nights_known: int = 0

    @property
    def by_reason(self) -> dict[str, int]:
        """Images that were left out, by the code of the reason."""
        return dict(Counter(one.finding.code for one in self.skipped).most_common())

    def as_json(self) -> dict[str, Any]:
        """Return the JSON object of `sunarc ingest --json`."""
        return {
            "accepted": self.accepted,
            "rejected": self.rejected,
            "stacked": self.stacked,
            "known": self.known,
            "skipped": len(self.skipped),
            "by_verdict": dict(self.by_verdict),
            "by_reason": self.by_reason,
            "contact_sheet": None if self.contact_sheet is None else str(self.contact_sheet),
            "camera_findings": [finding.as_json() for finding in self.camera_findings],
            "nights": [night.as_json() for night in self.nights],
            "nights_known": self.nights_known,
            "files_skipped": [
                {"file": one.path, **one.finding.as_json(), "reason": MESSAGES.text_of(one.finding)}
                for one in self.skipped
            ],
        }


def newest_verdicts(images: Iterable[ImageFile], stored: Iterable[FileSighting]) -> dict[ImageFile, FileSighting]:
    """Return the sighting that counts of each image: the accepted one, else the one stored last."""
    by_key: dict[ImageKey, FileSighting] = {}
    for one in stored:
        former = by_key.get(one.key)
        if former is None or one.accepted or not former.accepted:
            by_key[one.key] = one
    return {image: by_key[image.key] for image in images if image.key in by_key}


def sentence_of(finding: Finding) -> str:
    """Return a finding of `Summary.camera_findings` as a sentence, with what to do about it."""
    table = next((table for table in _TABLES if finding.code in table), MESSAGES)
    return f"{table.text_of(finding)}; {table.remedy_of(finding)}"
