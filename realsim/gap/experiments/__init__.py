"""Which recording would tell the causes apart that a diagnosis could not: chosen, checked, written."""
