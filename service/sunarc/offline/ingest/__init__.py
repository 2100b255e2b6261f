"""A folder of archived images to sightings in the archive.

`run` the entry · `index` the files, with `image_times` · `image_checks` what is refused · `detect_image` one image,
in a process of `detection_pool` · `summary`, `contact_sheet` what it came to.
"""
