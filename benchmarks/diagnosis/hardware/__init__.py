"""Logs of real robots with known errors put into their models: labelled cases whose noise and leftovers are real."""
