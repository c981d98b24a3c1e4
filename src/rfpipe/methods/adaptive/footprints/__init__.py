"""Former place of footprint acquisition, until the environment is installed again."""
