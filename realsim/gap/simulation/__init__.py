"""The simulator that replays a log: nominal, or changed by effects and everyday deviations."""
