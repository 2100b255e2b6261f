"""Position of the sun, the moon, planets and bright stars, refraction, directions and local mean solar days."""

from sunarc.sky.air import CLEAR_OPTICAL_DEPTH, clear_transmission, relative_air_mass
from sunarc.sky.days import SECONDS_PER_DEGREE, date_of_day, day_bounds_unix_s, day_of_date, solar_date, solar_days
from sunarc.sky.directions import angles_from_direction, angular_distance, direction_from_angles, wrapped_deg
from sunarc.sky.moon import MoonDisc, moon_disc
from sunarc.sky.night import (
    FAINTEST_V,
    STAR,
    SUN,
    WANDERERS,
    NightSky,
    Wanderer,
    WandererPlace,
    body_directions,
    night_sky,
    wanderer_place,
)
from sunarc.sky.refraction import (
    ASSUMED_AIR_SD,
    DAILY_AIR_SD,
    MEASURED_AIR_SD,
    apparent_elevation,
    raised,
    refraction_rad,
    upward,
)
from sunarc.sky.site import PA_PER_HPA, PRESSURE_BOUNDS_HPA, PRESSURE_BOUNDS_PA, TEMPERATURE_BOUNDS_C, Site
from sunarc.sky.star_names import title_of
from sunarc.sky.sun import SOLAR_RADIUS, SunAngles, hour_angle, sun_angles, sun_directions

__all__ = [
    "ASSUMED_AIR_SD",
    "CLEAR_OPTICAL_DEPTH",
    "DAILY_AIR_SD",
    "FAINTEST_V",
    "MEASURED_AIR_SD",
    "PA_PER_HPA",
    "PRESSURE_BOUNDS_HPA",
    "PRESSURE_BOUNDS_PA",
    "SECONDS_PER_DEGREE",
    "SOLAR_RADIUS",
    "STAR",
    "SUN",
    "TEMPERATURE_BOUNDS_C",
    "WANDERERS",
    "MoonDisc",
    "NightSky",
    "Site",
    "SunAngles",
    "Wanderer",
    "WandererPlace",
    "angles_from_direction",
    "angular_distance",
    "apparent_elevation",
    "body_directions",
    "clear_transmission",
    "date_of_day",
    "day_bounds_unix_s",
    "day_of_date",
    "direction_from_angles",
    "hour_angle",
    "moon_disc",
    "night_sky",
    "raised",
    "refraction_rad",
    "relative_air_mass",
    "solar_date",
    "solar_days",
    "sun_angles",
    "sun_directions",
    "title_of",
    "upward",
    "wanderer_place",
    "wrapped_deg",
]
