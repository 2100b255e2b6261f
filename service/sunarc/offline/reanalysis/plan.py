"""What is known of a camera before its images are looked at, and the images themselves."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import PurePosixPath
from typing import NamedTuple

from sunarc.calibration.model.options import CalibrationOptions
from sunarc.findings import Finding
from sunarc.offline.detect_files import Method
from sunarc.offline.sources.times import TimeRules
from sunarc.sky.site import Site


class ArchiveImage(NamedTuple):
    """An image of an archive: in which file of which source, which of its frames, when and how exposed.

    time_us: microseconds since 1970-01-01 as the archive states them, brought to UTC. stamp: changes with the content.
    """

    time_us: int
    file: str
    number: int
    address: str
    exposure_us: float | None
    stamp: str

    @property
    def unix_s(self) -> float:
        """Seconds since 1970-01-01, as the archive states them."""
        return self.time_us / 1e6

    @property
    def name(self) -> str:
        """The file's name as tables show it: below its source, with the number of the frame where there are several."""
        return f"{PurePosixPath(self.address).name}/{self.file}" + (f"#{self.number}" if self.number else "")


class Failure(NamedTuple):
    """A file, or a camera, that could not be used, and why."""

    file: str
    finding: Finding


class Selector(NamedTuple):
    """Which files are a camera's: those of some sources whose names match a pattern of `fnmatch`."""

    sources: tuple[str, ...]
    files: str = "*"


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraPlan:
    """A camera of an archive.

    Attributes
    ----------
    name : of its folder in the output.
    site : where it stands.
    selector : which files are its.
    rules : how times are read.
    image_size : width and height, px; None for what most of its images have.
    method : see `detect_in_image`.
    options : how it is calibrated.
    """

    name: str
    site: Site
    selector: Selector
    rules: TimeRules = field(default_factory=TimeRules)
    image_size: tuple[int, int] | None = None
    method: Method = "auto"
    options: CalibrationOptions = field(default_factory=CalibrationOptions)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraImages:
    """A camera with its images.

    Attributes
    ----------
    plan : see there; of a camera that was found among others, with its own name.
    images : those by day, in the order of time and name.
    example : an image's name and time (UTC) as it was read, for confirmation.
    family : what tells the times.
    size : width and height of its images, px.
    nights : those of the night (the sun 12 degrees below the horizon or deeper), in the order of time and name.
    """

    plan: CameraPlan
    images: tuple[ArchiveImage, ...]
    example: tuple[str, str]
    family: str
    size: tuple[int, int]
    nights: tuple[ArchiveImage, ...] = ()
