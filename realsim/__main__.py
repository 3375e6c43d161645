"""`python -m realsim` is the command line."""

from realsim.cli.command_line import main

if __name__ == "__main__":
    raise SystemExit(main())
