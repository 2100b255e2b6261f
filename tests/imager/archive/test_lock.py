"""One service per state folder."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from sunarc.common.errors import OutsideError
from sunarc.imager.archive.database.state_folder import lock_holder, lock_state

HOLDER = """
import sys
from pathlib import Path
from sunarc.imager.archive.database.state_folder import lock_state
with lock_state(Path(sys.argv[1])):
    print("held", flush=True); sys.stdin.read()
"""


def test_a_second_process_is_refused_with_the_first_ones_id_until_that_is_killed(tmp_path: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", HOLDER, tmp_path], stdin=-1, stdout=-1, text=True) as first:
        assert first.stdout is not None
        assert first.stdout.readline() == "held\n"
        assert lock_holder(tmp_path) == first.pid
        with pytest.raises(OutsideError, match=rf"\b{first.pid}\b"), lock_state(tmp_path):
            pass
        first.send_signal(signal.SIGKILL)
        first.wait()
    assert (tmp_path / "lock").read_text() == f"{first.pid}\n"  # left behind, and no obstacle
    assert lock_holder(tmp_path) is None
    with lock_state(tmp_path):
        assert lock_holder(tmp_path) == os.getpid()
    assert lock_holder(tmp_path) is None


def test_a_folder_without_a_lock_file_is_held_by_nobody(tmp_path: Path) -> None:
    assert lock_holder(tmp_path) is None
    assert list(tmp_path.iterdir()) == []


def test_a_lock_file_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(OutsideError, match=str(tmp_path / "missing")), lock_state(tmp_path / "missing"):
        pass


def test_a_lock_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept\n")
    (tmp_path / "lock").symlink_to(tmp_path / "file")
    with pytest.raises(OutsideError, match="lock"), lock_state(tmp_path):
        pass
    assert lock_holder(tmp_path) is None
    assert (tmp_path / "file").read_text() == "kept\n"


def test_a_lock_that_is_a_pipe_holds_nobody_up(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "lock")
    assert lock_holder(tmp_path) is None
