"""Seeded damage to everything that realsim reads: tracebacks, hangs, and changes that nobody is told of.

    python benchmarks/robustness/fuzz.py  # 1,000 captures and scans, 500 cases, 300 recordings, 200 others
    python benchmarks/robustness/fuzz.py --only cases --trials 50
    python benchmarks/robustness/fuzz.py --again  # only what failed or was silent before, after a reader was mended
    python benchmarks/robustness/fuzz.py --show cases 17       # one trial here and now, with its traceback

Every trial copies a sound example (fuzz_sources.py), damages it (fuzz_damage.py) and reads it (fuzz_readers.py) in a
process with a limit on time and memory. Its outcome is one of

    refused    an error with file, expectation and finding
    said       read, and the reports differ from those of the sound example
    same       read, and the same values came out
    moved, less, unused, slight
               read, other values came out, and nothing false is among them (fuzz_changes.py checks and says why)
    exchanged, plausible
               read, other values came out, and nothing in the files tells them from true ones; listed
    silent     read, other values came out, and not a word; listed
    control    control characters in what goes to the terminal
    traceback  any other exception, a crash, or out of memory
    hang       no end within the limit

Trials are kept in a journal, so that a run goes on where it ended. Counts by seed and what is listed, trial by trial,
go to benchmarks/results/fuzz.json.
"""

import argparse
import contextlib
import json
import multiprocessing
import os
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.robustness.fuzz_changes import HARMLESS, LISTED, came_out, equal, explain, only_left_out
from benchmarks.robustness.fuzz_damage import damage
from benchmarks.robustness.fuzz_readers import READERS
from benchmarks.robustness.fuzz_sources import TARGETS
from benchmarks.store import Store
from realsim.cli.commands import CommandResult
from realsim.core.errors import printable

RESULTS = Path(__file__).parents[1] / "results" / "fuzz.json"
KEY = ("kind", "seed", "number")
SECONDS, WAITING, MEMORY = 90.0, 600.0, 6 * 2**30
"""Limits of one trial: seconds of CPU, seconds of the clock (whoever waits for nothing uses none), bytes. A sound
example takes a second, the first of a process 10 (imports)."""
WRONG = ("control", "traceback", "hang")
OUTCOMES = ("refused", "said", "same", *HARMLESS, *LISTED, *WRONG)
AGAIN = (*WRONG, *LISTED)


def attempt(kind: str, source: str, seed: int, number: int, work: Path) -> dict[str, Any]:
    """One trial; `number` -1 is the sound example."""
    trial = work / f"trial-{os.getpid()}"
    shutil.rmtree(trial, ignore_errors=True)
    folder = trial / "input"
    shutil.copytree(work / "sources" / source, folder)
    what = ""
    if number >= 0:
        what = damage(folder, np.random.default_rng([seed, zlib.crc32(kind.encode()), number]))
    began = time.perf_counter()
    row: dict[str, Any] = {"kind": kind, "number": number, "source": source, "damage": what}
    with (trial / "printed").open("w+b") as printed:
        try:
            with to_file(printed):
                reading = READERS[kind](folder)
                print(CommandResult(reading.shown).rendered(color=False))
        except BaseException as error:
            row |= {"outcome": "traceback", "error": "".join(traceback.format_exception(error))[-3000:]}
        else:
            printed.seek(0)
            shown = printed.read().decode("utf-8", "replace")
            row |= {
                "found": reading.found, "said": [s.replace(str(folder), "") for s in reading.said],
                "refused": reading.refused, "control": shown != printable(shown),
                "shorter": only_left_out(work / "sources" / source, folder),
            }  # fmt: skip
    return row | {"seconds": time.perf_counter() - began}


@contextlib.contextmanager
def to_file(file: IO[bytes]) -> Iterator[None]:
    """What this process prints, its libraries in C included, goes to a file."""
    kept = [os.dup(1), os.dup(2)]
    sys.stdout.flush()
    try:
        for stream in (1, 2):
            os.dup2(file.fileno(), stream)
        yield
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        for stream, old in zip((1, 2), kept, strict=True):
            os.dup2(old, stream)
            os.close(old)


def worker(pipe: Connection, work: Path) -> None:
    """Trials, one after the other, each within the limits: the system ends what exceeds them."""
    resource.setrlimit(resource.RLIMIT_DATA, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(EOFError):
        while True:
            trial = pipe.recv()
            used = resource.getrusage(resource.RUSAGE_SELF)
            most = int(used.ru_utime + used.ru_stime + SECONDS) + 1
            resource.setrlimit(resource.RLIMIT_CPU, (most, resource.RLIM_INFINITY))
            pipe.send(attempt(*trial, work))


class Worker:
    """A process for trials, replaced when it hangs or dies."""

    def __init__(self, work: Path) -> None:
        self.work = work
        self.process: Any = None

    def run(self, kind: str, source: str, seed: int, number: int) -> dict[str, Any]:
        """The row of a trial."""
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            self.pipe, other = context.Pipe()
            self.process = context.Process(target=worker, args=(other, self.work), daemon=True)
            self.process.start()
            other.close()
        error = f"no end within {SECONDS:g} s of CPU or {WAITING:g} s"
        try:
            self.pipe.send((kind, source, seed, number))
            if self.pipe.poll(WAITING):
                return self.pipe.recv()
            outcome = "hang"
        except (EOFError, OSError):
            self.process.join(5)
            outcome = "hang" if self.process.exitcode == -signal.SIGXCPU else "traceback"
            error = error if outcome == "hang" else f"the process died (exit code {self.process.exitcode})"
        self.stop()
        row = {"kind": kind, "number": number, "source": source, "damage": "see --show"}
        return row | {"outcome": outcome, "error": error}

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None


def judge(row: dict[str, Any], sound: dict[str, Any]) -> dict[str, Any]:
    """The row with its outcome, without the values that it was judged by."""
    if "outcome" in row:
        return row
    before, after = sound["found"], row["found"]
    if row.pop("control"):
        outcome = "control"
    elif row["refused"] and not after:
        outcome = "refused"
    elif Counter(row["said"]) != Counter(sound["said"]) or row["refused"]:
        outcome = "said"
    elif before.keys() == after.keys() and all(equal(after[n], before[n]) for n in before):
        outcome = "same"
    else:
        outcome = explain(row["kind"], before, after, row["shorter"])
    kept = {k: row[k] for k in ("kind", "number", "source", "damage", "seconds")} | {"outcome": outcome}
    return kept | ({"came": came_out(before, after)} if outcome in (*HARMLESS, *LISTED) else {})


def build(kind: str, work: Path) -> list[str]:
    """Sound examples of a kind, each made once; their names."""
    names = []
    for name, write in TARGETS[kind][1]().items():
        folder = work / "sources" / name
        if not folder.exists():
            making = work / "making" / "input"
            shutil.rmtree(making.parent, ignore_errors=True)
            making.mkdir(parents=True)
            try:
                write(making)
            except BaseException as error:
                if type(error).__name__ != "Skipped":  # what the tests' writers raise where a package is missing
                    raise
                print(f"without {name}: {error}", flush=True)
                continue
            folder.parent.mkdir(parents=True, exist_ok=True)
            making.rename(folder)
        names.append(name)
    return names


def run(kinds: list[str], seed: int, trials: int | None, work: Path, again: bool) -> list[dict[str, Any]]:
    """All trials that the journal does not have yet."""
    work.mkdir(parents=True, exist_ok=True)
    journal = work / f"journal-{seed}.jsonl"
    done: dict[tuple[str, int], dict[str, Any]] = {}
    for line in journal.read_text().splitlines() if journal.is_file() else ():
        row = json.loads(line)
        done[row["kind"], row["number"]] = row
    process, rows = Worker(work), []
    for kind in kinds:
        names = build(kind, work)
        sound: dict[str, Any] = {}
        for number in range(trials or TARGETS[kind][0]):
            row = done.get((kind, number))
            if row is None or (again and row["outcome"] in AGAIN):
                source = names[number % len(names)]
                if source not in sound:
                    sound[source] = process.run(kind, source, seed, -1)
                    if "outcome" in sound[source] or sound[source]["refused"]:
                        raise SystemExit(f"the sound example {source} is not read: {sound[source]}")
                row = judge(process.run(kind, source, seed, number), sound[source])
                with journal.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                if row["outcome"] in WRONG:
                    said = f"{row['outcome']}: {kind} {number}, {source}: {row['damage']}\n{row.get('error', '')}"
                    print(printable(said), flush=True)
            rows.append(row)
    process.stop()
    return rows


def report(rows: list[dict[str, Any]]) -> None:
    """Counts by kind, and every trial whose values nobody was told of."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        part = Counter(row["outcome"] for row in rows if row["kind"] == kind)
        print(f"{kind:<12}" + "  ".join(f"{name} {part[name]}" for name in OUTCOMES))
    for outcome in (*HARMLESS, *LISTED):
        found = [row for row in rows if row["outcome"] == outcome]
        print(f"\n{outcome} ({len(found)}):")
        for row in found:
            came = "; ".join(row["came"])
            print(printable(f"  {row['kind']} {row['number']}, {row['source']}: {row['damage']} -> {came}"))


def store_rows(rows: list[dict[str, Any]], seed: int) -> None:
    """Counts (number None) and listed trials, in the place of the same kinds' and seed's before."""
    store = Store(RESULTS, KEY)
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    store.rows = [r for r in store.rows if r["kind"] not in kinds or r["seed"] != seed]
    for kind in kinds:
        part = [row for row in rows if row["kind"] == kind]
        counts = Counter(row["outcome"] for row in part)
        store.add({"kind": kind, "seed": seed, "number": None, "trials": len(part), **{n: counts[n] for n in OUTCOMES}})
        for row in part:
            if row["outcome"] in (*LISTED, *WRONG):
                said = {k: printable(row[k]) for k in ("source", "damage", "outcome")}
                came = [printable(c) for c in row.get("came", ())]
                store.add({"kind": kind, "seed": seed, "number": row["number"], **said, "came": came})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=list(TARGETS), choices=list(TARGETS))
    parser.add_argument("--trials", type=int, help="fewer or more of each kind; stored with --store only")
    parser.add_argument("--store", action="store_true", help="store the counts of --trials too")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", action="store_true", help="repeat the trials that failed or were silent")
    parser.add_argument("--show", nargs=2, metavar=("KIND", "NUMBER"), help="run one trial in this process")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "realsim-fuzz")
    arguments = parser.parse_args()
    if arguments.show:
        kind, number = arguments.show[0], int(arguments.show[1])
        names = build(kind, arguments.work)
        row = attempt(kind, names[number % len(names)], arguments.seed, number, arguments.work)
        print(row.pop("error", ""), json.dumps(row, indent=1, default=str))
        return
    rows = run(arguments.only, arguments.seed, arguments.trials, arguments.work, arguments.again)
    report(rows)
    if arguments.trials is None or arguments.store:
        store_rows(rows, arguments.seed)
    if any(row["outcome"] in ("traceback", "hang") for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
