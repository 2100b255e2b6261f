"""Ask a served application whatever its OpenAPI document allows, and what it forbids, and check every answer.

    .venv/bin/python -m tests.imager.web.fuzz --examples 300

serves an archive with a history, hands its document to schemathesis with all checks, and ends with its exit code.
`--only PATH` asks one path alone; `--seed N` draws others. The camera is a small one: a map of a large one costs more
than a thousand other questions.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import uvicorn
from tests.fixtures.calibrations import SITE
from tests.fixtures.served import NOON, SMALL, TOKEN, fill, new_archive, write_image

from sunarc.imager.archive.values import Refit
from sunarc.imager.runtime.clock import VirtualClock
from sunarc.imager.runtime.host import listen
from sunarc.imager.runtime.status import StatusRegistry
from sunarc.imager.web.app import create_app
from sunarc.imager.web.options import ApiOptions

CONFIG = Path(__file__).with_name("schemathesis.toml")


def main() -> int:
    """Run schemathesis and return its exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--examples", type=int, default=300, help="drawn per route")
    parser.add_argument("--seed", type=int, default=1, help="of what is drawn")
    parser.add_argument("--only", metavar="PATH", help="one path alone, as in the document")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as address:
        return subprocess.run(command(address, options), check=False, cwd=folder, env=environment()).returncode


def command(address: str, options: argparse.Namespace) -> list[str]:
    """Return schemathesis's command line."""
    only = [] if options.only is None else ["--include-path", options.only]
    return [
        *(sys.executable, "-m", "schemathesis.cli", "--config-file", str(CONFIG), "run", f"{address}openapi.json"),
        *("--header", f"Authorization: Bearer {TOKEN}", "--checks", "all", "--continue-on-failure"),
        *("--max-examples", str(options.examples), "--seed", str(options.seed), "--warnings", "off", *only),
        # the largest remap takes 20 s of a busy host
        *("--request-timeout", "120", "--max-response-time", "120"),
    ]


def environment() -> dict[str, str]:
    """Return what schemathesis runs in."""
    return {**os.environ, "SCHEMATHESIS_HOOKS": str(Path(__file__).with_name("schemathesis_hooks.py"))}


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Serve an archive with a history on a free port; a refit that is asked for is written down."""
    archive = new_archive(folder / "filled.sqlite", SMALL)
    fill(archive, SMALL)
    image = write_image(folder)
    (folder / "token").write_text(TOKEN)
    count = iter(range(10**9))

    def request_refit(reason: str) -> Refit:
        return archive.refits.request(Refit(id=f"r{next(count)}", camera="roof", requested_at=NOON, reason=reason))

    app = create_app(
        archive=archive,
        camera="roof",
        site=SITE,
        status=StatusRegistry(version="0.1.0", started_at=NOON, monotonic=VirtualClock(NOON).monotonic).snapshot,
        request_refit=request_refit,
        frame_clock=lambda: NOON,
        latest_image=lambda: image,
        options=ApiOptions(token_file=folder / "token"),
    )
    app.openapi()  # on a busy host it is not made within the time that schemathesis waits for it
    with listen("127.0.0.1", 0) as listening:  # the service's own: its answers are not delayed
        listening.listen()
        server = uvicorn.Server(uvicorn.Config(app, log_level="warning", access_log=False))
        thread = Thread(target=server.run, kwargs={"sockets": [listening]})
        thread.start()
        try:
            yield f"http://127.0.0.1:{listening.getsockname()[1]}/"
        finally:
            server.should_exit = True
            thread.join()
            archive.close()


if __name__ == "__main__":
    sys.exit(main())
