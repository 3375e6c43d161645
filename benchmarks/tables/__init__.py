"""The tables of figures in README.md and docs: `python -m benchmarks.tables`.

pages.py       writes them between their marks      diagnosis.py, captures.py, policies.py, readme.py, index.py   tables
stored.py      rows of benchmarks/results
"""
