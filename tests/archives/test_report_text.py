"""Texts of messages in the report of a run."""

from __future__ import annotations

from sunarc.archives.report import write_prose


def test_commands_are_code_units_stay_with_their_numbers_and_nothing_is_markup() -> None:
    text = "see `sunarc points import <FILE>`: 0.3 px, 2.5° ± 0.3°, 31 MB & 5 %, one ` alone"
    assert write_prose(text) == (
        "see <code>sunarc points import &lt;FILE&gt;</code>: 0.3\u00a0px, 2.5°\u00a0±\u00a00.3°, 31\u00a0MB &amp; "
        "5\u00a0%, one ` alone"
    )
