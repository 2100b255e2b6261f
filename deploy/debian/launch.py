"""Starts sunarc from the folder that holds it and all it needs."""

import os
import sys
from pathlib import Path

HERE = Path("/usr/lib/sunarc")


def site() -> Path:
    """Return where the libraries are: an upgrade keeps the former ones in `before` until the new ones are whole."""
    whole = HERE / "before"
    return whole if whole.is_dir() else HERE / "site"


sys.path.insert(0, str(site()))
sys.argv[0] = "sunarc"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

if __name__ == "__main__":  # a solve's process reads this file, too, and must not start a second service
    from sunarc.__main__ import main  # which every version has, the former one in `before` too

    main()
