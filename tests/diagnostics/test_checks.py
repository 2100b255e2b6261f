from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.fixtures.command_line import Sunarc


def findings(sunarc: Sunarc, config: Path) -> tuple[int, dict[str, tuple[str, str]]]:
    answer = sunarc("check", "--config", str(config), "--json")
    return answer.code, {found["what"]: (found["outcome"], found["text"]) for found in json.loads(answer.out)}


@pytest.fixture
def config(tmp_path: Path) -> Path:
    path = tmp_path / "sunarc.toml"
    path.write_text(
        f'state = "{tmp_path}/state"\nsource = "replay"\n[site]\nlatitude = 36.6\nlongitude = -97.5\n'
        f'[replay]\nfolder = "{tmp_path}/absent"\n[api]\nport = 0\n'
    )
    return path


def test_each_thing_is_looked_at_and_what_fails_names_its_remedy(sunarc: Sunarc, config: Path) -> None:
    code, found = findings(sunarc, config)
    assert code == 1
    assert {what: outcome for what, (outcome, _) in found.items() if what not in {"clock", "camera"}} == {
        "settings": "ok",
        "versions": "ok",
        "backups": "ok",
        "state folder": "ok",
        "database": "ok",
        "port": "ok",
    }
    assert found["camera"][0] == "fail"
    assert str(config.parent / "absent") in found["camera"][1]


def test_a_port_in_use_and_a_state_folder_that_is_a_file_are_failures(sunarc: Sunarc, config: Path) -> None:
    (config.parent / "state").write_text("in the way")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        config.write_text(config.read_text().replace("port = 0", f"port = {taken.getsockname()[1]}"))
        _, found = findings(sunarc, config)
    assert found["port"][0] == "fail"
    assert found["state folder"][0] == "fail"
    assert "make it writable" in found["state folder"][1]


def test_a_running_service_is_asked_for_its_camera_which_nobody_else_can_have(sunarc: Sunarc, config: Path) -> None:
    lost = {"code": "camera_lost", "text": "no answer within 2.5 s"}
    status = {"camera_name": "imager", "health": "degraded", "camera": {"connected": False}, "reasons": [lost]}

    class Service(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.end_headers()
            self.wfile.write(json.dumps(status).encode())

        def log_message(self, *_: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Service) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        config.write_text(config.read_text().replace("port = 0", f"port = {server.server_port}"))
        _, found = findings(sunarc, config)
    assert found["port"] == ("ok", f"{server.server_port} at 127.0.0.1: the service answers, degraded")
    assert found["camera"][0] == "fail"
    assert "no answer within 2.5 s" in found["camera"][1]


def test_old_backups_are_a_warning(sunarc: Sunarc, config: Path) -> None:
    copy = config.parent / "state" / "backups" / "sunarc-20200101T020000Z.sqlite"
    copy.parent.mkdir(parents=True)
    copy.touch()
    assert findings(sunarc, config)[1]["backups"][0] == "ok"
    os.utime(copy, (1577844000.0, 1577844000.0))
    outcome, text = findings(sunarc, config)[1]["backups"]
    assert outcome == "warn"
    assert text.startswith("1, the newest of 2020-01-01 02:00 UTC; see systemctl status sunarc-backup.timer")


@pytest.mark.gige
def test_a_camera_address_that_does_not_answer_is_one_clear_finding(sunarc: Sunarc, config: Path) -> None:
    pytest.importorskip("gi", reason="python3-gi is not installed")
    text = config.read_text().replace('source = "replay"\n', "").split("[replay]")[0]
    config.write_text(f'{text}[camera]\naddress = "127.0.0.98"\n[api]\nport = 0\n')
    code, found = findings(sunarc, config)
    assert code == 1
    assert found["camera"][0] == "fail"
    assert "127.0.0.98" in found["camera"][1]


def test_a_missing_camera_section_is_named(sunarc: Sunarc, config: Path) -> None:
    config.write_text(config.read_text().replace('source = "replay"\n', ""))
    _, found = findings(sunarc, config)
    assert "setting camera is missing" in found["camera"][1]


@pytest.fixture
def forbidden(config: Path) -> Iterator[Path]:
    """Return settings whose state another user keeps to itself; who runs the tests is root, and could look at all."""
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        state, theirs = Path(folder) / "state", Path(folder) / "sunarc.toml"
        state.mkdir(mode=0o700)
        theirs.write_text(config.read_text().replace(f"{config.parent}/state", str(state)))
        os.seteuid(65534)
        yield theirs
        os.seteuid(0)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_what_another_user_keeps_to_itself_is_a_finding_or_a_line_and_no_traceback(
    sunarc: Sunarc, forbidden: Path
) -> None:
    _, found = findings(sunarc, forbidden)
    assert found["database"][0] == "fail"
    assert "sunarc.sqlite is not for this user" in found["database"][1]
    answer = sunarc("db", "check", "--state", str(forbidden.parent / "state"))
    assert answer.code == 3
    assert answer.err.endswith("sunarc.sqlite is not for this user; ask as root, or as the service's user\n")
    assert answer.err.count("\n") == 1
