"""Compiling what a function launches on the GPU: all modules side by side, and nothing else.

Warp compiles a module when one of its kernels is first launched, and waits for it; MuJoCo Warp has some dozens. Here
the function runs once with launches that only note their module, then the modules are loaded by several threads (the
compiler runs outside of Python), and the function finds them in memory.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any
from unittest.mock import patch

import warp as wp
from warp._src.context import Module

from realsim.core.progress import note

_LONG = 5.0
"""Seconds from which the time that it took is worth a line."""


class _Noted(Exception):
    """A launch has told its module."""


def compile_for(function: Callable[[], Any], device: Any) -> float:
    """Load every module that `function` launches kernels of; seconds that it took.

    Args:
        function: it may be run without effect: what it launches does not depend on what its kernels write.
        device: `warp.Device`.
    """
    began = time.perf_counter()
    wanted = _modules(function)
    waiting = [(module, size) for module, size in wanted if all(key[0] != device.context for key in module.execs)]
    if not waiting:
        return 0.0
    workers = max(1, min(len(waiting), len(os.sched_getaffinity(0))))
    note(f"loading {len(waiting)} GPU modules; on a machine's first run they are compiled, {workers} at a time ...")
    # Hashes are made one after the other: modules share functions whose code generation is no matter for threads.
    for module, size in waiting:
        module.get_module_hash(size)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda job: job[0].load(device, job[1]), waiting))
    seconds = time.perf_counter() - began
    if seconds > _LONG:
        note(f"GPU modules ready after {seconds:.0f} s (the next start finds them in {wp.config.kernel_cache_dir})")
    return seconds


def _modules(function: Callable[[], Any]) -> list[tuple[Any, int | None]]:
    """(module, block size) of every launch, each once."""
    load, launching = Module.load, list[bool]()
    found: dict[tuple[int, int | None], tuple[Any, int | None]] = {}

    def noting(module: Any, device: Any, block_dim: int | None = None, *_: Any, **__: Any) -> Any:
        if not launching:  # somebody asks for a kernel's best block size, which only the loaded one knows
            return load(module, device, block_dim)
        found.setdefault((id(module), block_dim), (module, block_dim))
        raise _Noted

    def quiet(launch: Callable[..., Any]) -> Callable[..., Any]:
        def launched(*args: Any, **kwargs: Any) -> None:
            launching.append(True)
            with contextlib.suppress(_Noted):
                launch(*args, **kwargs)
            launching.pop()

        return launched

    def once(condition: Any, while_body: Callable[..., Any], *_: Any, **kwargs: Any) -> None:
        while_body(**kwargs)

    def either(
        condition: Any, on_true: Callable[..., Any] | None = None, on_false: Any = None, *_: Any, **kwargs: Any
    ) -> None:
        for branch in (on_true, on_false):
            if branch is not None:
                branch(**kwargs)

    with (
        patch.object(Module, "load", noting),
        patch.object(wp, "launch", quiet(wp.launch)),
        patch.object(wp, "launch_tiled", quiet(wp.launch_tiled)),
        patch.object(wp, "capture_while", once),
        patch.object(wp, "capture_if", either),
    ):
        function()
    return list(found.values())
