"""The contact benchmark keeps what it could not finish."""

from pathlib import Path

from benchmarks.contact.meshes import generated, limited, line, save, summary
from benchmarks.store import Store
from realsim.core.files import read_json


def test_a_row_that_takes_too_long_says_so_and_is_kept(tmp_path: Path) -> None:
    row = limited(1, generated("stairs"), "sdf", None)
    assert row["unfinished"].startswith("stopped after 1 s of processor time")
    assert row["unfinished"] in line(row)
    assert any(row["unfinished"] in text for text in summary([row]))
    store = Store(tmp_path / "a.json", ("terrain", "representation"))
    store.add(row)
    missing = save(store, ["stairs"])
    kept = read_json(tmp_path / "a.json")
    assert "sdf" not in missing.get("stairs", [])
    assert kept["rows"][0]["unfinished"] == row["unfinished"]
