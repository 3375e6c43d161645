"""Jobs in a folder: claimed once, taken over when a worker is lost, done once, never run when they are damaged."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from realsim.core.errors import RealsimError
from realsim.jobs import Job, Outcome, Queue, carry_out, make_job, run_key, work, working
from realsim.jobs.queue import ATTEMPTS, worker_name

WORKER = """
import sys
from pathlib import Path
from realsim.jobs import Queue, work, working

working.command = lambda job, claim: [sys.executable, "-c", CODE, job.name, str(claim.attempt)]
working.POLL = 0.05
work(Queue(Path(sys.argv[1])))
"""
"""A worker whose jobs run CODE instead of a realsim command."""


def a_job(name: str = "a", **fields: object) -> Job:
    return replace(Job(name, "inspect", (name,), cwd="/"), **fields)  # type: ignore[arg-type]


def start(folder: Path, code: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, "-c", f"CODE = {code!r}\n{WORKER}", str(folder)])


ENOUGH = 240.0
"""Seconds after which what is waited for will never happen, on however busy a machine."""


def until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + ENOUGH
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.05)


def when(condition: Callable[[], object], do: Callable[[], object]) -> None:
    """Do it in a thread, as soon as the condition holds."""

    def wait() -> None:
        until(condition)
        do()

    threading.Thread(target=wait, daemon=True).start()


def sleeps(began: Path) -> str:
    """Code of a job that says when it begins, and would take longer than anybody waits."""
    return f"import time; open({str(began)!r}, 'w').close(); time.sleep(600)"


@pytest.fixture
def instead(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Jobs run Python code instead of their command; arguments are the job's name and the attempt."""
    monkeypatch.setattr(working, "POLL", 0.05)

    def use(code: str) -> None:
        monkeypatch.setattr(
            working, "command", lambda job, claim: [sys.executable, "-c", code, job.name, str(claim.attempt)]
        )

    return use


SAY = "import sys; print('{\"said\": \"' + sys.argv[1] + '\"}')"


def test_the_same_job_has_the_same_key_and_any_change_another() -> None:
    job = a_job(inputs={"/x": "1"})
    assert a_job(inputs={"/x": "1"}).key == job.key
    changes: list[dict[str, object]] = [
        {"name": "b"}, {"command": "contact"}, {"arguments": ("b",)}, {"output": "/o"}, {"inputs": {"/x": "2"}},
        {"cwd": "/tmp"}, {"version": "0"}, {"folders": ("/o",)},
    ]  # fmt: skip
    assert len({job.key, *(replace(job, **change).key for change in changes)}) == 1 + len(changes)  # type: ignore[arg-type]


def test_a_job_survives_its_file(tmp_path: Path) -> None:
    queue, job = Queue(tmp_path), a_job(folders=("/none",), inputs={"/x": "1"})
    assert queue.job(queue.submit(job)) == job


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


def test_of_many_who_claim_a_job_one_gets_it(tmp_path: Path) -> None:
    keys = [Queue(tmp_path).submit(a_job(str(number))) for number in range(8)]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)  # threads take turns as often as they can: between any two steps of a claim
    try:
        with ThreadPoolExecutor(16) as pool:
            for key in keys:
                claims = list(pool.map(lambda _, key=key: Queue(tmp_path).claim(key), range(64)))
                assert sum(claim is not None for claim in claims) == 1
    finally:
        sys.setswitchinterval(interval)


def test_the_same_job_submitted_by_many_is_one_job_and_is_done_once(
    tmp_path: Path, instead: Callable[[str], None]
) -> None:
    with ThreadPoolExecutor(8) as pool:
        keys = set(pool.map(lambda _: Queue(tmp_path).submit(a_job()), range(32)))
    assert len(keys) == len(Queue(tmp_path).all()) == 1
    instead(f"open({str(tmp_path / 'runs')!r}, 'a').write('x'); print('{{}}')")
    threads = [threading.Thread(target=run_key, args=(str(tmp_path), keys.copy().pop())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    Queue(tmp_path).submit(a_job())
    work(Queue(tmp_path))
    assert (tmp_path / "runs").read_text() == "x"
    assert not [p.name for p in tmp_path.iterdir() if p.name.startswith((".new", ".old", ".now"))]


def test_two_workers_share_the_jobs(tmp_path: Path) -> None:
    queue = Queue(tmp_path / "jobs")
    names = [f"job{i}" for i in range(12)]
    keys = [queue.submit(a_job(name)) for name in names]
    code = f"""
import os, pathlib, sys, time
here = pathlib.Path({str(tmp_path)!r})
(here / f"by-{{os.getppid()}}").touch()
while len(list(here.glob("by-*"))) < 2:  # whoever comes first leaves a job to the other
    time.sleep(.02)
open(here / "runs", "a").write(sys.argv[1] + "\\n")
print("{{}}")
"""
    workers = [start(queue.folder, code) for _ in range(2)]
    assert [worker.wait(ENOUGH) for worker in workers] == [0, 0]
    assert sorted((tmp_path / "runs").read_text().split()) == sorted(names)
    made_by = {json.loads((queue.folder / key / "result.json").read_text())["worker"] for key in keys}
    assert len(made_by) == 2


def test_the_job_of_a_killed_worker_is_taken_over(tmp_path: Path) -> None:
    """kill -9: the worker cannot say that it goes."""
    queue = Queue(tmp_path / "jobs", lease=1.0)
    key = queue.submit(a_job())
    code = f"""
import sys, time
open({str(tmp_path / "began")!r}, "a").write("x")
time.sleep(600 if sys.argv[2] == "1" else 0)
print('{{"attempt": ' + sys.argv[2] + '}}')
"""
    first = start(queue.folder, code)
    until((tmp_path / "began").exists)
    first.send_signal(signal.SIGKILL)
    first.wait()
    second = start(queue.folder, code)
    assert second.wait(ENOUGH) == 0
    outcome = queue.result(key)
    assert outcome is not None
    assert outcome.result == {"attempt": 2}
    assert (tmp_path / "began").read_text() == "xx"


@pytest.mark.skipif(sys.platform != "linux", reason="Linux ends a process with its parent")
def test_the_command_of_a_killed_worker_ends_with_it_and_leaves_nothing(tmp_path: Path) -> None:
    queue = Queue(tmp_path / "jobs")
    queue.submit(Job("a", "synth", ("--out", str(tmp_path / "out" / "a"), "--frames", "500")))
    code = "import sys; from pathlib import Path; from realsim.jobs import *; work(Queue(Path(sys.argv[1])))"
    worker = subprocess.Popen([sys.executable, "-c", code, str(queue.folder)])
    until(lambda: list((tmp_path / "out").glob(".a.partial-*/*")))  # it is at work
    (command,) = Path(f"/proc/{worker.pid}/task/{worker.pid}/children").read_text().split()
    worker.send_signal(signal.SIGKILL)
    worker.wait()
    until(lambda: not _alive(int(command)))
    assert list((tmp_path / "out").glob("*")) == []


def _alive(process: int) -> bool:
    """A dead process that nobody has asked after counts as dead."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_a_silent_worker_of_another_machine_loses_its_job_and_does_not_spoil_the_result(tmp_path: Path) -> None:
    queue = Queue(tmp_path, lease=30.0)
    key = queue.submit(a_job())
    mine = queue.claim(key)
    assert mine is not None
    elsewhere = mine.ticket.rename(mine.ticket.with_name("held.1.other-1-1.abc"))
    assert queue.claim(key) is None, "it has just been seen"
    os.utime(elsewhere, (time.time() - 31,) * 2)
    late = replace(mine, ticket=elsewhere)
    again = queue.claim(key)
    assert again is not None
    assert again.attempt == 2
    assert not queue.beat(late)
    queue.finish(late, Outcome("a", 0, {"by": "late"}))
    assert queue.result(key) is None
    queue.finish(again, Outcome("a", 0, {"by": "again"}))
    found = queue.result(key)
    assert found is not None
    assert found.result == {"by": "again"}


def test_a_worker_that_lost_its_job_stops_its_command(tmp_path: Path, instead: Callable[[str], None]) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(a_job())
    instead(sleeps(tmp_path / "began"))
    claim = queue.claim(key)
    assert claim is not None
    when((tmp_path / "began").exists, lambda: claim.ticket.rename(claim.ticket.with_name("held.2.other-1-1.abc")))
    began = time.monotonic()
    carry_out(queue, claim)
    assert time.monotonic() - began < ENOUGH
    assert queue.result(key) is None
    assert queue.running(key) == "other-1-1.abc"


def test_a_job_that_kills_its_workers_is_given_up(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(a_job())
    (tmp_path / key / "free.0").rename(tmp_path / key / f"free.{ATTEMPTS}")
    (outcome,) = work(queue)
    assert outcome.result["error"] == "Crash"
    assert "workers were lost" in outcome.result["message"]


def test_an_interrupted_worker_gives_its_job_back(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(a_job())
    worker = start(tmp_path, sleeps(tmp_path / "began"))
    until((tmp_path / "began").exists)
    worker.send_signal(signal.SIGINT)
    worker.wait(ENOUGH)
    assert (tmp_path / key / "free.0").exists()
    assert queue.result(key) is None


def test_a_command_that_something_else_stops_is_tried_again_but_not_for_ever(
    tmp_path: Path, instead: Callable[[str], None]
) -> None:
    queue = Queue(tmp_path)
    queue.submit(a_job())
    instead(f"import sys; open({str(tmp_path / 'runs')!r}, 'a').write('x'); sys.exit(130)")
    (outcome,) = [o for o in work(queue) if o is not None]
    assert not outcome.ok
    assert (tmp_path / "runs").read_text() == "x" * ATTEMPTS


def test_cancelled_jobs_stop_or_do_not_begin(tmp_path: Path, instead: Callable[[str], None]) -> None:
    queue = Queue(tmp_path)
    running, waiting = queue.submit(a_job("running")), queue.submit(a_job("waiting"))
    queue.cancel(waiting)
    found = queue.result(waiting)
    assert found is not None
    assert found.exit_code == 130
    instead(sleeps(tmp_path / "began"))
    when((tmp_path / "began").exists, lambda: queue.cancel(running))
    began = time.monotonic()
    (outcome,) = work(queue)
    assert time.monotonic() - began < ENOUGH
    assert outcome.result["error"] == "Cancelled"
    instead(SAY)
    assert queue.submit(a_job("waiting")) == waiting, "submitting it again sets it to wait again"
    assert [o.result for o in work(queue)] == [{"said": "waiting"}]


def test_results_are_kept_but_failures_and_lost_outputs_are_not(tmp_path: Path, instead: Callable[[str], None]) -> None:
    queue, output = Queue(tmp_path / "jobs"), tmp_path / "out"
    job = a_job(output=str(output), folders=(str(output),))
    instead(f"import os, sys; os.makedirs({str(output)!r}, exist_ok=True); print('{{}}')")
    for made in (1, 0):
        queue.submit(job)
        assert len(work(queue)) == made
    output.rmdir()
    queue.submit(job)
    assert len(work(queue)) == 1
    instead("import sys; print('{}'); sys.exit(2)")
    for _ in range(2):
        queue.submit(a_job("fails"))
        assert [o.exit_code for o in work(queue)] == [2]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        '{"format": "realsim.job/1"}',
        '{"format": "other"}',
        '{"format": "realsim.job/1", "name": "a", "command": "inspect", "arguments": ["/"], "output": "",'
        ' "folders": [], "inputs": {}, "cwd": "/", "version": "0.2.0"}',
        "\x00" * 100,
    ],
)
def test_a_damaged_or_changed_job_file_fails_without_being_run(
    text: str, tmp_path: Path, instead: Callable[[str], None]
) -> None:
    queue = Queue(tmp_path)
    key, good = queue.submit(a_job()), queue.submit(a_job("good"))
    (tmp_path / key / "job.json").write_text(text)
    instead(SAY)
    work(queue)
    bad, fine = queue.result(key), queue.result(good)
    assert bad is not None
    assert bad.exit_code == 2
    assert "job.json" in str(bad.result["file"])
    assert fine is not None
    assert fine.result == {"said": "good"}


def test_only_commands_for_many_inputs_are_run(tmp_path: Path) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(Job("a", "worker", (str(tmp_path),)))
    with pytest.raises(RealsimError, match="cannot be used"):
        queue.job(key)
    (outcome,) = work(queue)
    assert outcome.exit_code == 2


def test_an_input_that_changed_meanwhile_is_said(tmp_path: Path) -> None:
    source = tmp_path / "a.csv"
    source.write_text("1")
    queue = Queue(tmp_path / "jobs")
    queue.submit(make_job("diagnose", source, tmp_path / "out"))
    source.write_text("22")
    (outcome,) = work(queue)
    assert "input has changed" in outcome.result["message"]


def test_foreign_things_in_the_folder_are_left_alone(tmp_path: Path, instead: Callable[[str], None]) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(a_job())
    secret = tmp_path / "secret"
    secret.write_text("precious")
    (tmp_path / key / "log.txt").symlink_to(secret)
    (tmp_path / ("0" * 32)).symlink_to(tmp_path / key)
    (tmp_path / "notes").mkdir()
    (tmp_path / key / "held.x.y").touch()
    assert queue.all() == [key]
    instead("import sys; sys.stderr.write('spoilt'); print('{}')")
    with pytest.raises(RealsimError, match="cannot write"):
        work(queue)
    assert secret.read_text() == "precious"


def test_a_full_disk_leaves_the_job_to_others(
    tmp_path: Path, instead: Callable[[str], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(a_job())
    instead(SAY)

    def full(*_: object) -> None:
        raise RealsimError("cannot write", found="No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("realsim.jobs.queue.write_text", full)
        with pytest.raises(RealsimError, match="cannot write"):
            work(queue)
    assert (tmp_path / key / "free.0").exists()
    assert [o.result for o in work(queue)] == [{"said": "a"}]


def test_a_damaged_result_is_made_again(tmp_path: Path, instead: Callable[[str], None]) -> None:
    queue = Queue(tmp_path)
    key = queue.submit(a_job())
    instead(SAY)
    work(queue)
    (tmp_path / key / "result.json").write_text("{")
    found = queue.result(key)
    assert found is not None
    assert not found.ok
    queue.submit(a_job())
    assert len(work(queue)) == 1


def test_a_crash_is_an_outcome_with_the_end_of_the_log(tmp_path: Path, instead: Callable[[str], None]) -> None:
    queue = Queue(tmp_path)
    queue.submit(a_job())
    instead("import os, sys; sys.stderr.write('out of luck\\x1b[31m'); sys.stderr.flush(); os.kill(os.getpid(), 9)")
    (outcome,) = work(queue)
    assert outcome.exit_code == -9
    assert outcome.result["error"] == "Crash"
    assert outcome.result["found"] == "out of luck\\x1b[31m"


def test_no_two_workers_have_the_same_name() -> None:
    code = "from realsim.jobs.queue import worker_name; print(worker_name())"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert len({other, worker_name(), worker_name()}) == 3
    assert other.rpartition("-")[0] == worker_name().rpartition("-")[0], "the same machine"
