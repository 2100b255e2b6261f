"""Formats of a calibration, each with its stated error, and files of other programs read as a camera.

`calibration_document`, `lens_prior` and `csv_files` our own · `formats` all others by name · `fisheye` (OpenCV, ROS,
COLMAP), `ocam` (OCamCalib), `asi_core`, `mrcal` models fitted to ours and their files · `tables` NetCDF and npz ·
`pixel_maps`, `remap` maps · `view` a file's camera, and how far two of them are apart.
"""
