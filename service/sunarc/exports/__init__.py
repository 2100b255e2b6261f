"""A calibration in other formats, each with its stated error, and files of other formats read as a camera.

`formats` by name · `reading` by content · `opencv`, `ocamcalib`, `asi_core`, `mrcal` files · `fisheye`, `ocam` models
fitted to ours · `tables` NetCDF and npz, `draws` of the errors in them · `view` what a file says of a camera ·
`comparison` of two of them · `start` the camera of ours that is closest to one · `sky` to which models are fitted.
"""
