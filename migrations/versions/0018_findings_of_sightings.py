"""Sightings say why they were accepted or rejected in codes and data; until now `reason` was a sentence.

Revision ID: 0018
Revises: 0017
"""

from __future__ import annotations

import json
import re
import string
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, lru_cache
from typing import Any

import sqlalchemy as sa
from alembic import op

revision = "0018"
down_revision = "0017"
branch_labels = None
depends_on = None

Found = tuple[str, dict[str, Any]]
"""A code, and its data."""

_SENTENCES = {
    "disc_found": "a disc, reduced chi² {chi2:.2f}",
    "disc_dimmed": "{share:.2f} of the clear sun's brightness",
    "disc_in_bright_sky": "{share:.2f} of the light comes from the disc",
    "saturated_left_out": "{n} saturated pixels left out",
    "bracket_mean": "mean of {frames} frames (chi² {chi2:.1f}, {freedom} degrees of freedom)",
    "disc_not_converged": "the disc fit did not converge",
    "disc_below_noise": "no disc: signal-to-noise {snr:.1f}, level {level:.4f} of full scale",
    "disc_low_contrast": "no disc: only {share:.2f} of its surroundings' level",
    "disc_edge_width": "no disc: its edge is {width_px:.2f} px wide, not {expected_px:.2f}",
    "disc_wrong_size": "no disc of the sun's size: semi-axes {minor_px:.2f} and {major_px:.2f} px",
    "disc_too_few_pixels": "too few pixels for a fit",
    "disc_too_long": "the bright region is {length_px:.0f} px long, no disc",
    "disc_saturated": "{n} pixels around the sun are saturated",
    "disc_elongated": "semi-axes {minor_px:.2f} and {major_px:.2f} px",
    "disc_displaced": "a disc {distance_px:.1f} px from where the sun should be",
    "disc_faint_unpredicted": "level {level:.3f} of full scale: too faint to be accepted without a prediction",
    "disc_poor_fit": "poor disc fit: residuals {residual:.3f} of its level, sigma {sigma_px:.3f} px",
    "disc_without_limb": "a disc without the sun's darker limb: the moon, or a lamp",
    "disc_uneven": (
        "brightness gradient across the disc moves its centre by {uneven_px:.2f} px (chi² {chi2:.0f}, 4 "
        "degrees of freedom)"
    ),
    "disc_foreign_rows": (
        "rows of another image (chi² {rows:.0f}, 2 degrees of freedom; columns {columns:.0f}): lost packets "
        "were replaced by those of another frame, or an edge parallel to the rows covers the sun"
    ),
    "disc_residuals": "residuals {residual:.3f} of the disc's level, reduced chi² {chi2:.1f}",
    "disc_faint": "level {level:.3f} of full scale: a covered disc would look the same",
    "disc_position_uncertain": "position uncertain: sigma {sigma_px:.3f} px",
    "disc_below_clear_sun": "{share:.1e} of the clear sun's brightness: the moon, or a lamp",
    "disc_below_faintest": (
        "{level:.1e} of full scale in 1 µs: the moon, a lamp, or the sun behind a filter that is not in the settings"
    ),
    "disc_rivals": "other regions are as bright, at {places}: reflections or clouds",
    "bracket_covered": "sun covered in another frame of the bracket",
    "bracket_inconsistent": (
        "the frames of the bracket are inconsistent: mean of {frames} frames (chi² {chi2:.1f}, {freedom} "
        "degrees of freedom)"
    ),
    "sun_below_horizon": "the sun is at {zenith_deg:.2f} degrees from the zenith",
    "sun_outside_image": "the sun is outside the image",
    "sun_obstructed": "dark at {level:.5f} of full scale where the sky around has {sky:.5f}",
    "no_bright_region": "no region brighter than {least:g} of full scale; only single pixels",
    "no_outstanding_region": "no region stands out: the brightest is at {level:.3f}",
    "blob_found": "a bright region of {diameter_px:.0f} px, round in {share:.2f} of the directions",
    "stack_mean": "mean of {frames} exposures, reduced chi² {chi2:.1f}",
    "stack_member": "an exposure of a stack whose sighting is that of {file}",
    "image_dark": "the brightest pixel is {peak:.2f} of full scale",
    "image_saturated": "more than half of the image is saturated",
    "no_round_region": "no bright region is round",
    "blob_displaced": "a round bright region {distance_px:.0f} px from where the sun should be",
    "blob_edged": (
        "edge sharper than the sun's (white surface or lamp): {near:.2f} of its level at 1.7 radii, {far:.2f} at 2.6"
    ),
    "blob_flat": "no brighter than its surroundings: {near:.2f} of its level at 1.7 radii, {far:.2f} at 2.6",
    "blob_not_clipped": "only {flat:.2f} of the region is saturated: bright cloud looks alike",
    "blob_off_glare": "{distance_px:.0f} px from the middle of the glare",
    "blob_elongated": "too elongated for the sun: its axes differ by {ellipticity:.2f} of the larger one",
    "blob_wide": "too large for the sun: its radius is {radius:.2f} of the image's smaller side",
    "blob_not_alone": "other regions are as bright: {area:.1%} of the image (of the square of its smaller side)",
    "blob_one_sided": "rim round in only {share:.2f} of the directions",
    "blob_uneven": "rim uneven by {scatter:.3f} of its radius",
    "blob_centre_uncertain": "centre known to {sigma_px:.1f} px only",
    "stars_matched": (
        "{n} stars; {explained:.2f} of the bright detections are stars, {found:.2f} of the bright stars are detected"
    ),
    "stars_prediction_uncertain": "pixels are predicted to {sigma_px:.1f} px: chance would match as many stars",
    "stars_few": "{n} stars found, {limit} needed ({detected} detections)",
    "stars_not_explained": "only {share:.2f} of the bright detections are predicted stars, {limit} needed",
    "stars_not_found": (
        "only {share:.2f} of the predicted bright stars are detected where the sky is clear, {limit} needed"
    ),
    "stars_one_sided": "{gap_deg:.0f} degrees of azimuth without a star, {limit:.0f} allowed",
    "stars_brightness": (
        "brightness of detections and stars differs: correlation {correlation:.2f}, {limit:.2f} needed"
    ),
    "stars_scattered": "the stars scatter by {scatter_px:.2f} px within a search of {radius_px:.1f} px",
    "moon_found": "the moon, reduced chi² {chi2:.2f}, sigma {sigma_px:.3f} px",
    "moon_hazy": "the sky beside the moon has {haze:.3f} of its light: haze",
    "moon_thin": "{lit:.3f} of the moon's disc is lit, {limit} needed",
    "moon_not_found": "no moon within four times {sigma_px:.1f} px of its predicted place",
    "moon_saturated": "{n} pixels of the moon are saturated",
    "moon_displaced": "{distance_px:.1f} px from the predicted place, {limit_px:.1f} allowed",
    "moon_in_cloud": "the sky beside the moon has {haze:.2f} of its light, {limit} allowed: cloud",
    "moon_other_shape": "not the shape of the moon at this phase: misfit {misfit:.1f}, {limit:.1f} allowed",
    "moon_poor_fit": "residuals {residual:.3f} of the moon's level, sigma {sigma_px:.2f} px",
    "sun_elsewhere": "not where it should be",
    "rows_repeated": (
        "the disc is that of the image of {time}, pixel by pixel: lost packets were replaced by those of another frame"
    ),
    "frame_repeated": "the camera delivered the image of {time} again",
    "file_unreadable": "{error}",
    "sighting_superseded": "another method's sighting of the same image is accepted",
    "star_not_named_again": "not named when its image was looked at again",
    "sighting_ambiguous": "ambiguous: the camera moved between {earliest} and then",
    "camera_had_moved": "the camera had moved",
    "sighting_imported": "imported from {file}",
}
"""What the service wrote of each code until this revision."""

_FORMER = {
    "bracket_mean": "mean of {frames} frames, chi² {chi2:.1f} for {freedom}",
    "disc_uneven": "uneven brightness, worth {uneven_px:.2f} px (chi² {chi2:.0f} for 4)",
    "disc_foreign_rows": (
        "rows of another image (chi² {rows:.0f} for 2, {columns:.0f} in columns): packets were sent again "
        "wrongly, or an edge as straight as a row covers the sun"
    ),
    "bracket_covered": "another frame of the bracket",
    "bracket_inconsistent": (
        "the frames of the bracket are inconsistent: mean of {frames} frames, chi² {chi2:.1f} for {freedom}"
    ),
    "stack_mean": "mean of {frames} exposures, chi² {chi2:.1f} a degree of freedom",
    "blob_edged": "a white patch or a lamp: {near:.2f} and {far:.2f} of its level beside it",
    "blob_flat": "it does not stand out: {near:.2f} and {far:.2f} of its level beside it",
    "blob_not_clipped": "only {flat:.2f} of it is saturated: bright cloud may look so",
    "blob_off_glare": "it is {distance_px:.0f} px off the middle of the glare",
    "blob_elongated": "it is too elongated for a sun: its axes differ by {ellipticity:.2f} of the larger one",
    "blob_wide": "it is too wide for a sun: its radius is {radius:.2f} of the image's smaller side",
    "blob_not_alone": "it is not alone: elsewhere {area:.4f} of the smaller side's square is as light",
    "blob_one_sided": "its rim is round in only {share:.2f} of the directions",
    "blob_uneven": "its rim is uneven by {scatter:.3f} of its radius",
    "blob_centre_uncertain": "its centre is known to {sigma_px:.1f} px only",
    "stars_one_sided": "no star over {gap_deg:.0f} degrees of azimuth, {limit:.0f} allowed",
    "stars_brightness": (
        "the detections' brightness is not the stars': correlation {correlation:.2f}, {limit:.2f} asked"
    ),
    "moon_other_shape": "a light that is no moon of this phase: {misfit:.1f} of {limit:.1f} allowed",
    "rows_repeated": "the disc is that of the image of {time}, pixel by pixel: packets were sent again wrongly",
    "sun_elsewhere": "not at its predicted position",
}
"""What version 0.3.0 wrote of some of them."""

_SINCE: dict[str, dict[str, float | None]] = {
    "disc_uneven": {"limit_px": 0.03, "limit_chi2": 16.0},
    "image_saturated": {"level": None, "limit": 0.98},
    "blob_one_sided": {"limit": 0.5},
}
"""Data that sentences have from this revision on: the limits then in force, and a level that was not stated."""

_ANY_TEXT = "file_unreadable"
"""Its sentence is whatever went wrong: of none it is known that it is this code's."""
_BEFORE = {"saturated_left_out": ", "}
_AFTER = {"bracket_covered": ": ", "sun_elsewhere": ": "}
_TEXTS = {"earliest", "error", "file", "places", "time"}
"""Values that are no numbers."""
_ROWS = 20_000
"""So many sightings are read at once."""


def upgrade() -> None:
    """Write the findings of sentences that are surely of known codes; others stay, and are read as sentences."""
    _rewrite(_as_findings)


def downgrade() -> None:
    """Write the sentences."""
    _rewrite(_as_sentence)


def _rewrite(convert: Callable[[str], str | None]) -> None:
    """Replace the reasons of the sightings; None leaves one as it is."""
    connection, last = op.get_bind(), 0
    told = sa.text("SELECT id, time, reason FROM sun_point WHERE id > :last AND reason <> '' ORDER BY id LIMIT :rows")
    change = sa.text("UPDATE sun_point SET reason = :reason WHERE id = :id AND time = :time")
    with _unsent(connection):
        while rows := connection.execute(told, {"last": last, "rows": _ROWS}).all():
            last = rows[-1].id
            new = [(row, convert(row.reason)) for row in rows if isinstance(row.reason, str)]
            changes = [{"id": row.id, "time": row.time, "reason": reason} for row, reason in new if reason is not None]
            if changes:
                connection.execute(change, changes)


@contextmanager
def _unsent(connection: sa.Connection) -> Iterator[None]:
    """Queue no rows for a hub: its own are migrated there."""
    triggers: list[Any] = []
    if connection.dialect.name == "sqlite":
        named = "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' AND name = 'outbox_sun_point_update'"
        triggers = [*connection.execute(sa.text(named)).all()]
    for name, _ in triggers:
        connection.exec_driver_sql(f'DROP TRIGGER "{name}"')
    yield
    for _, sql in triggers:
        connection.exec_driver_sql(sql)


@lru_cache(_ROWS)
def _as_findings(sentence: str) -> str | None:
    found = _found(sentence)
    if not found:
        return None
    return json.dumps([{"code": code, "data": data} for code, data in found], separators=(",", ":"))


def _found(sentence: str) -> list[Found]:
    """Return the findings of a sentence; none where not all of it is surely of known codes."""
    whole = _of_one(sentence)
    if whole:
        return [whole]
    for join in re.finditer("; |: |, ", sentence):
        first = _of_one(sentence[: join.start()])
        rest = _found(sentence[join.end() :]) if first else []
        if first and rest and join.group() == _BEFORE.get(rest[0][0], _AFTER.get(first[0], "; ")):
            return [first, *rest]
    return []


def _of_one(text: str) -> Found | None:
    for code, sentence, pattern in _patterns():
        match = pattern.fullmatch(text)
        data = {name: _value(value) for name, value in match.groupdict().items()} if match else {}
        if match and _text(sentence, data) == text:
            return code, data | _SINCE.get(code, {})
    return None


@cache
def _patterns() -> list[tuple[str, str, re.Pattern[str]]]:
    known = (*_SENTENCES.items(), *_FORMER.items())
    return [(code, sentence, _pattern(sentence)) for code, sentence in known if code != _ANY_TEXT]


def _pattern(sentence: str) -> re.Pattern[str]:
    parts = string.Formatter().parse(sentence)
    values = (
        (re.escape(literal), name and f"(?P<{name}>{'.+' if name in _TEXTS else '[-+.0-9e%]+'})")
        for literal, name, _, _ in parts
    )
    return re.compile("".join(literal + (value or "") for literal, value in values))


def _value(text: str) -> float | int | str:
    for read in (int, float, lambda share: float(share.removesuffix("%")) / 100.0):
        try:
            return read(text)
        except ValueError:
            continue
    return text


def _text(sentence: str, data: Mapping[str, Any]) -> str | None:
    try:
        return sentence.format_map({name: float("nan") if value is None else value for name, value in data.items()})
    except (KeyError, ValueError, TypeError):
        return None


def _as_sentence(stored: str) -> str | None:
    """Return the sentence of findings; None of what is a sentence still."""
    try:
        found = [(str(one["code"]), dict(one["data"])) for one in json.loads(stored)]
    except (ValueError, TypeError, KeyError):
        return None
    text, after = "", ""
    for code, data in found:
        said = _text(_SENTENCES[code], data) if code in _SENTENCES else None
        text += (text and _BEFORE.get(code, after)) + (said or str(data.get("text", f"{code} {data}")))
        after = _AFTER.get(code, "; ")
    return text
