"""What a case is: logs on disk, units, repeated commands, the runs that are fitted; below it, its model and health."""
