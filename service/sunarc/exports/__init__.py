"""Exports of a calibration to other formats, each with its stated error.

`formats` by name · `opencv`, `ocam`, `asi_core`, `mrcal` models fitted to ours · `tables` NetCDF and npz · `sky` the
grid on which they are compared.
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
