"""Identifies the engine of an answer: answers are comparable only if these sources and settings are equal."""

from dataclasses import asdict
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from realsim import __version__
from realsim.gap.config import DiagnoseConfig
from realsim.gap.effects.deviations_file import read_deviations

NO_ANSWER = ("report", "excite.py", "experiments", "drift", "recordings")
"""Below realsim/gap: what makes a case, shows an answer, or asks for another recording, and cannot change verdict or
causes."""
NO_SETTING = ("threads", "report")
"""Settings that cannot change an answer."""


@cache
def engine() -> str:
    """Hash of the sources that an answer depends on, 12 hexadecimal digits; the same on every machine."""
    folder = Path(__file__).parent
    digest = sha256()
    for path in sorted(folder.rglob("*.py"), key=lambda p: p.relative_to(folder).as_posix()):
        name = path.relative_to(folder)
        if name.parts[0] not in NO_ANSWER:
            digest.update(f"{name.as_posix()}\n".encode())
            digest.update(path.read_bytes().replace(b"\r\n", b"\n"))
    return digest.hexdigest()[:12]


def provenance(config: DiagnoseConfig) -> dict[str, Any]:
    """`version` of realsim, `engine` (see above), version of `mujoco`, and the `settings` that can change an answer."""
    import mujoco

    # Lists, not tuples: what is written and read again is the same.
    settings = {
        name: list(value) if isinstance(value, tuple) else value
        for name, value in asdict(config).items()
        if name not in NO_SETTING
    }
    settings["deviations"] = read_deviations(config.deviations).sizes  # what they are, not where they stood
    return {"version": __version__, "engine": engine(), "mujoco": mujoco.__version__, "settings": settings}
