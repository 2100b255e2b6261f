"""Conditions that the numbers of the last nights give rise to: stars that grew wide, a dome that dewed over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from sunarc.detection.stars.trend import NightLimits, NightTrend, dew_suspected, focus_ratio
from sunarc.runtime.status import Reason
from sunarc.workers.messages import condition

NIGHT_CODES = ("night_focus_worse", "night_dew_suspected")
NIGHTS_COMPARED = 20
_WORTH_COMPARING = frozenset({"clear", "partly"})


def night_conditions(nights: Sequence[Mapping[str, Any]], limits: NightLimits) -> dict[str, Reason | None]:
    """Return the conditions by code, None for one that does not hold.

    Parameters
    ----------
    nights : what the events of the last nights say, the newest first.
    limits : what is suspected.
    """
    return dict(zip(NIGHT_CODES, (_focus(nights, limits), _dew(nights, limits)), strict=True))


def _focus(nights: Sequence[Mapping[str, Any]], limits: NightLimits) -> Reason | None:
    """Return the condition of stars that are wider than they were."""
    widths = [
        float(night["star_fwhm_px"])
        for night in nights
        if night.get("verdict") in _WORTH_COMPARING and night.get("star_fwhm_px") is not None
    ]
    ratio = focus_ratio(widths, limits)
    if ratio is None:
        return None
    return condition("night_focus_worse", ratio=ratio, fwhm_px=widths[0], nights=limits.nights)


def _dew(nights: Sequence[Mapping[str, Any]], limits: NightLimits) -> Reason | None:
    """Return the condition of a last night whose stars faded while they grew wider or hazy."""
    newest = nights[0] if nights else {}
    width, halo, fading = (newest.get(name) for name in ("width_growth", "halo_growth", "fading_mag"))
    trend = NightTrend(width_growth=_number(width), halo_growth=_number(halo), fading_mag=_number(fading))
    if not dew_suspected(trend, limits):
        return None
    return condition(
        "night_dew_suspected",
        date=str(newest.get("date", "")),
        width_growth=trend.width_growth,
        halo_growth=trend.halo_growth,
        fading_mag=trend.fading_mag,
    )


def _number(value: Any) -> float:  # noqa: ANN401 - of JSON
    return float("nan") if value is None else float(value)
