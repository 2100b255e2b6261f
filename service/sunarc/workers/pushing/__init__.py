"""Messages to receivers elsewhere: `record` what there is to tell · `push` sends it · `webhook mqtt` how."""
