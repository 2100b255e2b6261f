"""Who is told what: the wiring of imagers and hubs."""

from __future__ import annotations

from datetime import timedelta
from pathlib import Path

from tests.fixtures.archive import make_empty, new_archive
from tests.fixtures.fleet import NOW, feed, new_imager, sighting

from sunarc.hub.archive import open_hub_archive
from sunarc.hub.serving import fleet_states
from sunarc.imager.app.pushing import imager_states, push_workers
from sunarc.imager.archive.archive import CameraArchive
from sunarc.imager.archive.feed_rows import Refusal
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.status import Reason, StatusRegistry
from sunarc.imager.workers.options import PushOptions
from sunarc.sky.site import Site

HOOK = "http://127.0.0.1:9/hook"


def test_without_receivers_there_is_no_worker_and_with_them_one_for_each(
    tmp_path: Path, clock: VirtualClock, board: StatusRegistry
) -> None:
    with new_archive(tmp_path) as archive:

        def names(options: PushOptions) -> list[str]:
            found = push_workers(
                options, archive=archive, states=dict, clock=clock, board=board, client="roof", every_s=1.0
            )
            return [worker.name for worker in found]

        before = archive.revision()
        assert names(PushOptions()) == []
        assert archive.revision() == before
        archive.notices.name_sinks(["gone"])
        assert names(PushOptions()) == []
        assert archive.notices.sink_states() == {}
        secret = tmp_path / "secret"
        options = PushOptions(mqtt="mqtt://127.0.0.1:9", webhooks=(HOOK,), webhook_secret_file=secret)
        # the secret is not there: that is the receiver's own matter, and a condition
        notices, hook, mqtt = names(options)
        assert (notices, mqtt) == ("notices", "push_mqtt")
        assert hook.startswith("push_webhook_127.0.0.1_")


def test_an_imager_tells_its_conditions_with_their_texts(tmp_path: Path, board: StatusRegistry) -> None:
    board.set_condition("dusty", Reason(code="dusty", severity="degraded", text="it is", remedy="wipe"))
    with new_archive(tmp_path) as archive:
        camera = CameraArchive(archive, name="roof", site=Site(latitude=36.6, longitude=-97.5))
        state = imager_states(camera, board)()["roof"]
    assert (state.health, state.calibration) == ("degraded", None)
    assert state.conditions["dusty"]["text"] == "it is"
    assert state.conditions["dusty"]["since"] == "2026-05-01T12:00:00Z"


def test_a_hub_tells_what_imagers_reported_and_what_it_finds(tmp_path: Path) -> None:
    make_empty(tmp_path / "hub.sqlite")
    with new_imager(tmp_path) as imager, open_hub_archive(tmp_path / "hub.sqlite") as hub:
        hub.feeds.add_token("mast", "digest", now=NOW, former_until=NOW)  # registered, and silent from the beginning
        imager.sightings.add([sighting(1)])
        imager.outbox.queue_status({"health": "degraded", "conditions": ["camera_lost"]})
        feed(imager, hub)
        now = [NOW]
        states = fleet_states(hub, lambda: now[0])
        assert {name: list(state.conditions) for name, state in states().items()} == {
            "roof": ["camera_lost", "no_sighting", "uncalibrated"]
        }
        assert states()["roof"].health == "degraded"
        refusal = Refusal(reason="forged_token", text="it is")
        hub.feeds.refuse(camera="roof", installation="x", refusal=refusal, now=NOW)
        now[0] += timedelta(hours=1)
        assert set(states()["roof"].conditions) == {
            "camera_lost",
            "silent",
            "no_sighting",
            "quarantine",
            "uncalibrated",
        }
        assert states()["roof"].health == "silent"
