"""Damaged input: no traceback, no hang, no silent wrong answer."""
