"""The service behind nginx and Caddy, configured as docs/operating/install.md has it. Over real sockets, with TLS."""

from __future__ import annotations

import re
import shutil
import socket
import ssl
import subprocess
import textwrap
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from sunarc.imager.app.serving import new_server
from sunarc.imager.runtime.clock import SystemClock
from sunarc.imager.runtime.host import listen
from sunarc.imager.runtime.supervisor import Heartbeat
from sunarc.imager.web.options import ApiOptions

if TYPE_CHECKING:
    from starlette.types import Receive, Scope, Send
    from tests.fixtures.served import Make

PAGE = Path(__file__).parents[3] / "docs/operating/install.md"
NAME = "imager.example"
PATIENCE_S = 60.0


def configuration(of: str) -> str:
    """Return a proxy's configuration on the page."""
    section = PAGE.read_text("utf-8").partition("## Behind a reverse proxy")[2].partition("\n## ")[0]
    blocks = re.findall(r"(?:^ {4}.*\n)+", section, re.MULTILINE)
    (block,) = [textwrap.dedent(one) for one in blocks if of in one]
    return block


def program(name: str, folder: Path) -> str:
    """Return a program: the host's, or that of its Debian package, which is unpacked and not installed."""
    installed = shutil.which(name) or shutil.which(name, path="/usr/sbin")
    if installed:
        return installed
    try:
        subprocess.run(
            ["apt-get", "download", name], cwd=folder, check=True, capture_output=True, timeout=PATIENCE_S, text=True
        )
        (package,) = folder.glob(f"{name}_*.deb")
        subprocess.run(["dpkg", "-x", str(package), str(folder)], check=True, capture_output=True)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        pytest.skip(f"{name} is not installed, and apt has no package of it: {error}")
    return str(next(one for one in (folder / "usr").glob(f"*bin/{name}")))


def certificate(folder: Path) -> tuple[Path, Path]:
    """Return a certificate of the name, signed by itself, and its key."""
    file, key = folder / "certificate.pem", folder / "key.pem"
    of_kind = ["req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2"]
    named = ["-subj", f"/CN={NAME}", "-addext", f"subjectAltName=DNS:{NAME}"]
    command = ["openssl", *of_kind, *named, "-keyout", str(key), "-out", str(file)]
    subprocess.run(command, check=True, capture_output=True)
    return file, key


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


def nginx(folder: Path, *, port: int, service: int) -> list[str]:
    file, key = certificate(folder)
    server = configuration("proxy_pass")
    for before, after in (
        ("listen 443 ssl", f"listen 127.0.0.1:{port} ssl"),
        ("/etc/ssl/imager.pem", str(file)),
        ("/etc/ssl/private/imager.key", str(key)),
        ("127.0.0.1:8080", f"127.0.0.1:{service}"),
    ):
        assert server.count(before) == 1
        server = server.replace(before, after)
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    places = "".join(f"{kind}_temp_path {folder}/{kind};\n" for kind in kinds)
    text = f"user root;\npid {folder}/pid;\nevents {{}}\nhttp {{\naccess_log off;\n{places}{server}}}\n"
    (folder / "nginx.conf").write_text(text)
    settings = "daemon off; error_log stderr;"
    return [
        program("nginx", folder),
        "-p",
        str(folder),
        "-e",
        "stderr",
        "-c",
        str(folder / "nginx.conf"),
        "-g",
        settings,
    ]


def caddy(folder: Path, *, port: int, service: int) -> list[str]:
    file, key = certificate(folder)
    text = configuration("reverse_proxy")
    for before, after in (
        (f"\n{NAME} {{", f"\n{NAME}:{port} {{\n    bind 127.0.0.1\n    tls {file} {key}"),
        ("127.0.0.1:8080", f"127.0.0.1:{service}"),
        ("{\n    servers", "{\n    admin off\n    auto_https off\n    servers"),
    ):
        assert text.count(before) == 1
        text = text.replace(before, after)
    (folder / "Caddyfile").write_text(text)
    return [program("caddy", folder), "run", "--adapter", "caddyfile", "--config", str(folder / "Caddyfile")]


class Seen:
    """An application before another, which keeps who asked by which scheme."""

    def __init__(self, app: Any) -> None:  # noqa: ANN401 - of ASGI
        self.app = app
        self.clients: list[tuple[str, str]] = []

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "http":
            self.clients.append((scope["client"][0], scope["scheme"]))
        await self.app(scope, receive, send)


@contextmanager
def served(app: Any) -> Iterator[int]:  # noqa: ANN401 - of ASGI
    with listen("127.0.0.1", 0) as listening:
        heartbeat = Heartbeat(SystemClock().monotonic)
        server = new_server(app, ApiOptions(), on_started=lambda: None, heartbeat=heartbeat)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield listening.getsockname()[1]
        finally:
            server.should_exit = True
            thread.join()


@contextmanager
def running(command: list[str], port: int, folder: Path) -> Iterator[None]:
    environment = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "HOME": str(folder)}
    log = folder / "log"
    with log.open("wb") as out, subprocess.Popen(command, env=environment, stdout=out, stderr=out) as process:
        try:
            waited = threading.Event()
            for _ in range(int(PATIENCE_S / 0.1)):
                assert process.poll() is None, log.read_text("utf-8", "replace")
                with socket.socket() as probe:
                    if probe.connect_ex(("127.0.0.1", port)) == 0:
                        break
                waited.wait(0.1)
            yield
        finally:
            process.terminate()


@pytest.mark.parametrize("proxy", [nginx, caddy], ids=["nginx", "caddy"])
def test_the_service_is_served_behind_a_proxy(make: Make, tmp_path: Path, proxy: Callable[..., list[str]]) -> None:
    made = make(history="small", allowed_hosts=(NAME,))
    seen = Seen(made.app)
    port = free_port()
    trust = ssl.create_default_context()
    trust.check_hostname, trust.verify_mode = False, ssl.CERT_NONE
    with ExitStack() as stack:
        service = stack.enter_context(served(seen))
        stack.enter_context(running(proxy(tmp_path, port=port, service=service), port, tmp_path))
        client = stack.enter_context(httpx.Client(verify=trust, timeout=PATIENCE_S, headers={"host": NAME}))

        def ask(method: str, path: str, **how: Any) -> httpx.Response:  # noqa: ANN401 - of httpx
            url = f"https://127.0.0.1:{port}{path}"
            return client.request(method, url, extensions={"sni_hostname": NAME}, **how)

        forged = {"x-forwarded-for": "6.6.6.6", "x-forwarded-proto": "http"}
        assert ask("GET", "/v1/status", headers=forged).status_code == 200
        assert seen.clients[-1] == ("127.0.0.1", "https")
        answer = ask("POST", "/v1/back-project", json={"pixels": [[60.0, 58.0]]})
        assert (answer.status_code, answer.json()["inside"]) == (200, [True])
        whole = ask("GET", "/v1/back-projection-map?format=npz")
        tag = whole.headers["etag"]
        part = ask("GET", "/v1/back-projection-map?format=npz", headers={"range": "bytes=10-99", "if-range": tag})
        assert (part.status_code, part.content) == (206, whole.content[10:100])
        assert (
            ask(
                "GET", "/v1/calibration", headers={"if-none-match": ask("GET", "/v1/calibration").headers["etag"]}
            ).status_code
            == 304
        )
        problem = ask("GET", "/v1/sun?at=yesterday")
        assert (problem.status_code, problem.json()["errors"][0]["field"]) == (422, "at")
        with client.stream(
            "GET", f"https://127.0.0.1:{port}/v1/events/stream", extensions={"sni_hostname": NAME}
        ) as stream:
            assert next(stream.iter_lines()).startswith(("event:", "id:", "retry:", ":"))
