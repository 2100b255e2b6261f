"""Starts sunarc from the folder that holds it and all it needs."""

import hashlib
import os
import sys
from pathlib import Path

HERE = Path("/usr/lib/sunarc")


def site() -> Path:
    """Return where the libraries are: an upgrade keeps the former ones in `before` until the new ones are whole."""
    whole = HERE / "before"
    return whole if whole.is_dir() else HERE / "site"


def damaged(libraries: Path) -> Path | None:
    """Return the compiled module where it is not what was packaged: with one bit changed it may die, or be wrong."""
    for stated in libraries.glob("sunarc/_kernels*.so.sha256"):
        module = stated.with_suffix("")
        packaged = stated.read_text(errors="replace").strip()
        if not module.is_file() or hashlib.sha256(module.read_bytes()).hexdigest() != packaged:
            return module
    return None


sys.path.insert(0, str(site()))
sys.argv[0] = "sunarc"
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("OMP_NUM_THREADS", "1")

if __name__ == "__main__":  # a solve's process reads this file, too, and must not start a second service
    found = damaged(site())
    if found is not None:
        severe = "<2>" if "INVOCATION_ID" in os.environ else ""  # by systemd: of the journal
        remedy = "dpkg --verify sunarc lists what is; install the package again, and check the disk"
        print(f"{severe}sunarc: {found} is damaged; {remedy}", file=sys.stderr)
        sys.exit(3)
    from sunarc.__main__ import main  # which every version has, the former one in `before` too

    main()
