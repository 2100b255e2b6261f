"""Functions of the commands that work on files and databases, without a running service."""

from sunarc.offline.calibrate_files import calibrate_file, image_circle_of
from sunarc.offline.compile_kernels import compile_kernels
from sunarc.offline.detect_files import METHODS, detect_in_files, detect_in_image, draw_overlay
from sunarc.offline.ingest import Ingested, ingest_folder
from sunarc.offline.project_files import project_csv, unproject_csv

__all__ = [
    "METHODS",
    "Ingested",
    "calibrate_file",
    "compile_kernels",
    "detect_in_files",
    "detect_in_image",
    "draw_overlay",
    "image_circle_of",
    "ingest_folder",
    "project_csv",
    "unproject_csv",
]
