"""The tables of figures in README.md and the report: `python -m benchmarks.tables`.

pages.py    writes them between their marks    plots.py    the report's pictures
stored.py   rows of benchmarks/results         the others  tables, by subject
"""
