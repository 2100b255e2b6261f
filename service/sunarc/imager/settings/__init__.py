"""Settings: the packages' own options, from a TOML file and SUNARC_* variables, parsed once at the top."""
