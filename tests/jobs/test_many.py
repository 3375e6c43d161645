"""Many items through every executor: one code path, no failure stops the others, nothing is done twice."""

from __future__ import annotations

import json
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest

from realsim.cli.command_line import main
from realsim.core.errors import RealsimError
from realsim.jobs import FOLDER, Job, ManyConfig, Queue, make_job, run_many


def items(tmp_path: Path) -> list[Job]:
    """Two that fail with a message and one that works."""
    bad = [Job(f"bad{i}", "inspect", (str(tmp_path / f"none{i}"),)) for i in range(2)]
    out = str(tmp_path / "synth")
    good = Job("good", "synth", ("--out", out, "--frames", "2", "--width", "80"), out, (out,))
    return [bad[0], good, bad[1]]


def check(tmp_path: Path, config: ManyConfig) -> None:
    queue = Queue(tmp_path / "jobs")
    outcomes = run_many(items(tmp_path), queue, config)
    assert [o.name for o in outcomes] == ["bad0", "good", "bad1"]
    assert [o.exit_code for o in outcomes] == [2, 0, 2]
    assert "none0" in str(outcomes[0].result)
    assert (tmp_path / "synth").is_dir()
    before = (tmp_path / "synth" / "truth" / "truth.json").stat().st_mtime_ns
    again = run_many(items(tmp_path), queue, config)
    assert [o.kept for o in again] == [False, True, False], "what failed is tried again, what is done is kept"
    assert (tmp_path / "synth" / "truth" / "truth.json").stat().st_mtime_ns == before


def test_here(tmp_path: Path) -> None:
    check(tmp_path, ManyConfig(jobs=2))


def test_as_a_slurm_array_run_by_submitits_local_executor(tmp_path: Path) -> None:
    pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    check(tmp_path, ManyConfig(executor="slurm", slurm="cluster=local,timeout_min=5"))
    folder = tmp_path / "jobs" / "slurm"
    assert folder.stat().st_mode & 0o077 == 0, "what submitit pickles is ours alone"


def test_what_slurm_has_already_is_not_submitted_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    submitit = pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    monkeypatch.setattr("realsim.jobs.executors.run_key", died)  # the jobs stay as they are
    config = ManyConfig(executor="slurm", slurm="cluster=local", wait=False)
    queue = Queue(tmp_path / "jobs")

    def numbers() -> list[str]:
        outcomes = run_many(items(tmp_path), queue, config)
        assert {o.result["state"] for o in outcomes} == {"waiting"}
        return [(queue.folder / key / "slurm.txt").read_text() for key in queue.all()]

    first = numbers()
    with monkeypatch.context() as patch:
        patch.setattr(submitit.LocalJob, "done", lambda job: False)
        assert numbers() == first
    (queue.folder / queue.all()[0] / "slurm.txt").write_text("../../x")
    assert numbers() != first, "what Slurm has lost, or what is no number of a job, is submitted again"


def test_a_slurm_job_that_is_gone_is_a_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    monkeypatch.setattr("realsim.jobs.LATE", 0.5)
    monkeypatch.setattr("realsim.jobs.executors.run_key", died)
    (outcome,) = run_many(items(tmp_path)[:1], Queue(tmp_path), ManyConfig(executor="slurm", slurm="cluster=local"))
    assert outcome.result["error"] == "Crash"
    assert "Slurm job" in outcome.result["message"]


def died(folder: str, key: str) -> None:
    """In place of run_key: it ends without a result."""
    raise MemoryError


def test_slurm_that_is_not_there_or_not_so_is_said(tmp_path: Path) -> None:
    pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    for slurm in ("cluster=none", "cluster=local,nonsense", "cluster=local,slurm_no_such=1"):
        with pytest.raises(RealsimError, match=r"Slurm|parameter"):
            run_many(items(tmp_path), Queue(tmp_path), ManyConfig(executor="slurm", slurm=slurm))


def test_on_a_local_ray_cluster_of_two_workers(tmp_path: Path) -> None:
    ray = pytest.importorskip("ray", reason="extra `ray` is not installed")
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 2, "include_dashboard": False})
    try:
        check(tmp_path, ManyConfig(ray=cluster.address))
        assert not ray.is_initialized()
    finally:
        cluster.shutdown()


def test_no_cluster_is_said(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="extra `ray` is not installed")
    with pytest.raises(RealsimError, match="no Ray cluster"):
        run_many(items(tmp_path), Queue(tmp_path), ManyConfig(ray="127.0.0.1:1"))


def test_by_workers_that_somebody_starts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    command = ["reconstruct", str(tmp_path / "a"), str(tmp_path / "b"), "--out", str(tmp_path / "out"), "--json"]
    assert main([*command, "--executor", "worker", "--no-wait"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["pending"] == 2
    assert [item["result"] for item in said["items"]] == [{"state": "waiting"}] * 2
    done = subprocess.run(
        [sys.executable, "-m", "realsim", "worker", str(tmp_path / "out"), "--json"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert [item["exit_code"] for item in json.loads(done.stdout)["items"]] == [2, 2]
    assert main([*command, "--executor", "worker", "--no-wait"]) == 0, "failures are set to wait again"
    assert json.loads(capsys.readouterr().out)["pending"] == 2
    assert main(["worker", str(tmp_path / "out" / FOLDER), "--cancel", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["cancelled"] == 2
    assert main(["worker", str(tmp_path / "none"), "--json"]) == 2
    assert "no jobs" in json.loads(capsys.readouterr().out)["message"]


def test_an_interrupt_cancels_what_is_not_done(tmp_path: Path) -> None:
    """Ctrl-C for the command as a whole: nothing of it goes on, and the next run does the rest."""
    code = (
        "import sys; from pathlib import Path; from realsim.jobs import *\n"
        "jobs = [Job(n, 'synth', ('--out', f'{sys.argv[1]}/{n}', '--frames', '400')) for n in 'ab']\n"
        "run_many(jobs, Queue(Path(sys.argv[1]) / 'jobs'))"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stderr=subprocess.PIPE)
    queue = Queue(tmp_path / "jobs")
    end = time.monotonic() + 240
    while not list(tmp_path.glob(".?.partial-*")):  # the first job writes
        assert time.monotonic() < end, process.poll()
        time.sleep(0.05)
    process.send_signal(2)
    process.wait(240)
    assert [queue.result(key).exit_code for key in queue.all()] == [130, 130]  # type: ignore[union-attr]
    assert not any((tmp_path / name).exists() for name in "ab")


def test_an_output_that_is_there_fails_its_item_alone_and_stays(tmp_path: Path) -> None:
    jobs = items(tmp_path)
    (tmp_path / "synth").mkdir()
    (tmp_path / "synth" / "mine.txt").write_text("precious")
    outcomes = run_many(jobs, Queue(tmp_path / "jobs"), ManyConfig(jobs=2))
    assert [o.exit_code for o in outcomes] == [2, 2, 2]
    assert "not empty" in outcomes[1].result["message"]
    forced = replace(jobs[1], arguments=(*jobs[1].arguments, "--overwrite"))
    (outcome,) = run_many([forced], Queue(tmp_path / "jobs"))
    assert "did not write" in outcome.result["message"]
    assert (tmp_path / "synth" / "mine.txt").read_text() == "precious"


def test_an_attempt_after_a_lost_one_may_replace_what_that_left(tmp_path: Path) -> None:
    """The worker was killed between the output and the note that it is done."""
    job = items(tmp_path)[1]
    queue = Queue(tmp_path / "jobs")
    key = queue.submit(job)
    assert main(["synth", *job.arguments, "--quiet"]) == 0
    (queue.folder / key / "free.0").rename(queue.folder / key / "free.1")
    (outcome,) = run_many([job], queue)
    assert outcome.ok, outcome.result


def test_two_items_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RealsimError, match="same folder"):
        run_many([Job("a", "inspect"), Job("a", "inspect", ("x",))], Queue(tmp_path))


def test_what_one_process_has_another_waits_for(tmp_path: Path) -> None:
    """Two people start the same command: each item is done once, and both see the result."""
    job = items(tmp_path)[1]
    found: list[object] = []
    threads = [
        threading.Thread(target=lambda: found.extend(run_many([job], Queue(tmp_path / "jobs")))) for _ in range(2)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert [o.exit_code for o in found] == [0, 0]  # type: ignore[attr-defined]


@pytest.mark.parametrize("config", [{"jobs": 0}, {"wait": False}, {"wait": False, "ray": "auto"}])
def test_settings_that_make_no_sense_are_refused(config: dict[str, object]) -> None:
    with pytest.raises(RealsimError):
        ManyConfig(**config)  # type: ignore[arg-type]


def test_the_options_of_many_are_not_those_of_one(tmp_path: Path) -> None:
    from realsim.cli.commands import other_arguments, set_arguments
    from realsim.cli.commands.many import DROPPED

    set_arguments(
        ["a", "b", "--out", "x", "--jobs=2", "--no-wait", "--executor", "worker", "--slurm", "p=1", "--seed", "3"]
    )
    assert other_arguments(DROPPED, ["a", "b"]) == ("--seed", "3")
    set_arguments(["a", "--no_wait", "--seed", "3"])
    assert other_arguments(DROPPED, ["a"]) == ("--seed", "3")
    for name in ("jobs", "executor", "ray", "slurm", "wait"):
        assert f"--{name}" in DROPPED


def test_a_job_reads_relative_paths_where_it_was_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()
    assert make_job("inspect", Path("a"), Path("out")).cwd == str(tmp_path)
    assert make_job("inspect", Path("a"), Path("out")).arguments[0] == str(tmp_path / "a")
