"""Recorded logs: folders and CSV files, units, repeated commands, selection of the fitted runs."""
