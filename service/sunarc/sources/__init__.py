"""Sources of timed images: files, archives of files, their times, and the sun detected in them."""
