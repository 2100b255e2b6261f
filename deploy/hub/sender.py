"""Sends the rows of a file to a hub; written from docs/feed.md alone, with nothing but Python's own library.

sender.py URL CAMERA TOKEN_FILE ROWS

ROWS has a line `{"kind": …, "data": …}` for each row and is only ever appended to: a row's number is that of its line.
Ends when the hub has all rows, or with the hub's words where it refuses them.
"""

import gzip
import http.client
import json
import sys
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from pathlib import Path
from typing import Any

REVISION = "0020"
AGAIN_LATER = {408, 429, 500, 502, 503, 504}


class Feed:
    """The feed of one camera."""

    def __init__(self, url: str, camera: str, token: str, installation: str) -> None:
        self.url = f"{url}/v1/cameras/{urllib.parse.quote(camera, safe='')}/feed"
        self.headers = {"authorization": f"Bearer {token}", "content-encoding": "gzip"}
        self.headers |= {"sunarc-installation": installation, "sunarc-revision": REVISION}

    def put(self, rows: list[dict[str, Any]], after: int) -> int:
        """Send rows, and return the number up to which the hub has them; again until it answers."""
        wait_s = 1.0
        while True:
            body = gzip.compress("".join(json.dumps(row) + "\n" for row in rows).encode())
            asked = urllib.request.Request(f"{self.url}?after={after}", body, self.headers, method="PUT")
            try:
                with urllib.request.urlopen(asked, timeout=60.0) as answer:
                    committed = json.loads(answer.read()).get("committed")
                    pause_s = float(answer.headers.get("retry-after", 0))
                if type(committed) is int and -1 <= committed < 2**63 and not (rows and committed == after):
                    time.sleep(pause_s)
                    return committed
                pause_s = wait_s  # no hub answers so
            except urllib.error.HTTPError as error:
                if error.code == 413 and len(rows) > 1:
                    rows = rows[: len(rows) // 2]
                    continue
                if error.code == 413 and rows[0]["data"] is not None:
                    rows = [rows[0] | {"data": None}]  # the hub notes that it was too large
                    continue
                if error.code not in AGAIN_LATER:
                    sys.exit(f"the hub refuses ({error.code}): {error.read().decode(errors='replace')}")
                pause_s = float(error.headers.get("retry-after", wait_s))
            except (OSError, http.client.HTTPException, ValueError, AttributeError):  # no answer, or no hub's
                pause_s = wait_s
            time.sleep(pause_s)
            wait_s = min(2.0 * wait_s, 60.0)


def main(url: str, camera: str, token_file: str, rows_file: str) -> None:
    """Send what the hub does not have."""
    mark = Path(f"{rows_file}.installation")  # whoever sends from another file is another installation
    if not mark.exists():
        mark.write_text(uuid.uuid4().hex)
    feed = Feed(url, camera, Path(token_file).read_text().strip(), mark.read_text())
    rows = [json.loads(line) for line in Path(rows_file).read_text().splitlines()]
    numbered = [{"seq": number} | row for number, row in enumerate(rows, 1)]
    committed = feed.put([], -1)
    while committed < len(rows):
        committed = feed.put(numbered[max(committed, 0) :][:1000], committed)
    if committed > len(rows):
        sys.exit("the hub has more than was sent: another sender uses this installation's id")


if __name__ == "__main__":
    main(*sys.argv[1:])
