"""Results of the stages, on files or in memory: layout, checks, repairs and retakes."""
