"""`sunarc serve --role hub` as a process of its own, and the processor time of processes."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import urllib.request
from contextlib import suppress
from pathlib import Path

from sqlalchemy import URL
from tests.fixtures.ports import free_port
from tests.fleet.links import Network


class HubProcess:
    """A hub that can be killed and started again.

    Parameters
    ----------
    folder : for its settings and its log.
    store : its database.
    within : the network that it listens in; loopback unless given.
    settings : more of them, as TOML.
    """

    def __init__(self, folder: Path, store: URL, *, within: Network | None = None, settings: str = "") -> None:
        self.address = ("127.0.0.1" if within is None else within.host, free_port())
        self.log = folder / "hub.log"
        self._enter = [] if within is None else within.enter()
        self._config = folder / "hub.toml"
        address = store.render_as_string(hide_password=False)
        host, port = self.address
        self._config.write_text(f'store = "{address}"\n[api]\nhost = "{host}"\nport = {port}\n{settings}')
        self.start()

    @property
    def url(self) -> str:
        return f"http://{self.address[0]}:{self.address[1]}"

    def start(self) -> None:
        command = [sys.executable, "-m", "sunarc", "serve", "--role", "hub", "--config", str(self._config)]
        with self.log.open("ab") as log:
            self._process = subprocess.Popen([*self._enter, *command], stdout=log, stderr=log)

    def kill(self) -> None:
        self._process.send_signal(signal.SIGKILL)
        self._process.wait(10.0)

    def start_again_if_ended(self) -> None:
        """Start a hub that ended, as its unit does: one that starts while PostgreSQL is away gives up."""
        if self._process.poll() is not None:
            self.start()

    def stop(self) -> int:
        self._process.terminate()
        return self._process.wait(20.0)

    def require_running(self) -> None:
        code = self._process.poll()
        if code is not None:
            raise RuntimeError(f"the hub ended with {code}: {self.log.read_text()}")

    def ask(self, path: str) -> object:
        with urllib.request.urlopen(self.url + path, timeout=20.0) as answer:
            return json.loads(answer.read())

    def wait_until_it_answers(self) -> None:
        for _ in range(1200):
            with suppress(OSError):
                self.ask("/healthz")
                return
            self.require_running()
            threading.Event().wait(0.1)
        raise TimeoutError("the hub does not answer")

    def processor_s(self) -> float:
        return processor_s(self._process.pid)

    def memory_mib(self) -> int:
        """Return the largest resident memory that it has had, MiB."""
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return int(status.partition("VmHWM:")[2].split()[0]) // 1024


def processor_s(pid: int) -> float:
    """Return the processor time of a process and of its children that ended or run, s."""
    ticks = sum(map(int, _fields(pid)[11:15]))  # proc(5): utime, stime, and those of children that ended
    for other in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            found = _fields(int(other.name))
            ticks += sum(map(int, found[11:13])) if int(found[1]) == pid else 0
    return ticks / os.sysconf("SC_CLK_TCK")


def _fields(pid: int) -> list[str]:
    """Return the fields of a process's `stat` from its state on."""
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
