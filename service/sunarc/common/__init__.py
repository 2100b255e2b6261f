"""Names, errors, findings and statistics that every part of the library uses."""
