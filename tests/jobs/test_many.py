"""Many items through every executor: one code path, no failure stops the others, nothing is done twice."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from realsim.cli.commands import other_arguments, set_arguments
from realsim.cli.commands.many import DROPPED
from realsim.core.errors import RealsimError
from realsim.jobs import Job, ManyConfig, make_job, run_many
from tests.gap.truth import ARM


def items(tmp_path: Path) -> list[Job]:
    """One that fails with a message and one that works."""
    (tmp_path / "model.xml").write_text(ARM)
    out = str(tmp_path / "case")
    good = Job("good", "diagnose", ("--init", str(tmp_path / "model.xml"), "--out", out), (out,))
    return [Job("bad", "inspect", (str(tmp_path / "none"),)), good]


def check(tmp_path: Path, config: ManyConfig) -> None:
    outcomes = run_many(items(tmp_path), tmp_path / "jobs", config)
    assert [o.name for o in outcomes] == ["bad", "good"]
    assert [o.exit_code for o in outcomes] == [2, 0]
    assert "none" in str(outcomes[0].result)
    before = (tmp_path / "case" / "log.json").stat().st_mtime_ns
    again = run_many(items(tmp_path), tmp_path / "jobs")  # wherever it was done
    assert [o.kept for o in again] == [False, True], "what failed is tried again, what is done is kept"
    assert (tmp_path / "case" / "log.json").stat().st_mtime_ns == before


def test_here(tmp_path: Path) -> None:
    check(tmp_path, ManyConfig(jobs=2))
    # The machine went down between the output and the note that it is done: what it left may be replaced.
    job = items(tmp_path)[1]
    (tmp_path / "jobs" / job.key / "result.json").unlink()
    (outcome,) = run_many([job], tmp_path / "jobs")
    assert outcome.ok, outcome.result
    assert not outcome.kept


@pytest.mark.slow
def test_as_a_slurm_array_run_by_submitits_local_executor(tmp_path: Path) -> None:
    pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    check(tmp_path, ManyConfig(executor="slurm", slurm="cluster=local,timeout_min=5"))
    folder = tmp_path / "jobs" / "slurm"
    assert folder.stat().st_mode & 0o077 == 0, "what submitit pickles is ours alone"


def test_a_slurm_job_that_is_lost_is_a_failure_with_its_name(tmp_path: Path) -> None:
    pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    job = replace(items(tmp_path)[0], cwd=str(tmp_path / "not_on_that_machine"))
    (outcome,) = run_many([job], tmp_path, ManyConfig(executor="slurm", slurm="cluster=local"))
    assert (outcome.name, outcome.exit_code, outcome.result["error"]) == ("bad", 1, "Crash")
    assert "not_on_that_machine" in outcome.result["message"]


def test_slurm_that_is_not_there_or_not_so_is_said(tmp_path: Path) -> None:
    pytest.importorskip("submitit", reason="extra `slurm` is not installed")
    for slurm in ("cluster=none", "cluster=local,nonsense", "cluster=local,slurm_no_such=1"):
        with pytest.raises(RealsimError, match=r"Slurm|parameter"):
            run_many(items(tmp_path), tmp_path, ManyConfig(executor="slurm", slurm=slurm))


def test_on_a_local_ray_cluster(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    ray = pytest.importorskip("ray", reason="extra `ray` is not installed")
    from ray.cluster_utils import Cluster

    monkeypatch.setenv("RAY_worker_niceness", "0")  # else 15: it waits for whatever else runs
    # A worker less and no autoscaler are some seconds less of imports.
    head = {"num_cpus": 1, "include_dashboard": False, "no_monitor": True}
    cluster = Cluster(initialize_head=True, head_node_args=head)
    try:
        check(tmp_path, ManyConfig(ray=cluster.address))
        assert not ray.is_initialized()
    finally:
        cluster.shutdown()


def test_no_cluster_is_said(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="extra `ray` is not installed")
    with pytest.raises(RealsimError, match="no Ray cluster"):
        run_many(items(tmp_path), tmp_path, ManyConfig(ray="127.0.0.1:1"))


def instead(monkeypatch: pytest.MonkeyPatch, code: str) -> None:
    """Jobs run Python code instead of their command; its argument is the job's name."""
    monkeypatch.setattr(Job, "command_line", property(lambda job: [sys.executable, "-c", code, job.name]))


@pytest.mark.parametrize(
    ("code", "exit_code", "message"),
    [
        ("import os; os.kill(os.getpid(), 9)", -9, "killed by signal 9"),
        ("print('no json')", 0, "ended without a result"),
        ("import sys; print('out of luck', file=sys.stderr); sys.exit(1)", 1, "ended without a result"),
    ],
)
def test_a_crash_is_an_outcome_and_stops_no_other(
    code: str, exit_code: int, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    instead(monkeypatch, f"import sys\nif sys.argv[1] == 'b': print('{{}}')\nelse:\n exec({code!r})")
    first, second = run_many([Job("a", "inspect"), Job("b", "inspect")], tmp_path, ManyConfig(jobs=2))
    assert first.exit_code == exit_code
    assert message in first.result["message"]
    assert ("out of luck" in first.result["found"]) == ("luck" in code)
    assert second.ok


def test_an_interrupt_stops_what_is_not_done(tmp_path: Path) -> None:
    """Ctrl-C for the command as a whole: nothing of it goes on, and the next run does the rest."""
    code = (
        "import sys; from pathlib import Path; from realsim.jobs import *\n"
        "outs = [f'{sys.argv[1]}/{name}' for name in 'ab']\n"
        "jobs = [Job(out[-1], 'synth', ('--out', out, '--frames', '400'), (out,)) for out in outs]\n"
        "run_many(jobs, Path(sys.argv[1]) / 'jobs')"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)], stderr=subprocess.PIPE)
    end = time.monotonic() + 240
    while not list(tmp_path.glob(".?.partial-*")):  # the first job writes
        assert time.monotonic() < end, process.poll()
        time.sleep(0.05)
    process.send_signal(2)
    process.wait(240)
    assert not list((tmp_path / "jobs").glob("*/result.json"))
    assert not any((tmp_path / name).exists() for name in "ab")
    assert not list(tmp_path.glob(".?.partial-*"))


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a command runs to its end")
def test_the_command_of_a_killed_process_ends_with_it(tmp_path: Path) -> None:
    code = (
        "import sys; from pathlib import Path; from realsim.jobs import *\n"
        "out = f'{sys.argv[1]}/a'\n"
        "run_many([Job('a', 'synth', ('--out', out, '--frames', '400'), (out,))], Path(sys.argv[1]) / 'jobs')"
    )
    process = subprocess.Popen([sys.executable, "-c", code, str(tmp_path)])
    end = time.monotonic() + 240
    while not list(tmp_path.glob(".a.partial-*")):
        assert time.monotonic() < end, process.poll()
        time.sleep(0.05)
    process.kill()
    process.wait(60)
    while list(tmp_path.glob(".a.partial-*")):  # it cleans up
        assert time.monotonic() < end
        time.sleep(0.05)
    assert not (tmp_path / "a").exists()


def test_an_output_that_is_there_fails_its_item_alone_and_stays(tmp_path: Path) -> None:
    (bad, good), mine = items(tmp_path), tmp_path / "case" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("precious")
    outcomes = run_many([good, bad], tmp_path / "jobs", ManyConfig(jobs=2))
    assert [o.exit_code for o in outcomes] == [2, 2]
    assert "not empty" in outcomes[0].result["message"]
    forced = replace(good, arguments=(*good.arguments, "--overwrite"))
    (outcome,) = run_many([forced], tmp_path / "jobs")
    assert "did not write" in outcome.result["message"]
    assert mine.read_text() == "precious"


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"name": 3}', '{"exit_code": 0}'])
def test_a_damaged_result_is_made_again(damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    instead(monkeypatch, "print('{}')")
    job = Job("a", "inspect")
    run_many([job], tmp_path)
    (tmp_path / job.key / "result.json").write_text(damage)
    (outcome,) = run_many([job], tmp_path)
    assert outcome.ok
    assert not outcome.kept


def test_a_lost_output_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = tmp_path / "made"
    instead(monkeypatch, f"import os; os.makedirs({str(made)!r}); print('{{}}')")
    job = Job("a", "inspect", folders=(str(made),))
    assert [run_many([job], tmp_path / "jobs")[0].kept for _ in range(2)] == [False, True]
    made.rmdir()
    assert not run_many([job], tmp_path / "jobs")[0].kept


def test_two_items_of_one_name_are_refused(tmp_path: Path) -> None:
    with pytest.raises(RealsimError, match="same folder"):
        run_many([Job("a", "inspect"), Job("a", "inspect", ("x",))], tmp_path)


def test_no_job_at_a_time_is_refused() -> None:
    with pytest.raises(RealsimError):
        ManyConfig(jobs=0)


def test_the_options_of_many_are_not_those_of_one() -> None:
    set_arguments(["a", "b", "--out", "x", "--jobs=2", "--executor", "slurm", "--slurm", "p=1", "--seed", "3"])
    assert other_arguments(DROPPED, ["a", "b"]) == ("--seed", "3")
    for name in ("jobs", "executor", "ray", "slurm"):
        assert f"--{name}" in DROPPED


def test_the_same_job_has_the_same_key_and_any_change_another() -> None:
    job = Job("a", "inspect", inputs={"/x": "1"}, cwd="/")
    assert Job("a", "inspect", inputs={"/x": "1"}, cwd="/").key == job.key
    changes: list[dict[str, object]] = [
        {"name": "b"}, {"command": "contact"}, {"arguments": ("b",)}, {"inputs": {"/x": "2"}}, {"cwd": "/tmp"},
        {"version": "0"}, {"folders": ("/o",)},
    ]  # fmt: skip
    assert len({job.key, *(replace(job, **change).key for change in changes)}) == 1 + len(changes)  # type: ignore[arg-type]
    assert len(replace(job, name="\N{SNOWMAN}" * 80).key.encode()) < 255


def test_inputs_are_known_by_names_sizes_and_times(tmp_path: Path) -> None:
    source = tmp_path / "capture"
    (source / "depth").mkdir(parents=True)
    (source / "depth" / "0.png").write_bytes(b"0")
    (tmp_path / "model.onnx").write_bytes(b"m")

    def key() -> str:
        return make_job("reconstruct", source, source / "out", ("--model", str(tmp_path / "model.onnx"))).key

    first = key()
    (source / "out").mkdir()
    (source / "out" / "scene.xml").write_text("made")
    assert key() == first, "the output is no input"
    os.utime(tmp_path / "model.onnx", (1, 1))
    second = key()
    (source / "depth" / "1.png").write_bytes(b"1")
    assert len({first, second, key()}) == 3


def test_a_job_reads_relative_paths_where_it_was_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a").mkdir()
    assert make_job("inspect", Path("a"), Path("out")).cwd == str(tmp_path)
    assert make_job("inspect", Path("a"), Path("out")).arguments[0] == str(tmp_path / "a")
