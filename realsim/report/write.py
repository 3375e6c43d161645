"""report.json and report.html of a reconstruction."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from realsim.core.errors import RealsimError
from realsim.core.files import file_digests, to_json, write_text
from realsim.core.types import U8, Reconstruction
from realsim.report.document import reconstruction_page
from realsim.report.picture import draw
from realsim.report.summary import Made, summary
from realsim.report.verdict import judge


def write_report(folder: Path, result: Reconstruction, *, picture: bool = True) -> None:
    """Write `folder/report.json` and `folder/report.html`.

    The same result gives the same bytes, except for the date and what was measured with a clock: in the JSON `made`,
    `stages`, the costs of a step under `contact`, and `seconds` of `modes`; in the page the card "This run", the lines
    with the costs of a step, and the times of the comparison.

    Args:
        folder: holds the exported scene, whose collision geometry is read for the 3D view.
        picture: draw the scene with MuJoCo for the page.
    """
    with ThreadPoolExecutor(1) as beside:  # another process draws
        drawn = beside.submit(_drawn, folder / result.scene.scene_xml.name) if picture else None
        judgement, made = judge(result), Made.now()
        written = {"files": file_digests(folder, without=("report.json", "report.html"))}
        write_text(folder / "report.json", to_json(summary(result, judgement, made) | written))
        page = reconstruction_page(folder, result, judgement, made, drawn.result if drawn else None)
        write_text(folder / "report.html", page)


def _drawn(scene_xml: Path) -> U8 | str:
    """The picture, or why this machine cannot draw it: a page without it is still a page."""
    try:
        return draw(scene_xml)
    except RealsimError as error:
        return error.render()
