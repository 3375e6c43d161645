"""Written whole or not at all; read with limits."""

import errno
import io
import json
import os
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from realsim.core import files
from realsim.core.errors import RealsimError
from realsim.core.files import parse_yaml


def test_output_folder_appears_only_when_complete(tmp_path: Path) -> None:
    out = tmp_path / "scene"
    with files.output_folder(out) as work:
        (work / "a").write_text("1")
        assert not out.exists()
    assert (out / "a").read_text() == "1"
    assert [p.name for p in tmp_path.iterdir()] == ["scene"]


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_nothing_is_left_after_an_error_or_an_interrupt(tmp_path: Path, error: type[BaseException]) -> None:
    with pytest.raises(error), files.output_folder(tmp_path / "scene") as work:
        (work / "a").write_text("1")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_existing_output_is_kept_unless_overwrite_and_until_the_end(tmp_path: Path) -> None:
    out = tmp_path / "scene"
    out.mkdir()
    (out / "report.json").write_text("old")
    with pytest.raises(RealsimError, match="--overwrite"), files.output_folder(out):
        pass
    with pytest.raises(RuntimeError), files.output_folder(out, overwrite=True):
        raise RuntimeError
    assert (out / "report.json").read_text() == "old"
    with files.output_folder(out, overwrite=True) as work:
        (work / "new").write_text("new")
    assert [p.name for p in out.iterdir()] == ["new"]


def test_a_folder_that_is_not_ours_is_never_replaced(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("x")
    with pytest.raises(RealsimError, match="did not write") as error, files.output_folder(tmp_path, overwrite=True):
        pass
    assert error.value.found == "precious"
    assert (tmp_path / "precious").read_text() == "x"
    (tmp_path / "empty").mkdir()
    with files.output_folder(tmp_path / "empty", overwrite=True) as work:
        (work / "a").write_text("1")
    assert (tmp_path / "empty" / "a").exists()


@pytest.mark.parametrize("source", [".", "capture", "a/../capture"])
def test_an_input_inside_the_output_folder_is_refused(
    source: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "capture").mkdir()
    (tmp_path / "report.json").write_text("{}")
    monkeypatch.chdir(tmp_path)
    with (
        pytest.raises(RealsimError, match="input lies in the output"),
        files.output_folder(Path("."), overwrite=True, source=Path(source)),
    ):
        pass
    assert sorted(p.name for p in tmp_path.iterdir()) == ["capture", "report.json"]
    with files.output_folder(tmp_path / "capture" / "scene", overwrite=True, source=tmp_path / "capture") as work:
        (work / "a").write_text("1")  # beside the frames is fine


def test_output_that_is_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "scene").write_text("")
    for out in (tmp_path / "scene", tmp_path / "scene" / "below" / "it"):
        with pytest.raises(RealsimError, match="is a file"), files.output_folder(out):
            pass


def test_full_disk_is_a_message_and_leaves_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(files.os, "replace", full)
    with pytest.raises(RealsimError, match="free some space"):
        files.write_text(tmp_path / "x.json", "{}")
    assert list(tmp_path.iterdir()) == []


def test_names_cannot_leave_their_folder(tmp_path: Path) -> None:
    assert files.inside(tmp_path, "a/b.png") == tmp_path / "a" / "b.png"
    for name in ("../x", "/etc/passwd", "a/../../x"):
        with pytest.raises(RealsimError, match="leads out"):
            files.inside(tmp_path, name)


def test_json_is_plain_and_broken_json_says_where(tmp_path: Path) -> None:
    text = files.to_json({"a": np.float64(1.5), "b": np.arange(3), "c": float("nan"), "d": (np.bool_(True),)})
    (tmp_path / "x.json").write_text(text)
    assert files.read_json(tmp_path / "x.json") == {"a": 1.5, "b": [0, 1, 2], "c": None, "d": [True]}
    (tmp_path / "y.json").write_text('{"a": 1,\n "b": }')
    with pytest.raises(RealsimError, match="line 2"):
        files.read_json(tmp_path / "y.json")


@pytest.mark.parametrize("text", ["[" * 100_000, "9" * 5000, "[0.5, -1e999]"])
def test_json_of_an_unusual_kind_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(RealsimError, match="broken JSON") as error:
        files.read_json(tmp_path / "x.json")
    assert error.value.file == str(tmp_path / "x.json")


@pytest.mark.parametrize("text", ["dt: 0.02\nkp: 1\ndt: 0.01\n", "a: {b: 1, b: 1}\n"])
def test_a_name_that_stands_twice_in_yaml_is_refused(text: str) -> None:
    with pytest.raises(RealsimError, match="broken YAML") as error:
        parse_yaml(text, Path("deploy.yaml"))
    assert "twice, again in line" in error.value.render()
    assert parse_yaml("a: {b: 1}\nc: {b: 2}\n1: x\n'1': y\n", Path("deploy.yaml")) == {
        "a": {"b": 1}, "c": {"b": 2}, 1: "x", "1": "y",
    }  # fmt: skip


def test_a_file_that_may_not_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "x").write_text("{}")

    def denied(*_: object) -> bytes:
        raise PermissionError(errno.EACCES, "Permission denied")

    with monkeypatch.context() as patch:  # whoever runs the tests may be allowed to read everything
        patch.setattr(Path, "read_bytes", denied)
        with pytest.raises(RealsimError, match="cannot be read") as error:
            files.read_bytes(tmp_path / "x")
        assert error.value.found == "Permission denied"
    monkeypatch.setattr(files.os, "access", lambda path, mode: False)
    with pytest.raises(RealsimError, match="cannot be read"):
        files.check_size(tmp_path / "x")


def test_size_limit(tmp_path: Path) -> None:
    (tmp_path / "big").write_bytes(b"0" * 100)
    with pytest.raises(RealsimError, match="too large"):
        files.read_bytes(tmp_path / "big", limit=99)


def test_digest_depends_on_content_and_boundaries(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"x")
    assert files.digest("ab", "c") != files.digest("a", "bc")
    assert files.digest(np.zeros(4)) != files.digest(np.zeros((2, 2)))
    before = files.digest(tmp_path / "a")
    (tmp_path / "a").write_bytes(b"y")
    assert files.digest(tmp_path / "a") != before


def test_arrays_are_read_without_pickles_and_within_limits(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.arange(3), b=np.zeros(1_000_000))
    found = files.read_npz(path)
    assert list(found["a"]) == [0, 1, 2]
    assert path.stat().st_size < 100_000  # packed well below the limit, unpacked above
    with pytest.raises(RealsimError, match="bytes unpacked"):
        files.read_npz(path, 100_000)
    np.savez(path, a=np.array([{"code": 1}], object))
    with pytest.raises(RealsimError, match="plain numbers"):
        files.read_npz(path)
    path.write_bytes(b"no archive")
    with pytest.raises(RealsimError, match="plain numbers"):
        files.read_npz(path)


def test_an_array_that_claims_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", header.getvalue())
    with pytest.raises(RealsimError, match="plain numbers"):
        files.read_npz(tmp_path / "a.npz")


def test_of_two_runs_into_one_folder_the_later_is_refused(tmp_path: Path) -> None:
    """Both saw an empty place when they began; what the first put there stays, also what is not ours."""
    out = tmp_path / "scene"
    for overwrite, theirs, message in ((False, "report.json", "--overwrite"), (True, "thesis.tex", "did not write")):
        with pytest.raises(RealsimError, match=message), files.output_folder(out, overwrite=overwrite) as work:
            (work / "mine").write_text("1")
            out.mkdir()
            (out / theirs).write_text("first")
        assert [p.name for p in out.iterdir()] == [theirs]
        assert [p.name for p in tmp_path.iterdir()] == ["scene"]
        (out / theirs).unlink()
        out.rmdir()


def test_what_killed_runs_left_goes_with_the_next_run(tmp_path: Path) -> None:
    """Held by nobody: gone, however young. Held by a process, or of another output: left alone."""
    dead, other = tmp_path / ".scene.partial-dead", tmp_path / ".scene2.partial-dead"
    for folder in (dead, other):
        folder.mkdir()
        (folder / "mesh.ply").write_text("x")
    with files.output_folder(tmp_path / "scene"):
        assert not dead.exists()
    with files.output_folder(tmp_path / "a") as held, files.output_folder(tmp_path / "a"):
        assert held.exists()
    assert other.exists()


def test_a_killed_run_leaves_nothing_after_the_next(tmp_path: Path) -> None:
    code = f"""
import os, signal
from pathlib import Path
from realsim.core.files import output_folder
with output_folder(Path({str(tmp_path / "scene")!r})) as work:
    (work / "mesh.ply").write_text("x")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -signal.SIGKILL
    assert len(list(tmp_path.iterdir())) == 1
    with files.output_folder(tmp_path / "scene") as work:
        (work / "mesh.ply").write_text("y")
    assert [p.name for p in tmp_path.iterdir()] == ["scene"]


@pytest.mark.parametrize(
    "target", ["/proc/kmsg", "/proc/self/status", "/dev/zero", "/dev/null", "/sys/kernel/profiling"]
)
def test_what_the_system_makes_up_is_no_file(target: str, tmp_path: Path) -> None:
    (tmp_path / "depth.png").symlink_to(target)
    with pytest.raises(RealsimError):
        files.read_bytes(tmp_path / "depth.png")


@pytest.mark.parametrize("damage", ["no array", "broken header", "zero byte"])
def test_strange_members_of_an_npz(tmp_path: Path, damage: str) -> None:
    path = tmp_path / "run.npz"
    np.savez(path, time=np.arange(3.0))
    header = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (3,), \xfc}"
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("note.txt" if damage == "no array" else "x.npy", b"hello" if damage == "no array" else header)
    if damage == "no array":
        assert list(files.read_npz(path)) == ["time"]
    elif damage == "broken header":
        with pytest.raises(RealsimError, match="plain numbers"):
            files.read_npz(path)
    else:
        with pytest.raises(RealsimError, match="cannot be read"):
            files.read_npz(Path(f"{path}\0"))


@pytest.mark.parametrize("name", ["loop.png", "zero\0.png"])
def test_a_name_that_cannot_be_followed_is_said(tmp_path: Path, name: str) -> None:
    (tmp_path / "loop.png").symlink_to("loop.png")
    with pytest.raises(RealsimError, match=r"cannot be (followed|read)"):
        files.check_size(files.inside(tmp_path, name))


def test_an_output_whose_name_is_too_long_and_an_input_that_is_a_circle(tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to("circle")
    with pytest.raises(RealsimError, match="too long") as caught, files.output_folder(tmp_path / ("a" * 300)):
        pass
    assert "shorter" in str(caught.value)
    with files.output_folder(tmp_path / "out", source=tmp_path / "circle"):
        pass


def test_names_cannot_control_the_terminal() -> None:
    name = "a\x1b[31mEVIL\x1b]0;title\x07\x9b2J\u202eb\tc"
    shown = RealsimError("a file", file=name, hint="x").render()
    assert "\x1b" not in shown
    assert shown == "a file\n  file: a\\x1b[31mEVIL\\x1b]0;title\\x07\\x9b2J\\u202eb\tc\n  do: x"
    text = files.to_json({name: name})
    assert all(c.isprintable() or c in "\n\u202e" for c in text)
    assert json.loads(text) == {name: name}


def test_names_that_are_no_text_can_be_written(tmp_path: Path) -> None:
    name = os.fsdecode(b"a\xff")
    assert json.loads(files.to_json({"name": name})) == {"name": name}
    files.write_text(tmp_path / "a.json", files.to_json([name]))
    files.write_text(tmp_path / "a.txt", name)
    assert (tmp_path / "a.txt").read_text() == "a\\udcff"


def test_a_name_that_is_twice_in_an_object_is_named_unless_it_says_the_same(tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text('{"a": 1, "a": 1}')
    assert files.read_json(tmp_path / "x.json") == {"a": 1}
    (tmp_path / "x.json").write_text('[{"fx": 1, "fy": 1, "fx": 2}]')
    with pytest.raises(RealsimError, match="'fx' twice"):
        files.read_json(tmp_path / "x.json")


def test_a_whole_number_without_end_is_no_json(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("1" + "0" * 400)
    with pytest.raises(RealsimError, match="401 digits"):
        files.read_json(tmp_path / "a.json")


def test_parents_made_for_an_output_that_failed_are_gone(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="disk"), files.output_folder(tmp_path / "a" / "b" / "c"):
        raise OSError("disk")
    assert not list(tmp_path.iterdir())


def test_a_member_that_cannot_be_checked_hides_no_damage(tmp_path: Path) -> None:
    """An unknown way of packing ended the search, and the flipped bit in the next member was read as a number."""
    path = tmp_path / "a.pt"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("first", b"1234")
        archive.writestr("second", b"5678")
    sound = path.read_bytes()
    assert files.archive_damage(path) is None
    path.write_bytes(sound.replace(b"5678", b"5679"))
    assert "second" in (files.archive_damage(path) or "")
    broken = bytearray(sound.replace(b"5678", b"5679"))
    entry = sound.index(b"PK\x01\x02")
    broken[entry + 10 : entry + 12] = broken[8:10] = b"\x63\x00"  # packed in way 99
    path.write_bytes(broken)
    assert "first" in (files.archive_damage(path) or "")
    path.write_bytes(sound[:-30])  # the list of members is cut off
    assert "list of members" in (files.archive_damage(path) or "")
    path.write_bytes(b"an old .pt is no archive")
    assert files.archive_damage(path) is None


def test_a_link_that_leads_out_of_a_folder_is_named_with_its_target(tmp_path: Path) -> None:
    (tmp_path / "store").mkdir()
    (tmp_path / "capture").symlink_to(tmp_path / "real", target_is_directory=True)
    (tmp_path / "real").mkdir()
    (tmp_path / "real" / "rgb").symlink_to(tmp_path / "store", target_is_directory=True)
    with pytest.raises(RealsimError) as refused:
        files.inside(tmp_path / "capture", "rgb/0.png")
    assert refused.value.found == f"rgb/0.png, a link to {tmp_path / 'store' / '0.png'}"
    with pytest.raises(RealsimError) as refused:
        files.inside(tmp_path / "capture", "../0.png")
    assert refused.value.found == "../0.png"
