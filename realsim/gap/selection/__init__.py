"""Which causes: sets of causes, one score for each, one search over them (experimental)."""
