"""Shared fixtures. Data that does not belong to the repository is looked for in REALSIM_SHARED (default ../shared)."""

import contextlib
import gc
import hashlib
import os
import signal
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

# Tests run side by side: threads that spin while they wait for one another cost many times the work.
# Read when torch, numpy and OpenCV are loaded.
for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"):
    os.environ.setdefault(threads, "1")
os.environ.setdefault("SOURCE_DATE_EPOCH", "1767225600")  # pages of two minutes are the same bytes

# A shell that runs tests in the background has them ignore Ctrl-C, and their children too: interrupts are tested.
with contextlib.suppress(ValueError):  # not the main thread
    signal.signal(signal.SIGINT, signal.default_int_handler)


# The same examples at every run, and no wall-clock limits: a busy machine must not fail a law.
settings.register_profile("realsim", deadline=None, derandomize=True, max_examples=50)
settings.load_profile("realsim")

ROOT = Path(__file__).resolve().parents[1]
SHARED = Path(os.environ.get("REALSIM_SHARED", ROOT.parent / "shared"))


# What all tests import stays: looking through it for garbage again and again takes a fifth of the collection.
gc.disable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files with slow tests first: a long one at the end would leave the other workers idle."""
    gc.freeze()
    gc.enable()
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session", autouse=True)
def outputs_are_as_their_schemas_say() -> Iterator[None]:
    """Whatever command a test runs in this process."""
    from realsim.cli import command_line as cli
    from tests import outputs

    run = cli._run

    def checked(name: str, arguments: list[str]) -> Any:
        result = run(name, arguments)
        outputs.check(name, result.data)
        return result

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cli, "_run", checked)
        yield


@pytest.fixture(scope="session", autouse=True)
def a_step_is_timed_in_few_steps() -> Iterator[None]:
    """What a step costs is measured for every scene that is written."""
    from realsim.export.contact import cost

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cost, "STEPS", 20)
        patch.setattr(cost, "REPEATS", 2)
        yield


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[object, Callable[[Path], object]], Path]:
    """`once(key, write)` is a folder that `write(folder)` has made, the same for all tests and workers: copy it to
    change something. The key holds all that the folder depends on."""
    base = tmp_path_factory.getbasetemp()
    root = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "once"

    def find(key: object, write: Callable[[Path], object]) -> Path:
        folder = root / hashlib.sha256(repr(key).encode()).hexdigest()[:16]
        if not folder.exists():
            work = tmp_path_factory.mktemp("once") / "made"
            write(work)
            root.mkdir(exist_ok=True)
            with contextlib.suppress(OSError):  # another worker has made it meanwhile
                work.rename(folder)
        return folder

    return find


@pytest.fixture(scope="session")
def quick_export() -> Iterator[None]:
    """torch lists all operators that it can write as ONNX anew for every network, in two seconds: here once."""
    from torch.onnx._internal.exporter._registration import ONNXRegistry

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ONNXRegistry, "from_torchlib", staticmethod(cache(ONNXRegistry.from_torchlib)))
        yield


@pytest.fixture
def shared() -> Callable[[str], Path]:
    """`shared("captures/stake_a")` is that path of the shared data, or the test is skipped with the reason."""

    def find(name: str) -> Path:
        path = SHARED / name
        if not path.exists():
            pytest.skip(f"{path} is absent: set REALSIM_SHARED to the folder that holds {name}")
        return path

    return find
