from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from tests.fixtures.finding_codes import codes

from sunarc.common.errors import InputError, NotFoundError
from sunarc.common.findings import Finding
from sunarc.imager.archive.archive import Archive

MAY = datetime(2013, 5, 1, tzinfo=UTC)
SIMULATED = {"code": "simulated_camera", "data": {}}


def document(calibration_id: str, *, day: int = 0, accepted: bool = True, **changes: Any) -> dict[str, Any]:  # noqa: ANN401 - JSON
    moment = (MAY + timedelta(days=day)).isoformat().replace("+00:00", "Z")
    return {
        "schema": "sunarc.calibration/2",
        "id": calibration_id,
        "camera": "roof",
        "state": "candidate",
        "method": "robust",
        "created_at": moment,
        "valid_from": moment,
        "valid_until": None,
        "pose_epoch": "roof-1",
        "verdict": {"accepted": accepted, "reasons": ["held-out days agree"], "findings": [SIMULATED]},
        **changes,
    }


def served(archive: Archive, day: float) -> str | None:
    record = archive.calibrations.current("roof", at=MAY + timedelta(days=day))
    return None if record is None else record.id


def test_a_candidate_is_kept_and_not_served(archive: Archive) -> None:
    record = archive.calibrations.add(document("a"), parent=None)
    assert record.state == "candidate"
    assert archive.calibrations.current("roof") is None
    assert archive.calibrations.get("a") == record
    assert record.document["verdict"]["findings"] == [SIMULATED]


def test_a_refused_candidate_is_kept_with_its_reasons(archive: Archive) -> None:
    archive.calibrations.add(document("a", accepted=False))
    assert [codes(r.findings) for r in archive.calibrations.find("roof", state="refused")] == [["simulated_camera"]]
    assert archive.calibrations.current("roof") is None


def test_activation_hands_over_without_a_gap_or_an_overlap(archive: Archive) -> None:
    for day, calibration_id in enumerate("abc"):
        archive.calibrations.add(document(calibration_id, day=10 * day), parent=None)
        archive.calibrations.activate(calibration_id)
    assert [served(archive, day) for day in (-1, 0, 9.99, 10, 19.99, 20, 1000)] == [None, *"aabbcc"]
    states = {record.id: (record.state, record.valid_until) for record in archive.calibrations.find("roof")}
    assert states == {
        "a": ("retired", MAY + timedelta(days=10)),
        "b": ("retired", MAY + timedelta(days=20)),
        "c": ("current", None),
    }


def test_the_document_says_what_the_archive_decided(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.add(document("b", day=10))
    activated = archive.calibrations.activate("a")
    assert activated == archive.calibrations.get("a") == archive.calibrations.current("roof")
    assert activated.document["state"] == "current"
    archive.calibrations.activate("b", at=MAY + timedelta(days=10, microseconds=1))
    retired = archive.calibrations.get("a").document
    assert (retired["state"], retired["valid_until"]) == ("retired", "2013-05-11T00:00:00.000001Z")
    assert archive.calibrations.get("b").document["valid_from"] == "2013-05-11T00:00:00.000001Z"


def test_a_calibration_from_further_back_takes_over_from_there(archive: Archive) -> None:
    for day, calibration_id in enumerate("ab"):
        archive.calibrations.add(document(calibration_id, day=10 * day))
        archive.calibrations.activate(calibration_id)
    archive.calibrations.add(document("c", day=20))
    archive.calibrations.activate("c", at=MAY + timedelta(days=5))
    assert [served(archive, day) for day in (0, 4.99, 5, 12, 30)] == [*"aaccc"]


def test_what_was_served_once_is_not_activated_again(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    with pytest.raises(InputError, check=lambda error: error.field == "id"):
        archive.calibrations.activate("a")


def test_an_unknown_calibration_changes_nothing(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    with pytest.raises(NotFoundError, check=lambda error: error.field == "id"):
        archive.calibrations.activate("b")
    assert served(archive, 1) == "a"


def test_retiring_leaves_nothing_served_from_then_on(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    archive.calibrations.activate("a")
    assert archive.calibrations.retire("a", at=MAY + timedelta(days=3)).state == "retired"
    assert archive.calibrations.current("roof") is None
    assert [served(archive, day) for day in (2, 3)] == ["a", None]
    with pytest.raises(InputError, match="is retired"):
        archive.calibrations.retire("a", at=MAY)


def test_a_candidate_may_be_refused_later(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    refused = archive.calibrations.refuse("a", findings=(Finding("no_change", {"limit": 0.1}),))
    assert (refused.state, refused.accepted) == ("refused", False)
    assert refused.document["verdict"]["findings"] == [{"code": "no_change", "data": {"limit": 0.1}}]
    assert refused.document["verdict"]["accepted"] is False
    with pytest.raises(InputError, match="is refused"):
        archive.calibrations.refuse("a", findings=())


def test_an_id_is_given_once(archive: Archive) -> None:
    archive.calibrations.add(document("a"))
    with pytest.raises(InputError, check=lambda error: error.field == "id"):
        archive.calibrations.add(document("a"))


@pytest.mark.parametrize(
    "broken", [{"verdict": {}}, {"created_at": "yesterday"}, {"valid_from": None}, {"verdict": None}]
)
def test_a_malformed_document_is_refused(archive: Archive, broken: dict[str, Any]) -> None:
    with pytest.raises(InputError, check=lambda error: error.field == "calibration document"):
        archive.calibrations.add(document("a", **broken))
    assert archive.calibrations.find("roof") == ()


def test_numbers_in_a_document_come_back_bit_for_bit(archive: Archive) -> None:
    numbers = [0.1 + 0.2, 601.32, 1e-300, -97.484856]
    archive.calibrations.add(document("a", model={"radial": numbers}))
    assert archive.calibrations.get("a").document["model"]["radial"] == numbers
