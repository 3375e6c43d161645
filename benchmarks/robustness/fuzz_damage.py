"""Damage to files and folders as disks, transfers, editors and attackers do it; everything by a seed."""

from __future__ import annotations

import io
import json
import math
import os
import re
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

Rng = np.random.Generator
TEXT = (".json", ".txt", ".csv", ".tsv", ".log", ".xml", ".yaml", ".yml", ".traj", ".pincam", ".jsonl", ".obj", ".off")
ODD_NUMBERS = ("nan", "inf", "-inf", "1e400", "-1", "0", "1e-320", "9" * 400, "0x10", "1,5", "", "abc", "\x1b[31mred")
ODD_VALUES: tuple[Any, ...] = (
    math.nan, math.inf, -1, 0, 1e308, 10**400, 0.5, "", "text", "\x1b]0;title\x07", None, True, [], {}, [[]], [None],
    ["a", "a"], {"a": {"a": {}}}, "../../etc/passwd", "/etc/passwd",
)  # fmt: skip
NAMES = ("\x1b[31mEVIL", "a\x07b", "\x9b31m", "\u202egnp.exe", "new\nline", "'\"<svg>", " ", "\udcff")

NO_STRUCTURE = (OSError, ValueError, LookupError, zipfile.BadZipFile, ElementTree.ParseError, RecursionError)
"""What changing the content of a file raises that was damaged before."""


def damage(folder: Path, rng: Rng) -> str:
    """Do one to three kinds of damage to a folder, in place; what was done to which file."""
    done = []
    for _ in range(int(rng.choice((1, 1, 1, 2, 3)))):
        files = sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())
        if not files:
            break
        # Half of the time one of the few files that say something of all others.
        small = [p for p in files if p.suffix in (".json", ".txt", ".xml", ".yaml", ".csv", ".log", ".traj")]
        among = small if small and rng.random() < 0.5 else files
        path = among[int(rng.integers(len(among)))]
        kinds = [*ANY, *(DAMAGE_OF.get(path.suffix, ()) or (TEXTUAL if path.suffix in TEXT else ()))]
        kinds += [k for k in kinds if k not in ANY] * 2  # what a format's own parser meets, more often
        kind = kinds[int(rng.integers(len(kinds)))]
        try:
            kind(path, rng)
        except NO_STRUCTURE:
            BYTES[int(rng.integers(len(BYTES)))](path, rng)  # damaged before: no structure is left to change
        done.append(f"{kind.__name__} {re.sub('[0-9]+', '#', path.relative_to(folder).as_posix())}")
    return ", ".join(done)


# ---------------------------------------------------------------- bytes


def flip_bits(path: Path, rng: Rng) -> None:
    data = bytearray(path.read_bytes())
    for at in rng.integers(0, max(len(data), 1), int(rng.choice((1, 4, 32)))) if data else ():
        data[at] ^= 1 << int(rng.integers(8))
    path.write_bytes(data)


def flip_early(path: Path, rng: Rng) -> None:
    """In the first 256 bytes, where headers are."""
    data = bytearray(path.read_bytes())
    for at in rng.integers(0, max(min(len(data), 256), 1), 3) if data else ():
        data[at] = int(rng.integers(256))
    path.write_bytes(data)


def huge_header(path: Path, rng: Rng) -> None:
    """A length near the beginning becomes the largest that there is."""
    data = bytearray(path.read_bytes())
    at = int(rng.integers(0, max(min(len(data) - 4, 200), 1)))
    data[at : at + 4] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)


def cut_off(path: Path, rng: Rng) -> None:
    os.truncate(path, int(path.stat().st_size * rng.random()))


def zero_block(path: Path, rng: Rng) -> None:
    data = bytearray(path.read_bytes())
    at = int(rng.integers(0, max(len(data), 1)))
    data[at : at + 512] = bytes(len(data[at : at + 512]))
    path.write_bytes(data)


def append(path: Path, rng: Rng) -> None:
    with path.open("ab") as file:
        file.write(rng.bytes(int(rng.choice((1, 100, 5000)))))


def shifted(path: Path, rng: Rng) -> None:
    """A byte more or less in the middle: all that follows is off by one."""
    data = path.read_bytes()
    at = int(rng.integers(len(data) + 1))
    path.write_bytes(data[:at] + (rng.bytes(1) + data[at:] if rng.random() < 0.5 else data[at + 1 :]))


def doubled(path: Path, rng: Rng) -> None:
    """A block stands twice, as after a transfer that was taken up again at the wrong place."""
    data = path.read_bytes()
    at, size = int(rng.integers(len(data) + 1)), int(rng.integers(1, 4096))
    path.write_bytes(data[: at + size] + data[at : at + size] + data[at + size :])


def no_numbers(path: Path, rng: Rng) -> None:
    """Some numbers of four or eight bytes become NaN, infinite or enormous."""
    data = bytearray(path.read_bytes())
    kind = np.dtype(rng.choice(("<f4", "<f8")))
    for at in rng.integers(0, max(len(data) - 8, 1), int(rng.choice((1, 3, 50)))):
        value = np.array(rng.choice((np.nan, np.inf, -np.inf, 1e38, -1e38)), kind).tobytes()
        place = int(at) // 4 * 4 + int(rng.integers(4)) * int(rng.random() < 0.5)  # headers are of any length
        data[place : place + len(value)] = value
    path.write_bytes(bytes(data))


def emptied(path: Path, rng: Rng) -> None:
    path.write_bytes(b"")


def noise(path: Path, rng: Rng) -> None:
    path.write_bytes(rng.bytes(2000))


# ---------------------------------------------------------------- files


def removed(path: Path, rng: Rng) -> None:
    path.unlink()


def renamed(path: Path, rng: Rng) -> None:
    path.rename(path.with_name(str(rng.choice(NAMES)) + path.name))


def renamed_inside(path: Path, rng: Rng) -> None:
    """The name of a file in the middle of what a manifest or a number would find."""
    path.rename(path.with_name(path.stem + str(rng.choice(NAMES)) + path.suffix))


def swapped(path: Path, rng: Rng) -> None:
    others = sorted(p for p in path.parent.iterdir() if p.is_file() and p != path)
    if others:
        other = others[int(rng.integers(len(others)))]
        one, two = path.read_bytes(), other.read_bytes()
        path.write_bytes(two)
        other.write_bytes(one)


def copied(path: Path, rng: Rng) -> None:
    shutil.copy(path, path.with_name("copy of " + path.name))


def loop(path: Path, rng: Rng) -> None:
    path.unlink()
    path.symlink_to(path.name)


def loop_of_two(path: Path, rng: Rng) -> None:
    path.unlink()
    path.symlink_to(path.name + "2")
    path.with_name(path.name + "2").symlink_to(path.name)


def dangling(path: Path, rng: Rng) -> None:
    path.unlink()
    path.symlink_to("/nowhere/at/all")


def outside(path: Path, rng: Rng) -> None:
    path.unlink()
    path.symlink_to(str(rng.choice(("/etc/passwd", "/proc/self/mem", "/dev/zero", "/dev/null"))))


def fifo(path: Path, rng: Rng) -> None:
    path.unlink()
    os.mkfifo(path)


def folder_instead(path: Path, rng: Rng) -> None:
    path.unlink()
    path.mkdir()


# ---------------------------------------------------------------- what stands in them


def text_number(path: Path, rng: Rng) -> None:
    """One number of a text becomes another, or none."""
    text = path.read_text("utf-8", "surrogateescape")
    found = list(re.finditer(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", text))
    place = found[int(rng.integers(len(found)))]
    text = text[: place.start()] + str(rng.choice(ODD_NUMBERS)) + text[place.end() :]
    path.write_text(text, "utf-8", "surrogateescape")


def text_line(path: Path, rng: Rng) -> None:
    """A line is lost, doubled, moved or torn."""
    lines = path.read_bytes().splitlines(keepends=True)
    at = int(rng.integers(len(lines)))
    how = int(rng.integers(4))
    if how == 0:
        del lines[at]
    elif how == 1:
        lines.insert(int(rng.integers(len(lines))), lines[at])
    elif how == 2:
        lines.append(lines.pop(at))
    else:
        lines[at] = lines[at][: len(lines[at]) // 2]
    path.write_bytes(b"".join(lines))


def json_value(path: Path, rng: Rng) -> None:
    path.write_text(json.dumps(changed(json.loads(path.read_text()), rng)))


def jsonl_value(path: Path, rng: Rng) -> None:
    lines = path.read_text().splitlines()
    at = int(rng.integers(len(lines)))
    lines[at] = json.dumps(changed(json.loads(lines[at]), rng))
    path.write_text("\n".join(lines) + "\n")


def json_deep(path: Path, rng: Rng) -> None:
    path.write_text("[" * 100_000)


def changed(tree: Any, rng: Rng) -> Any:
    """JSON in which one value is another, of another type, lost, of another length, or under another key."""
    spots: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            spots.append((node, key))
            walk(node[key])

    walk(tree)
    if not spots:
        return ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
    shallow = [s for s in spots if s[0] is tree]
    among = shallow if rng.random() < 0.3 else spots  # few of a file's values are not numbers of a long list
    node, key = among[int(rng.integers(len(among)))]
    how = int(rng.integers(5))
    if how == 0:
        del node[key]
    elif how == 1 and isinstance(node[key], list):
        node[key] = node[key][: len(node[key]) // 2]
    elif how == 2 and isinstance(node[key], list):
        node[key] = node[key] * 2
    elif how == 3 and isinstance(node, dict):
        node[f"{key}\x1b[31m"] = node.pop(key)
    else:
        node[key] = ODD_VALUES[int(rng.integers(len(ODD_VALUES)))]
    return tree


def xml_value(path: Path, rng: Rng) -> None:
    """An attribute gets another value, or an element is lost, doubled or renamed."""
    tree = ElementTree.parse(path)
    parents = [(p, c) for p in tree.iter() for c in p]
    how = int(rng.integers(5))
    parent, child = parents[int(rng.integers(len(parents)))]
    if how == 0:
        parent.remove(child)
    elif how == 1:
        parent.append(child)
    elif how == 2:
        child.tag = "geom" if child.tag != "geom" else "body"
    else:
        having = [node for node in tree.iter() if node.attrib]
        node = having[int(rng.integers(len(having)))]
        key = sorted(node.attrib)[int(rng.integers(len(node.attrib)))]
        odd = ("nan", "inf", "0", "-1", "1e-9", "1e30", "", "0 0", "abc", "../../x", "/etc/passwd", "1 " * 500)
        node.set(key, str(rng.choice(odd)))
    tree.write(path)


def xml_tree(path: Path, rng: Rng) -> None:
    """Elements are replicated, nested, included or linked without end."""
    tree = ElementTree.parse(path)
    parents = [(p, c) for p in tree.iter() for c in p]
    parent, child = parents[int(rng.integers(len(parents)))]
    how = int(rng.integers(7))
    parent.remove(child)
    if how == 0:
        outer = ElementTree.SubElement(parent, "replicate", count=str(rng.choice((3, 1000, 10**8))), offset="1 0 0")
        outer.append(child)
    elif how == 1:
        for _ in range(int(rng.choice((6, 300)))):
            parent = ElementTree.SubElement(parent, "replicate", count="30")
        parent.append(child)
    elif how == 2:
        for _ in range(int(rng.choice((50, 2000)))):
            parent = ElementTree.SubElement(parent, str(rng.choice(("body", "frame", "default"))))
        parent.append(child)
    elif how == 3:
        ElementTree.SubElement(parent, "include", file=str(rng.choice((path.name, "../x.xml", "/etc/passwd", "none"))))
    elif how == 4:
        size = {"width": "99999", "height": "99999"}
        asset = ElementTree.SubElement(tree.getroot(), "asset")
        ElementTree.SubElement(asset, "texture", {"name": "big", "type": "2d", "builtin": "flat", **size})
    elif how == 5:
        ElementTree.SubElement(tree.getroot(), "size", memory=str(rng.choice(("900G", "1", "-5", "x"))))
    else:
        body = tree.getroot().find("worldbody")
        composite = {"type": "cable", "count": str(rng.choice(("3", "90000000", "0"))) + " 1 1", "size": "1"}
        ElementTree.SubElement(parent if body is None else body, "composite", composite)
    tree.write(path)


def yaml_tree(path: Path, rng: Rng) -> None:
    """Aliases that grow by ten a line, brackets without end, a tag, a key that is none, a value of another kind."""
    bomb = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9))])
    odd = (f"{bomb}\n", "[" * 5000, "!!python/object/apply:os.system [ls]\n", "? [1, 2]\n: 3\n", "&a [*a]\n")
    text = path.read_text("utf-8", "surrogateescape")
    how = int(rng.integers(4))
    if how == 0:
        text = odd[int(rng.integers(len(odd)))]
    elif how == 1:
        text += odd[int(rng.integers(len(odd)))]
    else:
        found = list(re.finditer(r":[ \t]*\S.*", text))
        place = found[int(rng.integers(len(found)))]
        value = "*a8" if how == 2 else json.dumps(ODD_VALUES[int(rng.integers(len(ODD_VALUES)))])
        text = (f"{bomb}\n" if how == 2 else "") + text[: place.start()] + f": {value}" + text[place.end() :]
    path.write_text(text, "utf-8", "surrogateescape")


def xml_entities(path: Path, rng: Rng) -> None:
    path.write_text('<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><mujoco>&b;</mujoco>')


def array(path: Path, rng: Rng) -> None:
    np.save(path, odd_array(np.load(path), rng))


def archive_array(path: Path, rng: Rng) -> None:
    """One array of an .npz."""
    with np.load(path) as store:
        arrays = dict(store)
    name = sorted(arrays)[int(rng.integers(len(arrays)))]
    how = int(rng.integers(4))
    if how == 0:
        del arrays[name]
    elif how == 1:
        arrays[f"{name}\x1b[31m"] = arrays.pop(name)
    else:
        arrays[name] = odd_array(arrays[name], rng)
    with path.open("wb") as file:
        np.savez(file, **arrays)


def odd_array(values: np.ndarray, rng: Rng) -> np.ndarray:
    """Of another type, shape or length, or with values that are no numbers."""
    numbers = values.astype(float) if values.dtype.kind in "fiub" else np.zeros(values.shape)
    some = np.where(rng.random(numbers.shape) < 0.2, rng.choice((np.nan, np.inf, 1e300, -1e9)), numbers)
    half = numbers[: len(numbers) // 2] if numbers.ndim else numbers
    choices = [
        some, numbers * np.nan, half, numbers.T, numbers[..., None],
        numbers.ravel(), np.zeros((0, *numbers.shape[1:])), numbers.astype("U8"), numbers.astype(complex),
        np.full(numbers.shape, None), numbers.astype(np.int8), numbers * 0, -numbers, numbers[::-1], np.float64(3.0),
    ]  # fmt: skip
    return choices[int(rng.integers(len(choices)))]


def archive_member(path: Path, rng: Rng) -> None:
    """A member of a .zip is lost, renamed, doubled, damaged, or leads out of the folder."""
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    name = sorted(members)[int(rng.integers(len(members)))]
    data = members.pop(name)
    how = int(rng.integers(6))
    if how == 1:
        members[f"../{name}"] = data
    elif how == 2:
        members[f"{name}\x1b[31m"] = data
    elif how == 3:
        members[name] = data[: int(len(data) * rng.random())]
    elif how == 4:
        members[name] = bytes(50 * 2**20)
    elif how == 5:
        try:
            members[name] = json.dumps(changed(json.loads(data), rng)).encode()
        except ValueError:
            members[name] = rng.bytes(len(data))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    path.write_bytes(out.getvalue())


Damage = Callable[[Path, Rng], None]
BYTES: tuple[Damage, ...] = (
    flip_bits, flip_early, huge_header, cut_off, zero_block, append, emptied, noise, shifted, doubled, no_numbers,
)  # fmt: skip
FILES: tuple[Damage, ...] = (
    removed, renamed, renamed_inside, swapped, copied, loop, loop_of_two, dangling, outside, fifo, folder_instead,
)  # fmt: skip
ANY = (*BYTES, *FILES)
TEXTUAL: tuple[Damage, ...] = (text_number, text_line)
DAMAGE_OF: dict[str, tuple[Damage, ...]] = {
    ".json": (json_value, json_value, json_value, json_deep, text_number),
    ".jsonl": (jsonl_value, text_number, text_line),
    ".xml": (xml_value, xml_value, xml_tree, xml_tree, xml_entities, text_number),
    ".yaml": (yaml_tree, yaml_tree, text_number, text_line),
    ".yml": (yaml_tree, yaml_tree, text_number, text_line),
    **dict.fromkeys((".ply", ".stl", ".glb", ".pcd", ".las", ".bin"), (shifted, doubled, no_numbers)),
    ".npz": (archive_array, archive_array, archive_member),
    ".npy": (array,),
    ".r3d": (archive_member,),
    ".pt": (archive_member,),
}
