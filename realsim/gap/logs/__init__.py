"""What was recorded: folders and CSV files, units, repeated commands, which runs are fitted."""
