"""What schemathesis loads beside its own: how OpenCV's files are read, and that a fault of its own ends a run.

A thread that dies takes the questions with it that it had not asked yet, and the run would be told as passed.
"""

from __future__ import annotations

import os
import threading

import yaml


def _end(fault: threading.ExceptHookArgs) -> None:
    threading.__excepthook__(fault)
    os._exit(70)


threading.excepthook = _end
for reader in (yaml.SafeLoader, yaml.CSafeLoader):
    reader.add_constructor(
        "tag:yaml.org,2002:opencv-matrix", lambda reader, node: reader.construct_mapping(node, deep=True)
    )
