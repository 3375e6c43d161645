"""Seeded damage to everything that realsim reads: tracebacks, hangs, and changes that nobody is told of.

    python benchmarks/fuzz.py                       # 1,000 captures and scans, 500 cases, 300 recordings, 200 others
    python benchmarks/fuzz.py --only cases --trials 50
    python benchmarks/fuzz.py --again               # only what failed or was silent before, after a reader was mended
    python benchmarks/fuzz.py --show cases 17       # one trial here and now, with its traceback

Every trial copies a sound example (fuzz_sources.py), damages it (fuzz_damage.py) and reads it (fuzz_readers.py) in a
process with a limit on time and memory. Its outcome is one of

    refused    an error with file, expectation and finding
    said       read, and what a user is told differs from what is told of the sound example
    same       read, and the same values came out
    renamed    read, and the same values came out under other names or in another order: runs of a case, which have none
    silent     read, other values came out, and not a word: most are numbers that could as well be true; they are listed
    control    control characters in what goes to the terminal
    traceback  any other exception, a crash, or out of memory
    hang       no end within the limit

Trials are kept in a journal, so that a run goes on where it ended; counts go to benchmarks/results/fuzz.json by seed.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from multiprocessing.connection import Connection
from pathlib import Path
from typing import IO, Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from benchmarks.fuzz_damage import damage
from benchmarks.fuzz_readers import READERS
from benchmarks.fuzz_sources import TARGETS
from benchmarks.store import Store
from realsim.commands import CommandResult
from realsim.errors import printable

RESULTS = Path(__file__).parent / "results" / "fuzz.json"
SECONDS, MEMORY = 90.0, 6 * 2**30
"""Limits of one trial. Sound examples take a second, the first of a process (imports) 20 on a busy machine."""
OUTCOMES = ("refused", "said", "same", "renamed", "silent", "control", "traceback", "hang")
WRONG = ("control", "traceback", "hang")
AGAIN = (*WRONG, "silent")


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
            text = traceback.format_exception(error)
            return row | {
                "outcome": "traceback",
                "error": "".join(text)[-3000:],
                "seconds": time.perf_counter() - began,
            }
        printed.seek(0)
        shown = printed.read().decode("utf-8", "replace")
    reading.said = [s.replace(str(folder), "") for s in reading.said]
    row |= {
        "found": reading.found,
        "said": reading.said,
        "refused": reading.refused,
        "control": shown != printable(shown),
    }
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


def worker(pipe: Connection, work: Path, memory: int) -> None:
    """Trials as they are asked for, one after the other."""
    resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(EOFError):
        while True:
            kind, source, seed, number = pipe.recv()
            pipe.send(attempt(kind, source, seed, number, work))


class Workers:
    """One process at a time, replaced when it hangs or dies."""

    def __init__(self, work: Path) -> None:
        self.work = work
        self.process: Any = None

    def run(self, kind: str, source: str, seed: int, number: int) -> dict[str, Any]:
        """The row of a trial."""
        if self.process is None:
            context = multiprocessing.get_context("spawn")
            self.pipe, other = context.Pipe()
            self.process = context.Process(target=worker, args=(other, self.work, MEMORY), daemon=True)
            self.process.start()
            other.close()
        row = {"kind": kind, "number": number, "source": source, "damage": "see --show"}
        try:
            self.pipe.send((kind, source, seed, number))
            if self.pipe.poll(SECONDS):
                return self.pipe.recv()
            outcome = {"outcome": "hang", "error": f"no end within {SECONDS:g} s"}
        except (EOFError, OSError):
            self.process.join(5)
            outcome = {"outcome": "traceback", "error": f"the process died (exit code {self.process.exitcode})"}
        self.stop()
        return row | outcome

    def stop(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.join()
            self.process = None


def judge(row: dict[str, Any], sound: dict[str, Any]) -> dict[str, Any]:
    """The row with its outcome, without the values that it was judged by."""
    if "outcome" in row:
        return row
    changed = sorted({n for n in {*row["found"], *sound["found"]} if row["found"].get(n) != sound["found"].get(n)})
    if row.pop("control"):
        outcome = "control"
    elif row["refused"] and not row["found"]:
        outcome = "refused"
    elif Counter(row["said"]) != Counter(sound["said"]) or row["refused"]:
        outcome = "said"
    elif changed:
        outcome = "renamed" if row["kind"] == "cases" and runs(row["found"]) == runs(sound["found"]) else "silent"
    else:
        outcome = "same"
    kept = {k: row[k] for k in ("kind", "number", "source", "damage", "seconds")}
    return kept | {"outcome": outcome} | ({"changed": changed} if outcome in ("renamed", "silent") else {})


def runs(found: Mapping[str, str]) -> Counter[tuple[str, ...]]:
    """The values of a case run by run, whatever the runs are called; what belongs to no run is one more."""
    parts: dict[str, list[str]] = {}
    for name, value in sorted(found.items()):
        what, of, run = name.partition(" of ")
        parts.setdefault(run if of and run != "the model" else "", []).append(f"{what} {value}")
    return Counter(map(tuple, parts.values()))


def build(kind: str, work: Path) -> list[str]:
    """Sound examples of a kind, each made once; their names."""
    names = []
    for name, write in TARGETS[kind][1]().items():
        folder = work / "sources" / name
        if not folder.exists():
            making = work / "making" / "input"
            shutil.rmtree(making.parent, ignore_errors=True)
            making.mkdir(parents=True)
            write(making)
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
    workers, rows = Workers(work), []
    for kind in kinds:
        names = build(kind, work)
        sound: dict[str, Any] = {}
        for number in range(trials or TARGETS[kind][0]):
            row = done.get((kind, number))
            if row is None or (again and row["outcome"] in AGAIN):
                source = names[number % len(names)]
                if source not in sound:
                    sound[source] = workers.run(kind, source, seed, -1)
                    if "outcome" in sound[source] or sound[source]["refused"]:
                        raise SystemExit(f"the sound example {source} is not read: {sound[source]}")
                row = judge(workers.run(kind, source, seed, number), sound[source])
                with journal.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                if row["outcome"] in WRONG:
                    said = f"{row['outcome']}: {kind} {number}, {source}: {row['damage']}\n{row.get('error', '')}"
                    print(printable(said), flush=True)
            rows.append(row)
    workers.stop()
    return rows


def report(rows: list[dict[str, Any]]) -> None:
    """Counts by kind, and by what was done to what: what only has other names, and what has other values."""
    for kind in dict.fromkeys(row["kind"] for row in rows):
        part = Counter(row["outcome"] for row in rows if row["kind"] == kind)
        print(f"{kind:<12}" + "  ".join(f"{name} {part[name]}" for name in OUTCOMES))
    for outcome in ("renamed", "silent"):
        found = Counter(
            (row["source"], row["damage"], ", ".join(row["changed"][:3])) for row in rows if row["outcome"] == outcome
        )
        print(f"\n{outcome} ({found.total()}):")
        for (source, what, changed), count in sorted(found.items()):
            print(printable(f"  {count:>3} x {source}: {what} -> {changed}"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=list(TARGETS), choices=list(TARGETS))
    parser.add_argument("--trials", type=int, help="fewer or more of each kind; nothing is stored then")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--again", action="store_true", help="repeat the trials that failed or were silent")
    parser.add_argument("--show", nargs=2, metavar=("KIND", "NUMBER"), help="run one trial in this process")
    parser.add_argument("--work", type=Path, default=Path(tempfile.gettempdir()) / "realsim-fuzz")
    arguments = parser.parse_args()
    if arguments.show:
        kind, number = arguments.show[0], int(arguments.show[1])
        names = build(kind, arguments.work)
        row = attempt(kind, names[number % len(names)], arguments.seed, number, arguments.work)
        print(row.pop("error", ""), json.dumps(row, indent=1))
        return
    rows = run(arguments.only, arguments.seed, arguments.trials, arguments.work, arguments.again)
    report(rows)
    if arguments.trials is None:
        store = Store(RESULTS, ("kind", "seed"))
        for kind in arguments.only:
            part = Counter(row["outcome"] for row in rows if row["kind"] == kind)
            store.add({"kind": kind, "seed": arguments.seed, "trials": part.total(), **{n: part[n] for n in OUTCOMES}})
    if any(row["outcome"] in ("traceback", "hang") for row in rows):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
