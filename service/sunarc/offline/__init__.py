"""Functions of the commands that work on files and databases, without a running service.

`calibrate_files` CSV files to calibrations · `calibrate_archive` a refit of the archive, and a past one again ·
`calibration_files` what a calibration's file is asked · `stars` images of the night · `archive_tables` sightings of the
archive to tables and back · `compile_kernels`. Images of a folder or an archive: `reanalysis`.
"""
