"""A calibration in other formats, each with its stated error, and files of other formats read as a camera.

`formats` by name · `reading` by content, and the camera of ours that is closest to a file's · `fisheye` (OpenCV, ROS,
COLMAP), `ocam` (OCamCalib), `asi_core`, `mrcal` models fitted to ours and their files · `tables` NetCDF and npz ·
`pixel_maps`, `remap` maps · `view` what a file says of a camera, and how far two of them are apart.
"""
