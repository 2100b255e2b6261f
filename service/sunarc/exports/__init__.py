"""The same calibration in others' formats; each says how far it is from ours.

sky.py: where they are compared · opencv.py, ocam.py, mrcal.py: others' models, fitted to ours · asi_core.py: the file
of one reader of ocam.py's · tables.py: NetCDF and npz, of a calibration and of the map of what every pixel sees ·
formats.py: all of them by name.
"""

from sunarc.exports.formats import (
    FILE_NAMES,
    FORMATS,
    MAP_FORMATS,
    MEDIA_TYPES,
    Exported,
    Format,
    MapFormat,
    export,
    export_map,
)
from sunarc.exports.tables import Table, Variable, map_table, netcdf_bytes, npz_bytes

__all__ = [
    "FILE_NAMES",
    "FORMATS",
    "MAP_FORMATS",
    "MEDIA_TYPES",
    "Exported",
    "Format",
    "MapFormat",
    "Table",
    "Variable",
    "export",
    "export_map",
    "map_table",
    "netcdf_bytes",
    "npz_bytes",
]
