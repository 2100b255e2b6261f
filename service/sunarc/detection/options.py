"""What can be set about the detection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le

from sunarc.bounds import require_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscOptions:
    """What is known of the sun in microsecond frames; the limits of its detection are constants (`disc.limits`).

    Attributes
    ----------
    clear_level_per_us : the clear sun's level over full scale in 1 µs, at the gain in use; 0 where unknown. The
        reference for the brightness where the prediction has none.
    """

    clear_level_per_us: Annotated[float, Ge(0.0), Le(1e6)] = 0.0

    def __post_init__(self) -> None:
        """Refuse values out of bounds."""
        require_bounds(self, section="detection")
