"""Diagnoses many cases in processes of their own; what is done stays, so that an interrupted run goes on."""

import ast
import importlib
import json
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any


@dataclass(frozen=True)
class Job:
    """One case and where its answer goes."""

    case: Path
    out: Path
    """A folder; diagnosis.json in it is the answer, refused.json the reason why there is none."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Of DiagnoseConfig, where they are not the defaults."""
    figure: str = ""
    """`module:FIGURE=value` that the engine has instead of its own."""
    seconds: int = 0
    """CPU time after which it counts as crashed; 0: it may take as long as it takes."""
    since: Path | None = None
    """Case of an earlier log: what changed since then goes into the answer, too."""


def diagnose_all(jobs: Sequence[Job], processes: int, minutes: float = float("inf")) -> None:
    """Diagnose what has no answer of this engine and these settings yet; none is begun after `minutes`."""
    todo = [job for job in jobs if not answered(job)]
    began, done = time.monotonic(), 0
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    print(f"{len(jobs)} cases, {len(jobs) - len(todo)} of them answered by this engine before", flush=True)
    # A process a case: none inherits another one's figure.
    pool = ProcessPoolExecutor(processes, mp_context=get_context("spawn"), max_tasks_per_child=1)
    try:
        waiting, running = list(reversed(todo)), set()
        while waiting or running:
            late = time.monotonic() - began > 60 * minutes
            while waiting and not late and len(running) < processes:
                running.add(pool.submit(_diagnose, waiting.pop()))
            if late:
                print(f"{len(waiting)} cases are left for another time, {len(running)} are broken off", flush=True)
                for process in list(pool._processes.values()):  # those under way would go on for minutes
                    process.terminate()
                break
            finished, running = wait(running, timeout=2, return_when=FIRST_COMPLETED)
            for future in finished:
                done += 1
                print(f"{done}/{len(todo)} {time.monotonic() - began:5.0f} s  {future.result()}", flush=True)
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def answered(job: Job) -> bool:
    """Whether its answer is there, of this engine and these settings."""
    found = read(job)
    return found is not None and found.get("provenance") == _provenance(job)


def read(job: Job) -> dict[str, Any] | None:
    """The answer that lies there, whoever gave it; a refusal is one without causes."""
    for name in ("diagnosis.json", "refused.json"):
        if (job.out / name).is_file():
            return dict(json.loads((job.out / name).read_text()))
    return None


def _provenance(job: Job) -> dict[str, Any]:
    from realsim.gap.config import DiagnoseConfig
    from realsim.gap.provenance import provenance

    found = provenance(DiagnoseConfig(threads=1, report=False, **job.settings))
    return dict(json.loads(json.dumps(found | ({"figure": job.figure} if job.figure else {}))))


def set_figure(text: str) -> None:
    """Give a figure of the engine (`module:FIGURE=value`) another value in every module that holds it."""
    name, _, value = text.partition("=")
    _, _, figure = name.partition(":")
    importlib.import_module("realsim.gap.pipeline")
    for module in [m for n, m in sys.modules.items() if n.startswith("realsim.gap")]:
        if figure in vars(module):
            setattr(module, figure, ast.literal_eval(value))


def _give_up(seconds: int, *_: Any) -> None:
    raise TimeoutError(f"no answer in {seconds} s of CPU time")


def _diagnose(job: Job) -> str:
    """Write the answer; return a line of it."""
    from benchmarks.diagnosis.score import short
    from realsim.core.errors import RealsimError
    from realsim.core.files import to_json, write_text
    from realsim.gap import DiagnoseConfig, diagnose, load_case
    from realsim.gap.drift.since import changed_since
    from realsim.gap.pipeline import limited

    shutil.rmtree(job.out, ignore_errors=True)
    job.out.mkdir(parents=True)
    name = f"{job.out.parent.name}/{job.out.name}"
    if job.figure:
        set_figure(job.figure)
    signal.signal(signal.SIGPROF, partial(_give_up, job.seconds))
    signal.setitimer(signal.ITIMER_PROF, job.seconds)
    try:
        config = DiagnoseConfig(threads=1, report=False, **job.settings)
        case = load_case(job.case)
        found = diagnose(case, config)
        if job.since is not None:
            both = [limited(c, config) for c in (case, load_case(job.since))]
            found = replace(found, since=changed_since(*both, config).as_dict())
    except RealsimError as error:
        refusal = {"verdict": "refused", "causes": [], "equivalent": [], "said": str(error)}
        write_text(job.out / "refused.json", to_json(refusal | {"provenance": _provenance(job)}))
        return f"{name} refused: {error.message}"
    except Exception as error:  # a defect of the engine: kept as an answer, so that no case is lost without a word
        refusal = {"verdict": "crashed", "causes": [], "equivalent": [], "said": repr(error)}
        write_text(job.out / "refused.json", to_json(refusal | {"provenance": _provenance(job)}))
        return f"{name} CRASHED: {error!r}"
    write_text(job.out / "diagnosis.json", to_json(found.as_dict() | {"provenance": _provenance(job)}))
    return f"{name} {found.verdict} {', '.join(map(short, found.causes))} ({found.cost['seconds']:.0f} s)"
