"""Hub of a fleet: rows of imagers in one database, cross-checks of neighbours, the fleet's page."""
