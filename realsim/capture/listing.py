"""Files of a capture in a stable order, and colour and depth brought together by name."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from realsim.capture.images import COLOR_SUFFIXES, DEPTH_SUFFIXES
from realsim.core.errors import PoseError

COLOR_FOLDERS = ("color", "colour", "rgb", "image", "images")
DEPTH_FOLDERS = ("depth", "depths", "depth_images")


@dataclass(frozen=True)
class Pair:
    """The files of one frame; either may be missing."""

    name: str
    color: Path | None
    depth: Path | None


def natural_key(name: str) -> tuple:
    """Sort key that puts 2 before 10."""
    return tuple((0, int(part), "") if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part)


def list_files(folder: Path, suffixes: Sequence[str]) -> list[Path]:
    """Visible files of a folder with one of the suffixes (any case), in natural order; [] if no such folder.

    Broken links and pipes are among them: a frame that cannot be read has to be reported, not to vanish.
    """
    if not folder.is_dir():
        return []
    found = [p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith(".")]
    return sorted(found, key=lambda p: natural_key(p.name))


def pose_file(folder: Path, names: Sequence[str]) -> Path | None:
    """The first of the names that is a file, or None where there is nothing of such a name.

    Raises:
        PoseError: a broken link, a folder or a pipe has the name: poses were meant, and must not be missed in silence.
    """
    there = [folder / name for name in names if os.path.lexists(folder / name)]
    if found := next((path for path in there if path.is_file()), None):
        return found
    if there:
        hint = "mend or remove it, or pass --ignore-poses"
        what = "a link to nothing" if there[0].is_symlink() and not there[0].exists() else "no file"
        raise PoseError("the camera poses cannot be read", file=there[0], expected="a file", found=what, hint=hint)
    return None


def first_file(folder: Path, names: Sequence[str]) -> Path | None:
    """The first of the names that is a file in the folder, or None."""
    return next((folder / name for name in names if (folder / name).is_file()), None)


def single_file(path: Path, suffixes: Sequence[str]) -> Path | None:
    """The path itself if it is a file with one of the suffixes, or the only such file of a folder; else None."""
    if path.is_file():
        return path if path.suffix.lower() in suffixes else None
    found = list_files(path, suffixes)
    return found[0] if len(found) == 1 else None


def subfolder(folder: Path, names: Sequence[str], suffixes: Sequence[str]) -> Path | None:
    """The first of the named subfolders that holds such files, or None."""
    return next((folder / name for name in names if list_files(folder / name, suffixes)), None)


def color_folder(folder: Path) -> Path | None:
    """The subfolder with colour images, or None."""
    return subfolder(folder, COLOR_FOLDERS, COLOR_SUFFIXES)


def depth_folder(folder: Path) -> Path | None:
    """The subfolder with depth images, or None."""
    return subfolder(folder, DEPTH_FOLDERS, DEPTH_SUFFIXES)


def image_files(folder: Path) -> tuple[list[Path], list[Path]]:
    """Colour and depth images of the usual subfolders."""
    color, depth = color_folder(folder), depth_folder(folder)
    return list_files(color, COLOR_SUFFIXES) if color else [], list_files(depth, DEPTH_SUFFIXES) if depth else []


def lacking(parts: Mapping[str, object]) -> tuple[str, ...]:
    """Names of the parts that are not there."""
    return tuple(name for name, there in parts.items() if not there)


def last_number(stem: str) -> int | None:
    """The last run of digits in a name (`frame_000123` -> 123), or None."""
    digits = re.findall(r"\d+", stem)
    return int(digits[-1]) if digits else None


def pair_by_stem(color: Sequence[Path], depth: Sequence[Path]) -> tuple[list[Pair], str]:
    """Colour and depth files with the same stem, in natural order, and the rule that was used, in words.

    Where no stem agrees (`color_0001`, `depth_0001`) the last number in the name decides, provided that it names each
    file uniquely. A file without a partner still makes a pair, so that it can be reported.
    """
    by_color, by_depth = {p.stem: p for p in color}, {p.stem: p for p in depth}
    rule = "colour and depth with the same file name belong together"
    if by_color and by_depth and not by_color.keys() & by_depth.keys():
        numbered_color, numbered_depth = _by_number(color), _by_number(depth)
        if numbered_color and numbered_depth:
            by_color, by_depth = numbered_color, numbered_depth
            rule = "colour and depth with the same number at the end of the file name belong together"
    names = sorted(by_color.keys() | by_depth.keys(), key=natural_key)
    return [Pair(name, by_color.get(name), by_depth.get(name)) for name in names], rule


def _by_number(paths: Sequence[Path]) -> dict[str, Path]:
    numbers = [last_number(p.stem) for p in paths]
    if None in numbers or len(set(numbers)) != len(numbers):
        return {}
    return {f"{number:06d}": path for number, path in zip(numbers, paths, strict=True)}
