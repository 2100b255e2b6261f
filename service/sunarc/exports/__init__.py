"""A calibration in other formats, each with its stated error, and files of other formats read as a camera.

`formats` by name · `reading` by content · `opencv`, `ocamcalib`, `asi_core`, `mrcal` files · `fisheye`, `ocam` models
fitted to ours · `tables` NetCDF and npz, `draws` of the errors in them · `view` what a file says of a camera ·
`comparison` of two of them · `start` the camera of ours that is closest to one · `sky` to which models are fitted.
"""

from sunarc.exports.asi_core_set import asi_core_set
from sunarc.exports.comparison import ZENITH_RANGES_DEG, Comparison, compare
from sunarc.exports.discovery import Table, Variable
from sunarc.exports.exported import Exported
from sunarc.exports.formats import (
    FILE_FORMATS,
    FILE_NAMES,
    FORMATS,
    MAP_FORMATS,
    MEDIA_TYPES,
    Format,
    MapFormat,
    export,
    export_draws,
    export_file,
    export_map,
)
from sunarc.exports.reading import READ_FORMATS, read_view
from sunarc.exports.start import closest_camera
from sunarc.exports.tables import map_table, netcdf_bytes, npz_bytes
from sunarc.exports.view import View, camera_view, rotated

__all__ = [
    "FILE_FORMATS",
    "FILE_NAMES",
    "FORMATS",
    "MAP_FORMATS",
    "MEDIA_TYPES",
    "READ_FORMATS",
    "ZENITH_RANGES_DEG",
    "Comparison",
    "Exported",
    "Format",
    "MapFormat",
    "Table",
    "Variable",
    "View",
    "asi_core_set",
    "camera_view",
    "closest_camera",
    "compare",
    "export",
    "export_draws",
    "export_file",
    "export_map",
    "map_table",
    "netcdf_bytes",
    "npz_bytes",
    "read_view",
    "rotated",
]
