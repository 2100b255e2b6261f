"""Functions of the commands that work on files and databases, without a running service.

`detect_files` · `ingest` a folder to sightings · `import_sightings` a CSV file to sightings · `calibrate_files`
sightings to a calibration · `reproduce` a past calibration again · `project_files` · `export_archive` · `cameras` the
settings' camera in the archive · `files` · `compile_kernels`. Import the modules: the processes that look at images
load no more than they need.
"""
