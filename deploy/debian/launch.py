"""Starts sunarc from the folder that holds it and all it needs."""

import os
import sys
from pathlib import Path

sys.path.insert(0, "/usr/lib/sunarc/site")
sys.argv[0] = "sunarc"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path("~/.cache/sunarc/numba").expanduser()))

if __name__ == "__main__":  # a solve's process reads this file, too, and must not start a second service
    from sunarc.__main__ import main

    main()
