"""The lens prior file that the settings name, and what is known of the camera's pose before its first sighting."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from sunarc.bounds import require_bounds
from sunarc.calibration.lens_library.first_pose import FirstPoseOptions
from sunarc.calibration.lens_library.lens_type import LensType, lens_type_from_json
from sunarc.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class LensPriorOptions(FirstPoseOptions):
    """What is known of lens and pose before the first full fit.

    Attributes
    ----------
    lens_prior : file of the type of lens (`sunarc calibrate --write-lens-prior`); unset: no pose before the first fit.
    """

    lens_prior: Path | None = None

    def __post_init__(self) -> None:
        """Refuse what is no pose."""
        require_bounds(self, section="first_pose")


class FirstPose(NamedTuple):
    """A type of lens, and what is known of the pose."""

    lens: LensType
    pose: FirstPoseOptions

    @classmethod
    def of(cls, options: LensPriorOptions) -> FirstPose | None:
        """Return what the settings name; None where they name no lens prior file.

        Raises
        ------
        InputError
            Where the file is none.
        """
        return None if options.lens_prior is None else cls(read_lens_prior(options.lens_prior), options)


def read_lens_prior(path: Path) -> LensType:
    """Return the type of lens of a lens prior file; InputError names what is wrong with it."""
    remedy = "name a file of sunarc calibrate --write-lens-prior"
    try:
        return lens_type_from_json(json.loads(path.read_bytes()))
    except OSError as error:
        raise InputError(field=str(path), problem=error.strerror or str(error), remedy=remedy) from None
    except ValueError:
        raise InputError(field=str(path), problem="is not JSON", remedy=remedy) from None
    except InputError as error:
        raise InputError(field=f"{path.name}, {error.field}", problem=error.problem, remedy=error.remedy) from None
