"""Many items: one code path, and no failure stops the others."""

from __future__ import annotations

from pathlib import Path

import pytest

from realsim.errors import RealsimError
from realsim.jobs import Job, run_many


def items(tmp_path: Path) -> list[Job]:
    """Two that fail with a message and one that works."""
    bad = [Job(f"bad{i}", ("inspect", str(tmp_path / f"none{i}"))) for i in range(2)]
    return [bad[0], Job("good", ("synth", "--out", str(tmp_path / "synth"), "--frames", "2")), bad[1]]


def check(outcomes: list, tmp_path: Path) -> None:
    assert [o.name for o in outcomes] == ["bad0", "good", "bad1"]
    assert [o.exit_code for o in outcomes] == [2, 0, 2]
    assert "none0" in str(outcomes[0].result)
    assert (tmp_path / "synth").is_dir()


def test_failures_do_not_stop_the_others(tmp_path: Path) -> None:
    check(run_many(items(tmp_path), workers=2), tmp_path)


def test_the_same_on_a_local_ray_cluster_of_two_workers(tmp_path: Path) -> None:
    ray = pytest.importorskip("ray", reason="extra `ray` is not installed")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    try:
        cluster.add_node(num_cpus=1)
        check(run_many(items(tmp_path), ray_address=cluster.address), tmp_path)
        assert not ray.is_initialized()
    finally:
        cluster.shutdown()


def test_no_cluster_is_said(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="extra `ray` is not installed")
    with pytest.raises(RealsimError, match="no Ray cluster"):
        run_many(items(tmp_path), ray_address="127.0.0.1:1")


def test_a_crash_is_an_outcome(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("realsim.jobs.sys.executable", "/bin/false")
    (outcome,) = run_many([Job("a", ("inspect", "x"))])
    assert not outcome.ok
    assert outcome.result["error"] == "Crash"


def test_two_items_of_one_name_are_refused() -> None:
    with pytest.raises(RealsimError, match="same folder"):
        run_many([Job("a", ()), Job("a", ())])
