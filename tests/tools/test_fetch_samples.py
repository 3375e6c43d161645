"""Samples are fetched from where they are said to be, checked, and read by the tests; here from a folder."""

import hashlib
import re
from pathlib import Path
from typing import Any

import pytest

from realsim.core.errors import RealsimError
from tools.fetch_samples import SAMPLES, URL, fetch_sample


@pytest.fixture
def samples(tmp_path: Path) -> dict[str, Any]:
    """One sample in a folder that stands for the repository."""
    files = {"LICENSE": b"free", "data/a.bin": bytes(range(256))}
    for path, data in files.items():
        (tmp_path / "repo" / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "repo" / path).write_bytes(data)
    sums = {path: hashlib.sha256(data).hexdigest() for path, data in files.items()}
    return {"toy": {"repo": "a/b", "commit": "0" * 40, "licence": "MIT", "what": "a toy", "files": sums}}


def url(tmp_path: Path) -> str:
    return f"file://{tmp_path}/repo/{{path}}"


def test_files_come_with_their_licence_and_are_not_fetched_twice(tmp_path: Path, samples: dict[str, Any]) -> None:
    folder = fetch_sample("toy", tmp_path / "out", url(tmp_path), samples)
    assert folder == tmp_path / "out" / "real_captures" / "toy"
    assert (folder / "data/a.bin").read_bytes() == bytes(range(256))
    assert (folder / "LICENSE").read_bytes() == b"free"
    assert "MIT" in (folder / "SOURCE.txt").read_text()
    assert fetch_sample("toy", tmp_path / "out", "file:///nowhere/{path}", samples) == folder
    (folder / "data/a.bin").write_bytes(b"damaged")
    fetch_sample("toy", tmp_path / "out", url(tmp_path), samples)
    assert (folder / "data/a.bin").read_bytes() == bytes(range(256))


def test_another_file_is_refused_and_not_written(tmp_path: Path, samples: dict[str, Any]) -> None:
    (tmp_path / "repo/data/a.bin").write_bytes(b"evil")
    with pytest.raises(RealsimError, match="not the file that is meant"):
        fetch_sample("toy", tmp_path / "out", url(tmp_path), samples)
    assert not (tmp_path / "out/real_captures/toy/data/a.bin").exists()


def test_what_is_not_there_and_what_leads_out_is_refused(tmp_path: Path, samples: dict[str, Any]) -> None:
    with pytest.raises(RealsimError, match="cannot be fetched"):
        fetch_sample("toy", tmp_path / "out", f"file://{tmp_path}/nowhere/{{path}}", samples)
    samples["toy"]["files"] = {"../../../evil": "0"}
    with pytest.raises(RealsimError, match="leads out"):
        fetch_sample("toy", tmp_path / "out", url(tmp_path), samples)


def test_every_sample_is_pinned_free_and_has_its_licence() -> None:
    for sample in SAMPLES.values():
        assert sample["licence"] in ("MIT", "BSD-3-Clause")
        assert re.fullmatch("[0-9a-f]{40}", sample["commit"])
        assert "LICENSE" in sample["files"]
        assert all(re.fullmatch("[0-9a-f]{64}", s) for s in sample["files"].values())
        assert URL.format(path="LICENSE", **sample).startswith("https://raw.githubusercontent.com/")
