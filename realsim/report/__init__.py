"""Reports for people and machines: `write_report` makes report.json and report.html from a `Reconstruction`.

Reports read results and compute nothing but summary figures. Building blocks for other reports: `page` (pieces of HTML
and the document), `svg` (plots), `raster` (pictures), `viewer3d` (an interactive view).
"""

from realsim.report.write import write_report

__all__ = ["write_report"]
