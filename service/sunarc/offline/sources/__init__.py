"""Archives of images, read where they are: `open_source` gives the files of an address, `frames` the images in a file.

`values` the protocol · `folder`, `zip_file`, `tar_file`, `remote` where files are · `frames` by kind of file:
`fits_file`, `netcdf_file`, `video_file`, and pictures through `ingest/image_checks` · `times` when they were taken.
A reader's library is imported when a file needs it.
"""
