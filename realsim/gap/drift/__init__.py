"""What changed between two logs of one robot."""
