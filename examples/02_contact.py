"""Collision geometry for a mesh, chosen by measured error and cost, and the same scene in other formats.

python examples/02_contact.py [MESH]
"""

import sys
from pathlib import Path
from tempfile import mkdtemp

import trimesh

import realsim as rs

work = Path(mkdtemp())
mesh = Path(sys.argv[1]) if len(sys.argv) > 1 else work / "stairs.stl"
if len(sys.argv) < 2:
    steps = [trimesh.creation.box(bounds=[(0.3 * k, 0, 0), (0.3 * k + 0.3, 1, 0.1 * k)]) for k in (1, 2, 3)]
    trimesh.util.concatenate(steps).export(mesh)

scene = rs.contact(mesh, work / "scene")
contact = scene.contact
print(f"{contact.representation}: {contact.geoms} geoms, {contact.median_mm:.2f} mm off in the median")
for format, files in scene.export(["obj", "usd"], out=work / "other").items():
    print(format, *files)
