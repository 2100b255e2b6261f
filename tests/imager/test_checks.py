from __future__ import annotations

import gzip
import json
import os
import socket
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pytest
from tests.fixtures.archive import new_archive
from tests.fixtures.ports import free_port

from sunarc.imager import checks
from sunarc.imager.workers.push import webhook_name

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


def test_what_serve_demands_is_tried_and_what_is_off_is_not(
    sunarc: Sunarc, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = config.read_text()
    assert {"night", "hub", "mqtt", "api.token_file"}.isdisjoint(findings(sunarc, config)[1])
    token, short = config.parent / "token", config.parent / "short"
    token.write_text("0123456789abcdef")
    short.write_text("0123")
    closed, hook = free_port(), f"http://127.0.0.1:{free_port()}/hook"
    more = (
        f'token_file = "{token}"\nread_token_file = "{short}"\n[night]\nenabled = true\n'
        f'[hub]\nurl = "http://127.0.0.1:{closed}"\ntoken_file = "{token}"\n'
        f'[push]\nmqtt = "mqtt://127.0.0.1:{closed}"\nwebhooks = ["{hook}"]\nwebhook_secret_file = "{token}"\n'
    )
    config.write_text(text + more)
    _, found = findings(sunarc, config)
    outcomes = {what: found[what][0] for what in ("api.token_file", "api.read_token_file", "night", "hub", "mqtt")}
    # a receiver that does not answer does not hold the measurement up; a file or a library that is missing has to come
    assert outcomes == {
        "api.token_file": "ok",
        "api.read_token_file": "fail",
        "night": "ok",
        "hub": "warn",
        "mqtt": "warn",
    }
    assert found[webhook_name(hook)][0] == "warn"
    token.unlink()
    monkeypatch.setitem(sys.modules, "paho.mqtt.client", None)
    _, found = findings(sunarc, config)
    wrong = ("api.token_file", "hub", "mqtt", webhook_name(hook))
    assert {what: found[what][0] for what in wrong} == dict.fromkeys(wrong, "fail")
    printed = sunarc("check", "--config", str(config)).out
    assert "[mqtt]" in "".join(printed.split())  # of the remedy, and no markup of the table


def test_a_hub_that_refuses_the_token_is_a_failure_and_one_that_takes_it_gets_no_rows(
    sunarc: Sunarc, config: Path, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    with new_archive(state, name="imager") as archive:
        archive.outbox.enable()
        installation = archive.outbox.position().installation
    token = tmp_path / "token"
    token.write_text("0123456789abcdef")
    config.write_text(f'{config.read_text()}[hub]\nurl = "http://127.0.0.1:1"\ntoken_file = "{token}"\n')
    asked: list[tuple[str, str, bytes]] = []

    class Hub(BaseHTTPRequestHandler):
        def do_PUT(self) -> None:
            body = gzip.decompress(self.rfile.read(int(self.headers["content-length"])))
            asked.append((self.path, self.headers["sunarc-installation"], body))
            known = self.headers["authorization"] == "Bearer 0123456789abcdef"
            self.send_response(200 if known else 401)
            self.end_headers()
            self.wfile.write(b'{"committed": 7}' if known else b'{"detail": "no"}')

        def log_message(self, *_: object) -> None:
            """Say nothing."""

    with HTTPServer(("127.0.0.1", 0), Hub) as server:
        threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
        config.write_text(config.read_text().replace("127.0.0.1:1", f"127.0.0.1:{server.server_port}"))
        assert findings(sunarc, config)[1]["hub"][0] == "ok"
        token.write_text("another of enough")
        assert findings(sunarc, config)[1]["hub"][0] == "fail"
        server.shutdown()
    assert asked == [("/v1/cameras/imager/feed?after=-1", installation, b"")] * 2


def test_a_receiver_that_never_answers_holds_the_check_up_for_a_limited_time(
    sunarc: Sunarc, config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "_RECEIVER_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        config.write_text(f'{config.read_text()}[push]\nmqtt = "mqtt://127.0.0.1:{silent.getsockname()[1]}"\n')
        assert findings(sunarc, config)[1]["mqtt"][0] == "warn"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can become another user")
def test_root_looks_at_secrets_with_the_rights_of_the_services_user(sunarc: Sunarc, config: Path) -> None:
    with TemporaryDirectory() as folder:
        Path(folder).chmod(0o755)
        state, secret = Path(folder) / "state", Path(folder) / "secret"
        state.mkdir()
        os.chown(state, 65534, 65534)
        secret.write_text("0123456789abcdef")
        secret.chmod(0o600)
        text = config.read_text().replace(f"{config.parent}/state", str(state))
        config.write_text(f'{text}token_file = "{secret}"\n')
        assert findings(sunarc, config)[1]["api.token_file"][0] == "fail"
        os.chown(secret, 65534, 65534)
        assert findings(sunarc, config)[1]["api.token_file"][0] == "ok"
    assert (os.geteuid(), os.getegid()) == (0, 0)


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
