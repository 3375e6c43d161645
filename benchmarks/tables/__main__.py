"""`python -m benchmarks.tables`: see pages.py."""

from benchmarks.tables.pages import main

raise SystemExit(main())
