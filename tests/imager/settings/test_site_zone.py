"""The time zone of a site is for displays: what is computed with, stored and compared is the site alone."""

from __future__ import annotations

from sunarc.imager.settings.model import Settings, SiteOptions
from sunarc.sky.site import Site


def test_the_place_of_the_settings_equals_the_site_of_a_calibration() -> None:
    site = Site(latitude=-36.85, longitude=174.76, altitude=40.0)
    zoned = SiteOptions(latitude=-36.85, longitude=174.76, altitude=40.0, timezone="Pacific/Auckland")
    settings = Settings.model_validate({"state": "/var/lib/sunarc", "site": zoned, "source": "replay"})
    assert (settings.site.timezone, settings.place) == ("Pacific/Auckland", site)
    assert type(settings.place) is Site
