"""The cause that took most files of an archive is the last line of an analysis."""

from __future__ import annotations

from sunarc.common.findings import Finding, choose_headline

AMBIGUOUS = Finding("file_time_ambiguous", {"first": "2013-06-05T12:30:00", "second": "2013-05-06T12:30:00"})


def test_the_cause_that_took_most_files_is_said_with_its_remedy_where_it_took_more_than_were_used() -> None:
    failures = [AMBIGUOUS] * 7 + [Finding("file_truncated")] * 3
    headline = choose_headline(failures, used=6)
    assert headline == {"code": "file_time_ambiguous", "n": 7, "reason": AMBIGUOUS.sentence}
    assert "--time-pattern" in AMBIGUOUS.sentence
    assert choose_headline(failures, used=7) is None
    assert choose_headline([], used=0) is None
