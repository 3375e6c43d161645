"""The diagnosis on generated, real and withheld logs."""
