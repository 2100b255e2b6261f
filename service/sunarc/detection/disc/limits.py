"""Limits of the search for the disc and of its classification; the lengths are px of the sensor, before binning."""

from __future__ import annotations

PSF_PX = 0.7
"""Standard deviation of the lens's point spread; the fit adapts it to the frame."""
PSF_TOLERANCE = 0.3
"""1-sigma of its logarithm; the fit moves it that far."""
WINGS_TOLERANCE = 0.05
"""1-sigma of the share of light in wings three times as wide."""
LIMB_DARKENING = 0.6
"""u of 1 - u (1 - cos) across the sun's disc, in visible light (Allen's Astrophysical Quantities)."""
SOLAR_RADIUS_DEG = 0.2666
"""The sun's angular radius at one astronomical unit, 959.6″."""
SATURATION_FRACTION = 0.98
"""Counts from this fraction of full scale on are saturated."""
MIN_PEAK_FRACTION = 0.01
"""Level over full scale below which no disc is searched for."""
MIN_ACCEPTED_FRACTION = 0.07
"""Level below which a disc is rejected: a partly covered one would look the same."""
MIN_SNR = 12.0
"""Signal-to-noise ratio below which the sun counts as hidden."""
MIN_RADIUS_PX = 1.2
MAX_RADIUS_PX = 10.0
"""Bounds of the semi-axes of a disc without a prediction."""
MAX_ELLIPTICITY = 0.6
"""Largest 1 - minor/major semi-axis of such a disc."""
MAX_UNEVEN_PX = 0.03
"""A disc whose uneven brightness may have moved the centre further is partly covered."""
MAX_RESIDUAL_FRACTION = 0.02
"""So is a disc with larger residuals over its level."""
MAX_SIGMA_PX = 0.06
"""A less certain position is not accepted."""
VEILED_BELOW = 0.5
"""A disc below this fraction of the clear sky's is veiled; so is one below this contrast."""
MAX_APPARENT_ZENITH_DEG = 89.6
"""A lower sun is below the horizon."""
FAINTEST_SHARE = 1e-4
"""Fraction of the clear sun's level below which a disc is not the sun; the full moon has 2.5e-6."""
FAINTEST_LEVEL_PER_US = 1e-4
"""Where the clear level is unknown, a disc without a prediction and with less than this level over full scale in 1 µs
is not the sun. Through a bare lens the sun has 0.1 to 10, the full moon 1e-7 to 3e-5."""
