"""Open3D without its web pages until somebody asks for them: their package (dash) takes a third of its import.

For functions to import: Open3D itself takes most of a second.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import Any

_PAGES = "open3d.visualization.draw_plotly"
_NAMES = ("draw_plotly", "draw_plotly_server", "get_plotly_fig")
"""What `open3d.visualization` takes from there."""


def _import_without_pages() -> Any:
    if "open3d" in sys.modules:
        return sys.modules["open3d"]
    stand_in = ModuleType(_PAGES)
    vars(stand_in).update(dict.fromkeys(_NAMES))
    sys.modules[_PAGES] = stand_in
    try:
        visualization: Any = import_module("open3d.visualization")
    finally:
        del sys.modules[_PAGES]

    def find(name: str) -> Any:
        if name not in _NAMES:
            raise AttributeError(f"module {visualization.__name__!r} has no attribute {name!r}")
        pages = import_module(_PAGES)
        for each in _NAMES:
            setattr(visualization, each, getattr(pages, each))
        return getattr(pages, name)

    for name in _NAMES:
        delattr(visualization, name)
    visualization.__getattr__ = find
    return sys.modules["open3d"]


o3d = _import_without_pages()
