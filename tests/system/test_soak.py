"""The soak's short form: every kind of fault once, over a real GigE Vision connection on loopback."""

from __future__ import annotations

import ctypes
import importlib.util

import pytest
from tests.release.soak import FAULTS, soak

# tests/lab/simulation/test_over_the_wire.py has each fault by itself
pytestmark = [pytest.mark.gige, pytest.mark.release, pytest.mark.timeout(240)]


def test_no_frame_is_kept_under_another_s_exposure_whatever_happens_to_the_camera() -> None:
    if importlib.util.find_spec("gi") is None:
        pytest.skip("no GigE Vision: this environment has no gi (apt-get install python3-gi, then tests/run)")
    try:
        ctypes.CDLL("libaravis-0.8.so.0")
    except OSError:
        pytest.skip("no GigE Vision: Aravis is missing (apt-get install gir1.2-aravis-0.8)")
    outcome = soak(cycles=60, seed=5, cadence_s=0.8, fault_every=3)
    assert outcome.wrong == []
    assert set(outcome.faults) == set(FAULTS)
    assert outcome.frames > 60
    # a busy machine may stall for some cycles; the long form is run on one that does not
    assert len(outcome.incomplete_undisturbed) <= 3 + outcome.undisturbed // 5
    assert max(second for each in outcome.recoveries_s.values() for second in each) < 30.0
    assert outcome.after["resident_mb"] < outcome.before["resident_mb"] + 30.0
    # what one opening leaked would be there some ten times; a stream that is just ending has a thread and some sockets
    assert outcome.after["threads"] <= outcome.before["threads"] + 3
    assert outcome.after["files"] <= outcome.before["files"] + 6
