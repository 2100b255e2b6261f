"""Functions of the commands that work on files and databases, without a running service."""

from sunarc.offline.calibrate_files import calibrate_file, image_circle_of
from sunarc.offline.compile_kernels import compile_kernels
from sunarc.offline.detect_files import METHODS, detect_in_files, detect_in_image, draw_overlay
from sunarc.offline.import_sightings import import_points
from sunarc.offline.ingest import Ingested, ingest_folder
from sunarc.offline.project_files import project_csv, unproject_csv
from sunarc.offline.sighting_files import (
    backup_database,
    check_database,
    export_points,
    upgrade_database,
)

__all__ = [
    "METHODS",
    "Ingested",
    "backup_database",
    "calibrate_file",
    "check_database",
    "compile_kernels",
    "detect_in_files",
    "detect_in_image",
    "draw_overlay",
    "export_points",
    "image_circle_of",
    "import_points",
    "ingest_folder",
    "project_csv",
    "unproject_csv",
    "upgrade_database",
]
