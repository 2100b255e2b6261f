"""Composites on disk: written whole or not at all, in folders by UTC date."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from sunarc.errors import OutsideError


class ImageStore:
    """Writes images under `images/YYYY/MM/DD/`.

    Parameters
    ----------
    folder : the root of the dated folders.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, captured_at: datetime, *, kind: str) -> Path:
        """Return where an image of this moment and kind ("hdr.png", "hdr.jpg") stands."""
        moment = captured_at.astimezone(UTC)
        stamp = f"{moment:%Y%m%dT%H%M%S}.{moment.microsecond // 1000:03d}Z"
        return self.folder / f"{moment:%Y/%m/%d}" / f"{stamp}_{kind}"

    def write(self, captured_at: datetime, encoded: bytes, *, kind: str) -> Path:
        """Write an encoded image atomically and return its path.

        Raises
        ------
        OutsideError : when the disk refuses.
        """
        target = self.path(captured_at, kind=kind)
        part = target.with_suffix(target.suffix + ".part")
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            part.write_bytes(encoded)
            part.replace(target)
        except OSError as error:
            part.unlink(missing_ok=True)
            raise OutsideError(f"image {target.name} could not be written: {error.strerror or error}") from error
        return target

    def newest(self, *, kind: str) -> Path | None:
        """Return the newest image of a kind, or None; looks at the last day that has one."""
        for folder in sorted(self.folder.glob("[0-9]*/[0-9]*/[0-9]*"), reverse=True):
            images = sorted(folder.glob(f"*_{kind}"))
            if images:
                return images[-1]
        return None
