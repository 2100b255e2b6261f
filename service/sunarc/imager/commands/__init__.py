"""Functions of the imager's commands."""
