"""Damage to files and folders as disks, transfers, editors and attackers do it; everything by a seed.

A damage is a name, what it does to a file, and what it applies to: BYTES and FILES to any file, CONTENT by suffix.
"""

import io
import json
import math
import os
import re
import shutil
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

Rng = np.random.Generator
Damage = Callable[[Path, Rng], Any]
TEXT = (".json", ".txt", ".csv", ".tsv", ".log", ".xml", ".yaml", ".yml", ".traj", ".pincam", ".jsonl", ".obj", ".off")
SMALL = (".json", ".txt", ".xml", ".yaml", ".csv", ".log", ".traj")
BINARY = (".ply", ".stl", ".glb", ".pcd", ".las", ".bin")
ODD_NUMBERS = ("nan", "inf", "-inf", "1e400", "-1", "0", "1e-320", "9" * 400, "0x10", "1,5", "", "abc", "\x1b[31mred")
ODD_VALUES: tuple[Any, ...] = (
    math.nan, math.inf, -1, 0, 1e308, 10**400, 0.5, "", "text", "\x1b]0;title\x07", None, True, [], {}, [[]], [None],
    ["a", "a"], {"a": {"a": {}}}, "../../etc/passwd", "/etc/passwd",
)  # fmt: skip
ODD_ATTRIBUTES = ("nan", "inf", "0", "-1", "1e-9", "1e30", "", "0 0", "abc", "../../x", "/etc/passwd", "1 " * 500)
NAMES = ("\x1b[31mEVIL", "a\x07b", "\x9b31m", "\u202egnp.exe", "new\nline", "'\"<svg>", " ", "\udcff")
BOMB = "\n".join(["a0: &a0 [x]", *(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9))]) + "\n"
"""YAML whose aliases grow by ten a line."""
ODD_YAML = (BOMB, "[" * 5000, "!!python/object/apply:os.system [ls]\n", "? [1, 2]\n: 3\n", "&a [*a]\n")

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
        small = [p for p in files if p.suffix in SMALL]
        path = pick(small if small and rng.random() < 0.5 else files, rng)
        content = [name for name, _, suffixes in CONTENT for s in suffixes if s == path.suffix]
        content += [] if content or path.suffix not in TEXT else TEXTUAL
        parsed = [name for name in content if name not in ANY]
        name = pick([*ANY, *content, *parsed, *parsed], rng)  # what a format's own parser meets, more often
        try:
            DAMAGES[name](path, rng)
        except NO_STRUCTURE:
            pick([*BYTES.values()], rng)(path, rng)  # damaged before: no structure is left to change
        done.append(f"{name} {re.sub('[0-9]+', '#', path.relative_to(folder).as_posix())}")
    return ", ".join(done)


def pick(among: Sequence[Any], rng: Rng) -> Any:
    return among[int(rng.integers(len(among)))]


# ---------------------------------------------------------------- bytes


def of_bytes(change: Callable[[bytes, Rng], bytes]) -> Damage:
    """A damage to a file from one to its bytes."""
    return lambda path, rng: path.write_bytes(change(path.read_bytes(), rng))


def of_text(change: Callable[[str, Rng], str]) -> Damage:
    """A damage to a file from one to its text."""
    return of_bytes(lambda data, rng: change(data.decode("utf-8", "surrogateescape"), rng).encode(
        "utf-8", "surrogateescape"))  # fmt: skip


def put(data: bytes, at: int, new: bytes) -> bytes:
    return data[:at] + new + data[at + len(new) :]


def flip_bits(data: bytes, rng: Rng) -> bytes:
    for at in rng.integers(0, max(len(data), 1), int(rng.choice((1, 4, 32)))) if data else ():
        data = put(data, at, bytes([data[at] ^ 1 << int(rng.integers(8))]))
    return data


def flip_early(data: bytes, rng: Rng) -> bytes:
    """In the first 256 bytes, where headers are."""
    for at in rng.integers(0, max(min(len(data), 256), 1), 3) if data else ():
        data = put(data, at, bytes([int(rng.integers(256))]))
    return data


def huge_header(data: bytes, rng: Rng) -> bytes:
    """A length near the beginning becomes the largest that there is."""
    return put(data, int(rng.integers(0, max(min(len(data) - 4, 200), 1))), b"\xff\xff\xff\x7f")


def zero_block(data: bytes, rng: Rng) -> bytes:
    at = int(rng.integers(0, max(len(data), 1)))
    return put(data, at, bytes(len(data[at : at + 512])))


def shifted(data: bytes, rng: Rng) -> bytes:
    """A byte more or less in the middle: all that follows is off by one."""
    at = int(rng.integers(len(data) + 1))
    return data[:at] + (rng.bytes(1) + data[at:] if rng.random() < 0.5 else data[at + 1 :])


def doubled(data: bytes, rng: Rng) -> bytes:
    """A block stands twice, as after a transfer that was taken up again at the wrong place."""
    at, size = int(rng.integers(len(data) + 1)), int(rng.integers(1, 4096))
    return data[: at + size] + data[at : at + size] + data[at + size :]


def no_numbers(data: bytes, rng: Rng) -> bytes:
    """Some numbers of four or eight bytes become NaN, infinite or enormous."""
    kind = np.dtype(rng.choice(("<f4", "<f8")))
    for at in rng.integers(0, max(len(data) - 8, 1), int(rng.choice((1, 3, 50)))):
        value = np.array(rng.choice((np.nan, np.inf, -np.inf, 1e38, -1e38)), kind).tobytes()
        place = int(at) // 4 * 4 + int(rng.integers(4)) * int(rng.random() < 0.5)  # headers are of any length
        data = put(data, place, value)
    return data


BYTES: dict[str, Damage] = {
    "flip_bits": of_bytes(flip_bits),
    "flip_early": of_bytes(flip_early),
    "huge_header": of_bytes(huge_header),
    "cut_off": of_bytes(lambda data, rng: data[: int(len(data) * rng.random())]),
    "zero_block": of_bytes(zero_block),
    "append": of_bytes(lambda data, rng: data + rng.bytes(int(rng.choice((1, 100, 5000))))),
    "emptied": of_bytes(lambda data, rng: b""),
    "noise": of_bytes(lambda data, rng: rng.bytes(2000)),
    "shifted": of_bytes(shifted),
    "doubled": of_bytes(doubled),
    "no_numbers": of_bytes(no_numbers),
}


# ---------------------------------------------------------------- files


def swapped(path: Path, rng: Rng) -> None:
    if others := sorted(p for p in path.parent.iterdir() if p.is_file() and p != path):
        other = pick(others, rng)
        one, two = path.read_bytes(), other.read_bytes()
        path.write_bytes(two)
        other.write_bytes(one)


def instead(make: Damage) -> Damage:
    """Something else under the name of a file."""
    return lambda path, rng: (path.unlink(), make(path, rng))


FILES: dict[str, Damage] = {
    "removed": lambda path, rng: path.unlink(),
    "renamed": lambda path, rng: path.rename(path.with_name(str(rng.choice(NAMES)) + path.name)),
    # In the middle of what a manifest or a number would find:
    "renamed_inside": lambda p, rng: p.rename(p.with_name(p.stem + str(rng.choice(NAMES)) + p.suffix)),
    "swapped": swapped,
    "copied": lambda path, rng: shutil.copy(path, path.with_name("copy of " + path.name)),
    "loop": instead(lambda path, rng: path.symlink_to(path.name)),
    "loop_of_two": instead(
        lambda p, rng: (p.symlink_to(p.name + "2"), p.with_name(p.name + "2").symlink_to(p.name))),
    "dangling": instead(lambda path, rng: path.symlink_to("/nowhere/at/all")),
    "outside": instead(
        lambda p, rng: p.symlink_to(str(rng.choice(("/etc/passwd", "/proc/self/mem", "/dev/zero", "/dev/null"))))),
    "fifo": instead(lambda path, rng: os.mkfifo(path)),
    "folder_instead": instead(lambda path, rng: path.mkdir()),
}  # fmt: skip


# ---------------------------------------------------------------- what stands in them


def text_number(text: str, rng: Rng) -> str:
    """One number of a text becomes another, or none."""
    place = pick(list(re.finditer(r"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?", text)), rng)
    return text[: place.start()] + str(rng.choice(ODD_NUMBERS)) + text[place.end() :]


def text_line(data: bytes, rng: Rng) -> bytes:
    """A line is lost, doubled, moved or torn."""
    lines = data.splitlines(keepends=True)
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
    return b"".join(lines)


def json_value(text: str, rng: Rng) -> str:
    return json.dumps(changed(json.loads(text), rng))


def jsonl_value(text: str, rng: Rng) -> str:
    lines = text.splitlines()
    at = int(rng.integers(len(lines)))
    lines[at] = json_value(lines[at], rng)
    return "\n".join(lines) + "\n"


def changed(tree: Any, rng: Rng) -> Any:
    """JSON in which one value is another, of another type, lost, of another length, or under another key."""
    spots: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            spots.append((node, key))
            walk(node[key])

    walk(tree)
    if not spots:
        return pick(ODD_VALUES, rng)
    shallow = [s for s in spots if s[0] is tree]
    node, key = pick(shallow if rng.random() < 0.3 else spots, rng)  # most values are numbers of a long list
    how = int(rng.integers(5))
    if how == 0:
        del node[key]
    elif how in (1, 2) and isinstance(node[key], list):
        node[key] = node[key][: len(node[key]) // 2] if how == 1 else node[key] * 2
    elif how == 3 and isinstance(node, dict):
        node[f"{key}\x1b[31m"] = node.pop(key)
    else:
        node[key] = pick(ODD_VALUES, rng)
    return tree


def elements(path: Path) -> tuple[Any, list[tuple[Any, Any]]]:
    """The tree of an XML file, and (parent, child) of all that is in it."""
    tree = ElementTree.parse(path)
    return tree, [(p, c) for p in tree.iter() for c in p]


def xml_value(path: Path, rng: Rng) -> None:
    """An attribute gets another value, or an element is lost, doubled or renamed."""
    tree, pairs = elements(path)
    how = int(rng.integers(5))
    parent, child = pick(pairs, rng)
    if how == 0:
        parent.remove(child)
    elif how == 1:
        parent.append(child)
    elif how == 2:
        child.tag = "geom" if child.tag != "geom" else "body"
    else:
        node = pick([node for node in tree.iter() if node.attrib], rng)
        node.set(pick(sorted(node.attrib), rng), str(rng.choice(ODD_ATTRIBUTES)))
    tree.write(path)


def xml_tree(path: Path, rng: Rng) -> None:
    """Elements are replicated, nested, included or linked without end."""
    tree, pairs = elements(path)
    add, root = ElementTree.SubElement, tree.getroot()
    parent, child = pick(pairs, rng)
    how = int(rng.integers(7))
    parent.remove(child)
    if how == 0:
        add(parent, "replicate", count=str(rng.choice((3, 1000, 10**8))), offset="1 0 0").append(child)
    elif how == 1:
        for _ in range(int(rng.choice((6, 300)))):
            parent = add(parent, "replicate", count="30")
        parent.append(child)
    elif how == 2:
        for _ in range(int(rng.choice((50, 2000)))):
            parent = add(parent, str(rng.choice(("body", "frame", "default"))))
        parent.append(child)
    elif how == 3:
        add(parent, "include", file=str(rng.choice((path.name, "../x.xml", "/etc/passwd", "none"))))
    elif how == 4:
        size = {"width": "99999", "height": "99999"}
        add(add(root, "asset"), "texture", {"name": "big", "type": "2d", "builtin": "flat", **size})
    elif how == 5:
        add(root, "size", memory=str(rng.choice(("900G", "1", "-5", "x"))))
    else:
        body = root.find("worldbody")
        composite = {"type": "cable", "count": str(rng.choice(("3", "90000000", "0"))) + " 1 1", "size": "1"}
        add(parent if body is None else body, "composite", composite)
    tree.write(path)


def yaml_tree(text: str, rng: Rng) -> str:
    """Aliases that grow by ten a line, brackets without end, a tag, a key that is none, a value of another kind."""
    how = int(rng.integers(4))
    if how < 2:
        return pick(ODD_YAML, rng) if how == 0 else text + pick(ODD_YAML, rng)
    place = pick(list(re.finditer(r":[ \t]*\S.*", text)), rng)
    value = "*a8" if how == 2 else json.dumps(pick(ODD_VALUES, rng))
    return (BOMB if how == 2 else "") + text[: place.start()] + f": {value}" + text[place.end() :]


def archive_array(path: Path, rng: Rng) -> None:
    """One array of an .npz."""
    with np.load(path) as store:
        arrays = dict(store)
    name = pick(sorted(arrays), rng)
    how = int(rng.integers(4))
    if how > 1:
        arrays[name] = odd_array(arrays[name], rng)
    elif how == 1:
        arrays[f"{name}\x1b[31m"] = arrays.pop(name)
    else:
        del arrays[name]
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
    return pick(choices, rng)


def archive_member(path: Path, rng: Rng) -> None:
    """A member of a .zip is lost, renamed, doubled, damaged, or leads out of the folder."""
    with zipfile.ZipFile(path) as archive:
        members = {n: archive.read(n) for n in archive.namelist()}
    name = pick(sorted(members), rng)
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
            members[name] = json_value(data.decode(), rng).encode()
        except ValueError:
            members[name] = rng.bytes(len(data))
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for member, content in members.items():
            archive.writestr(member, content)
    path.write_bytes(out.getvalue())


XML_ENTITIES = '<!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><mujoco>&b;</mujoco>'
CONTENT: tuple[tuple[str, Damage, tuple[str, ...]], ...] = (
    ("json_value", of_text(json_value), (".json",) * 3),
    ("json_deep", of_text(lambda text, rng: "[" * 100_000), (".json",)),
    ("jsonl_value", of_text(jsonl_value), (".jsonl",)),
    ("xml_value", xml_value, (".xml",) * 2),
    ("xml_tree", xml_tree, (".xml",) * 2),
    ("xml_entities", of_text(lambda text, rng: XML_ENTITIES), (".xml",)),
    ("yaml_tree", of_text(yaml_tree), (".yaml", ".yml") * 2),
    ("text_number", of_text(text_number), (".json", ".jsonl", ".xml", ".yaml", ".yml")),
    ("text_line", of_bytes(text_line), (".jsonl", ".yaml", ".yml")),
    *((name, BYTES[name], BINARY) for name in ("shifted", "doubled", "no_numbers")),
    ("archive_array", archive_array, (".npz",) * 2),
    ("array", lambda path, rng: np.save(path, odd_array(np.load(path), rng)), (".npy",)),
    ("archive_member", archive_member, (".npz", ".r3d", ".pt")),
)
"""A damage that is listed several times for a suffix is drawn as many times as often."""
TEXTUAL = ("text_number", "text_line")
"""Of files of text that nothing above is for."""
ANY = (*BYTES, *FILES)
DAMAGES = {**BYTES, **FILES, **{name: apply for name, apply, _ in CONTENT}}
