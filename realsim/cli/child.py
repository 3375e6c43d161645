"""`python -m realsim.cli.child ARGUMENTS`: the `realsim` command, ended when the process that started it ends.

A process that is killed outright can end nothing itself. (Linux; elsewhere the command runs to its end.)
"""

import os
import signal
import sys

PARENT = "REALSIM_PARENT"
PROGRESS = "REALSIM_PROGRESS"
SET_DEATH_SIGNAL = 1
"""PR_SET_PDEATHSIG of linux/prctl.h."""


def main() -> int:
    """Tie this process to its parent, then run the command."""
    parent = os.environ.pop(PARENT, "")
    if sys.platform == "linux" and parent:
        import ctypes

        ctypes.CDLL(None).prctl(SET_DEATH_SIGNAL, signal.SIGTERM)
        if os.getppid() != int(parent):  # it ended before
            return 130
    from realsim.cli.command_line import main as run
    from realsim.core.progress import report_to

    pipe = os.environ.pop(PROGRESS, "")
    if pipe:
        report_to(os.fdopen(int(pipe), "w", buffering=1))
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
