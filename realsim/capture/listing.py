"""Files of a capture in a stable order, and colour and depth brought together by name."""

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path

import numpy as np

from realsim.capture.association import associate
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


def named_for_poses(folder: Path) -> list[str]:
    """What in a folder is called poses, a trajectory, odometry or ground truth."""
    there = os.listdir(folder) if folder.is_dir() else []
    return sorted(name for name in there if re.search("pose|traj|odom|groundtruth", name, re.IGNORECASE))


def first_file(folder: Path, names: Sequence[str]) -> Path | None:
    """The first of the names that is in the folder, or None. Where it is no file, or a link that leads nowhere, its
    reader says so: nothing else is taken in its place."""
    return next((folder / name for name in names if lexists(folder / name)), None)


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


def pair_by_stem(color: Sequence[Path], depth: Sequence[Path], apart: float = 0.0) -> tuple[list[Pair], str]:
    """Colour and depth files that belong together, in natural order, and the rule that was used, in words.

    Of the same stem, the same number at its end (`color_0001`, `depth_0001`) and the same at its beginning
    (`0000002-000000033369`) the rule that joins most, the first of equals. Where it joins less than half of the files
    and their names are times: those at most `apart` seconds from each other. A file without a partner still makes a
    pair, so that it can be reported.
    """
    rules = (
        ("with the same file name", {p.stem: p for p in color}, {p.stem: p for p in depth}),
        ("with the same number at the end of the file name", _by_number(color, -1), _by_number(depth, -1)),
        ("with the same number at the beginning of the file name", _by_number(color, 0), _by_number(depth, 0)),
    )
    how, by_color, by_depth = max(rules, key=lambda rule: len(rule[1].keys() & rule[2].keys()))
    if 2 * len(by_color.keys() & by_depth.keys()) < min(len(color), len(depth)):
        at_color, at_depth = _by_time(color), _by_time(depth)
        a, b = np.array(sorted(at_color)), np.array(sorted(at_depth))
        if matches := associate(a, b, apart):
            how = f"at most {apart:g} s apart, by the times that are their names,"
            partner = {at_depth[b[j]]: at_color[a[i]].stem for i, j in matches}
            by_color, by_depth = rules[0][1], {partner.get(p, p.stem): p for p in depth}
    names = sorted(by_color.keys() | by_depth.keys(), key=natural_key)
    return [Pair(n, by_color.get(n), by_depth.get(n)) for n in names], f"colour and depth {how} belong together"


def _by_number(paths: Sequence[Path], which: int) -> dict[str, Path]:
    """Files by the run of digits at that place in their names; none, unless each has another."""
    numbers = [digits[which] for p in paths if (digits := re.findall(r"\d+", p.stem))]
    by_number = {f"{int(number):06d}": path for number, path in zip(numbers, paths, strict=False)}
    return by_number if len(by_number) == len(paths) else {}


def _by_time(paths: Sequence[Path]) -> dict[float, Path]:
    """Files by the seconds that are their names, also in milli-, micro- or nanoseconds since 1970; none, unless each
    has another."""
    by_time = {}
    for path in paths:
        if re.fullmatch(r"\d{10,19}|\d+\.\d+", path.stem):
            seconds = float(path.stem)
            by_time[seconds / 1000 ** max(0, int(np.log10(max(seconds, 1)) - 8) // 3)] = path
    return by_time if len(by_time) == len(paths) else {}
