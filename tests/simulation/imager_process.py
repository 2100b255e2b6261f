"""Runs a simulated imager until SIGTERM. Arguments: options in JSON, the start in ISO 8601, the truth's file."""

from __future__ import annotations

import json
import signal
import sys
import threading
from datetime import datetime
from pathlib import Path

from sunarc.simulation import ImagerOptions, run_imager

stop = threading.Event()
signal.signal(signal.SIGTERM, lambda *_: stop.set())
keywords, start, truth = sys.argv[1:]
run_imager(ImagerOptions(**json.loads(keywords), start=datetime.fromisoformat(start), truth=Path(truth)), stop)
