"""The numbers that the paper prints (Urquhart et al. 2016, Tables 1 to 3 and section 5.3)."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import date


@dataclass(frozen=True, slots=True, kw_only=True)
class Case:
    """One of the paper's five cases.

    Attributes
    ----------
    number : 1 to 5.
    days : solar days in it.
    n_points : sightings (Table 1).
    sd_m_px, rmsd_m_px : scatter about the smooth arcs: standard deviation of the distance, and root mean square.
    rmse_px, mae_px, sd_px : of the calibration (Table 3); SD is the standard deviation of the distance, for
        RMSE² = MAE² + SD².
    focal_length_px, skew_px, principal_point_px : Table 2.
    pose_deg : φ_xz, θ_zz, ψ_z (Table 2).
    cloud_share : share of sightings in episodes of cloud that the simulation takes; the paper names none.
    """

    number: int
    days: tuple[date, ...]
    n_points: int
    sd_m_px: float
    rmsd_m_px: float
    rmse_px: float
    mae_px: float
    sd_px: float
    focal_length_px: tuple[float, float]
    skew_px: float
    principal_point_px: tuple[float, float]
    pose_deg: tuple[float, float, float]
    cloud_share: float = 0.0


def _make_dates(*month_and_day: tuple[int, int]) -> tuple[date, ...]:
    return tuple(date(2013, month, day) for month, day in month_and_day)


CASES = (
    Case(
        number=1,
        days=_make_dates((5, 13)),
        n_points=1582,
        sd_m_px=0.43,
        rmsd_m_px=0.81,
        rmse_px=0.94,
        mae_px=0.78,
        sd_px=0.52,
        focal_length_px=(601.44, 601.44),
        skew_px=-1.94e-3,
        principal_point_px=(873.24, 881.62),
        pose_deg=(47.89, 2.58, 136.51),
    ),
    Case(
        number=2,
        days=_make_dates((5, 13), (5, 14)),
        n_points=3195,
        sd_m_px=0.43,
        rmsd_m_px=0.78,
        rmse_px=0.96,
        mae_px=0.81,
        sd_px=0.52,
        focal_length_px=(601.40, 601.40),
        skew_px=1.72e-3,
        principal_point_px=(871.48, 882.97),
        pose_deg=(47.90, 2.47, 141.48),
    ),
    Case(
        number=3,
        days=_make_dates((5, 13), (5, 14), (6, 2), (6, 11)),
        n_points=6543,
        sd_m_px=0.62,
        rmsd_m_px=1.05,
        rmse_px=1.24,
        mae_px=1.02,
        sd_px=0.70,
        focal_length_px=(601.32, 601.32),
        skew_px=2.57e-3,
        principal_point_px=(871.96, 883.00),
        pose_deg=(47.91, 2.46, 140.16),
    ),
    Case(
        number=4,
        days=_make_dates((5, 13), (5, 14), (5, 22), (6, 1), (6, 2), (6, 3), (6, 7), (6, 9), (6, 10), (6, 11)),
        n_points=15966,
        sd_m_px=2.49,
        rmsd_m_px=2.81,
        rmse_px=2.94,
        mae_px=1.49,
        sd_px=2.53,
        focal_length_px=(601.12, 601.11),
        skew_px=4.14e-3,
        principal_point_px=(871.97, 883.31),
        pose_deg=(47.93, 2.43, 140.06),
        cloud_share=0.12,
    ),
    Case(
        number=5,
        days=_make_dates((6, 7)),
        n_points=1482,
        sd_m_px=5.21,
        rmsd_m_px=6.19,
        rmse_px=6.30,
        mae_px=3.48,
        sd_px=5.25,
        focal_length_px=(601.88, 601.88),
        skew_px=2.53e-3,
        principal_point_px=(874.20, 880.84),
        pose_deg=(47.90, 2.63, 134.02),
        cloud_share=0.22,
    ),
)

TRUE_RMSE = ((0.43, 0.14, 0.03), (5.21, 0.37, 0.11))
"""Read from Fig. 4 by the paper: noise, mean and half the 90 % interval of the true error on the arc, px."""

FOCAL_LENGTH_P90 = 0.05
PRINCIPAL_POINT_P90 = 0.25
"""Half the 90 % interval per px of noise (Fig. 5)."""
