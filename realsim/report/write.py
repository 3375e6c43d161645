"""report.json and report.html of a reconstruction."""

from __future__ import annotations

from pathlib import Path

from realsim.files import to_json, write_text
from realsim.report.document import reconstruction_page
from realsim.report.summary import summary
from realsim.report.verdict import judge
from realsim.types import Reconstruction


def write_report(folder: Path, result: Reconstruction) -> None:
    """Write `folder/report.json` and `folder/report.html`.

    The same result gives the same bytes. Two runs differ in what was measured with a clock: in the JSON `stages`, the
    costs of a step under `contact`, and `seconds` of `modes`; in the page the card "Time and memory", the lines with
    the costs of a step, and the times of the comparison. `folder` holds the exported scene, whose collision geometry is
    read for the 3D view.
    """
    judgement = judge(result)
    write_text(folder / "report.json", to_json(summary(result, judgement)))
    write_text(folder / "report.html", reconstruction_page(folder, result, judgement))
