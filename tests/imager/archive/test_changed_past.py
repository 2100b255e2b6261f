"""A calibration that answers for times that another pose answered for is an event; provisional poses are set apart."""

from __future__ import annotations

from datetime import timedelta

from sunarc.imager.archive.archive import Archive
from sunarc.imager.archive.values import Event

from .test_calibrations import MAY, document


def serve(archive: Archive, name: str, *, made: float, since: float, pose_epoch: str) -> None:
    created = (MAY + timedelta(days=made)).isoformat().replace("+00:00", "Z")
    archive.calibrations.add(document(name, pose_epoch=pose_epoch, created_at=created))
    archive.calibrations.activate(name, at=MAY + timedelta(days=since))


def reported(archive: Archive) -> list[Event]:
    return list(reversed(archive.events.find("roof", kind="past_answers_changed")))


def moved(archive: Archive) -> None:
    serve(archive, "a", made=0.0, since=0.0, pose_epoch="roof-1")
    archive.epochs.open("roof", at=MAY + timedelta(days=20), reason="bump")


def test_a_pose_after_a_move_changes_the_answers_since_it_and_says_so_once(archive: Archive) -> None:
    moved(archive)
    for n, hours in enumerate((1.0, 2.0, 4.0)):
        made = 20.0 + hours / 24.0
        serve(archive, f"20130521T0{n}0000Z-pose{n}", made=made, since=20.0, pose_epoch="roof-2")
    (event,) = reported(archive)
    assert (event.severity, event.time) == ("info", MAY + timedelta(days=20, hours=1))
    assert event.details == {
        "calibration": "20130521T000000Z-pose0",
        "before": "a",
        "since": "2013-05-21T00:00:00Z",
        "until": "2013-05-21T01:00:00Z",
    }


def test_the_fit_that_replaces_a_provisional_pose_changes_the_past(archive: Archive) -> None:
    moved(archive)
    serve(archive, "20130521T010000Z-pose4", made=20.1, since=20.0, pose_epoch="roof-2")
    serve(archive, "b", made=20.9, since=20.0, pose_epoch="roof-2")
    assert [event.details["before"] for event in reported(archive)] == ["a", "20130521T010000Z-pose4"]
    assert reported(archive)[1].details["calibration"] == "b"


def test_a_refit_of_the_same_pose_that_answers_from_now_on_changes_nothing(archive: Archive) -> None:
    serve(archive, "a", made=0.0, since=0.0, pose_epoch="roof-1")
    serve(archive, "b", made=10.0, since=10.0, pose_epoch="roof-1")
    assert reported(archive) == []


def test_the_first_calibration_changes_no_answer(archive: Archive) -> None:
    serve(archive, "a", made=3.0, since=0.0, pose_epoch="roof-1")
    assert reported(archive) == []


def test_provisional_poses_are_listed_on_demand_and_while_one_is_current(archive: Archive) -> None:
    moved(archive)
    serve(archive, "20130521T010000Z-pose4", made=20.1, since=20.0, pose_epoch="roof-2")
    serve(archive, "20130521T020000Z-pose6", made=20.2, since=20.0, pose_epoch="roof-2")

    def listed(*, provisional: bool) -> list[str]:
        return [one.id for one in archive.calibrations.find("roof", provisional=provisional)]

    assert listed(provisional=True) == ["20130521T020000Z-pose6", "20130521T010000Z-pose4", "a"]
    assert listed(provisional=False) == ["20130521T020000Z-pose6", "a"]
    serve(archive, "b", made=20.9, since=20.0, pose_epoch="roof-2")
    assert listed(provisional=False) == ["b", "a"]
