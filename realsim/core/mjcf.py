"""MJCF that is safe to compile: nothing in it runs code, reads files elsewhere, or grows without bound.

MuJoCo expands `<replicate>`, `<composite>` and built-in textures while it reads a file: two hundred bytes can take
minutes and gigabytes. What a file becomes is counted before.
"""

import math
import os
import re
from pathlib import Path
from typing import Any

from realsim.core.errors import RealsimError
from realsim.core.files import check_size, inside, read_text

MAX_INCLUDES = 8
MOST_ELEMENTS = 100_000
"""After replication; the largest scene of ours has some 5,000."""
MOST_CELLS = 2**26
"""Pixels of a built-in texture, or cells of a height field: 8192 x 8192."""
FACTORS = {"replicate": ("count",), "composite": ("count",), "flexcomp": ("count",)}
SIZES = {"texture": ("width", "height"), "hfield": ("nrow", "ncol")}
DIRECTORIES = ("meshdir", "texturedir", "assetdir")


def check_mjcf(
    path: Path, root: Path | None = None, problem: type[RealsimError] = RealsimError, *, plugins: bool = False
) -> str:
    """The text of an MJCF file, after it and all that it reads were found harmless.

    Args:
        root: the folder below which all files must be that it names, links followed; any may be named if None.
        problem: the kind of error.
        plugins: whether it may have plugins, as MuJoCo brings some with it.

    Raises:
        RealsimError: it is no XML, has plugins where it may not, names files outside `root` or by absolute paths, or
            is too large.
    """
    try:
        text, size = _Checker(root, problem, plugins).check(path, Path())
    except RecursionError as error:
        raise problem(f"{path.name} is not plain XML", file=path, found="elements nested too deep") from error
    if size > MOST_ELEMENTS:
        raise problem(
            "the model is too large",
            file=path,
            expected=f"at most {MOST_ELEMENTS} elements after replication",
            found=f"{size:.3g} elements",
            hint="lower the counts of replicate and composite",
        )
    return text


def find_packages(spec: Any, path: Path) -> None:
    """Give the meshes of a model that names them by `package://NAME/...`, as URDFs do, the files that are meant.

    They are looked for without ROS: from the folder of the model upward, and in ROS_PACKAGE_PATH, with NAME and
    without it. What is not found keeps its name, and MuJoCo says that it cannot open it.
    """
    places = [*path.resolve().parents, *map(Path, filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(":")))]
    for mesh in spec.meshes:
        parts = Path(mesh.file.removeprefix("package://")).parts
        if mesh.file.startswith("package://") and ".." not in parts:
            files = (place.joinpath(*rest) for place in places for rest in (parts, parts[1:]))
            if found := next(filter(os.path.isfile, files), None):
                mesh.file = str(found)


class _Checker:
    def __init__(self, root: Path | None, problem: type[RealsimError], plugins: bool) -> None:
        self.root, self.problem, self.plugins = root, problem, plugins

    def check(self, path: Path, where: Path, depth: int = 0) -> tuple[str, float]:
        """(text, elements) of a file whose names are relative to `where`, a folder below the first file's."""
        from defusedxml import ElementTree
        from defusedxml.common import DefusedXmlException

        text = read_text(path)
        try:
            # MuJoCo takes comments that XML does not.
            tree = ElementTree.fromstring(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL))
        except (ElementTree.ParseError, DefusedXmlException, ValueError) as error:
            raise self.problem(
                f"{path.name} is not plain XML", file=path, expected="MJCF", found=str(error) or type(error).__name__
            ) from error
        if depth == 0:
            self.home = path.parent
        if tree.tag == "robot":  # URDF: nothing in it is replicated, and plugins are Gazebo's
            return text, sum(1.0 for _ in tree.iter())
        directories = {name: value for node in tree.iter("compiler") for name, value in node.attrib.items()}
        for node in tree.iter():
            self._check_node(path, node, where, directories)
        return text, self._size(path, tree, where, depth)

    def _check_node(self, path: Path, node: Any, where: Path, directories: dict[str, str]) -> None:
        if node.tag in ("plugin", "extension") and not self.plugins:
            raise self.problem("models with plugins are not loaded", file=path, found=f"<{node.tag}>")
        cells = math.prod(_numbers(node, SIZES.get(node.tag, ())))
        if cells > MOST_CELLS:
            raise self.problem(
                f"a {node.tag} of the model is too large",
                file=path,
                expected=f"at most {MOST_CELLS} cells",
                found=f"{cells:.3g}",
            )
        for attribute, name in node.attrib.items():
            if name and attribute in DIRECTORIES:
                self._check_name(path, where, name)
            elif name and attribute.startswith("file"):
                own = "texturedir" if node.tag == "texture" else "meshdir"
                folder = directories.get(own, directories.get("assetdir", ""))
                in_it = folder and node.tag not in ("include", "model")
                self._check_name(path, where / folder if in_it else where, name)

    def _check_name(self, path: Path, where: Path, name: str) -> None:
        """Refuse a name that leads out of the root, or that would not lead to the same file from another folder."""
        if self.root is None:
            return
        inside(self.root, str(where / name))
        if Path(name).is_absolute():
            raise self.problem(
                "a file of the model is named by an absolute path",
                file=path,
                expected="a path relative to the model, so that a copy finds its files too",
                found=name,
            )

    def _size(self, path: Path, node: Any, where: Path, depth: int) -> float:
        """Elements that a node becomes."""
        further = node.get("file") if node.tag in ("include", "model") else None
        below = 0.0
        if further:
            target = self.home / where / further
            if depth == MAX_INCLUDES:
                raise self.problem("the model's files include each other", file=path, found=further)
            if target.suffix.lower() in (".xml", ".mjcf", ""):
                check_size(target)
                # Included names are relative to the first file, those of a model to attach to the file itself.
                inner = where if node.tag == "include" else (where / further).parent
                below = self.check(target, inner, depth + 1)[1]
        below += sum(self._size(path, child, where, depth) for child in node)
        return 1.0 + below * max(1.0, math.prod(_numbers(node, FACTORS.get(node.tag, ())))) + _own(node)


def _own(node: Any) -> float:
    """Elements that a node makes of nothing: bodies of a composite or a flex."""
    return math.prod(_numbers(node, ("count",))) if node.tag in ("composite", "flexcomp") else 0.0


def _numbers(node: Any, names: tuple[str, ...]) -> list[float]:
    """The numbers in some attributes; what is no number is MuJoCo's to refuse."""
    found = []
    for word in " ".join(node.get(name, "") for name in names).split():
        try:
            found.append(abs(float(word)))
        except ValueError:
            continue
    return found or [0.0]
