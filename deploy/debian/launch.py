"""Starts sunarc from the folder that holds it and all it needs."""

import os
import pwd
import sys
import tempfile
from pathlib import Path

HERE = Path("/usr/lib/sunarc")
CACHE = Path("/var/cache/sunarc")


def site() -> Path:
    """Return where the libraries are: an upgrade keeps the former ones in `before` until the new ones are whole."""
    whole = HERE / "before"
    return whole if whole.is_dir() else HERE / "site"


def kernels() -> Path:
    """Return where this user may keep compiled kernels; $HOME may be another user's (runuser, setpriv)."""
    home = Path(pwd.getpwuid(os.getuid()).pw_dir)
    if os.getuid() and os.access(CACHE, os.W_OK):
        return CACHE / "numba"
    if os.access(home, os.W_OK):
        return home / ".cache" / "sunarc" / "numba"
    return Path(tempfile.gettempdir()) / f"sunarc-{os.getuid()}"


sys.path.insert(0, str(site()))
sys.argv[0] = "sunarc"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")
if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = str(kernels())

if __name__ == "__main__":  # a solve's process reads this file, too, and must not start a second service
    from sunarc.__main__ import main  # which every version has, the former one in `before` too

    main()
