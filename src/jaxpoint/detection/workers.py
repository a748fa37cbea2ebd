"""Cameras side by side in processes, with progress, and with Ctrl-C that keeps what is finished."""

from __future__ import annotations

import multiprocessing
import os
import queue
import signal
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing.queues import Queue
from multiprocessing.synchronize import Event
from typing import TypeVar

import cv2

from jaxpoint.errors import UsageError

Item = TypeVar("Item")
Result = TypeVar("Result")
Advance = Callable[[int, int], None]
"""Called with the number of frames done and to do."""

REPORT_EVERY = 16  # frames
POLL_SECONDS = 0.1

_messages: Queue | None = None
_stop: Event | None = None


class _Stopped(Exception):
    """The parent asked this process to end."""


def cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def run_cameras(
    work: Callable[[Item, Advance], Result],
    items: Sequence[Item],
    workers: int,
    finished: dict[int, Result],
    report: Callable[[int, int, int], None],
) -> None:
    """Fill `finished` camera by camera, so that an interruption leaves what was complete.

    Never more processes than cores, nor than `workers` where that is not 0; with one, no process is started. The first
    error ends the others.

    Args:
        work: on one camera; both it and the items go to other processes.
        items: one a camera.
        workers: processes at most; 0 for one a core.
        finished: results by camera.
        report: called with camera, done, to do.

    Raises:
        UsageError: a process ended at once.
    """
    count = min(workers or cores(), cores(), len(items))
    if count <= 1:
        for index, item in enumerate(items):
            finished[index] = work(item, lambda done, total, i=index: report(i, done, total))
        return
    context = multiprocessing.get_context("spawn")
    messages, stop = context.Queue(), context.Event()
    with ProcessPoolExecutor(count, context, _start_worker, (messages, stop)) as pool:
        futures = [pool.submit(_work, work, index, item) for index, item in enumerate(items)]
        try:
            _collect(futures, messages, finished, report)
        except BrokenProcessPool:
            raise UsageError(
                "A detection process ended at once. A script must call this under `if __name__ == '__main__':`; if it "
                "does, memory was short: use workers=1."
            ) from None
        finally:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)
            for index, future in enumerate(futures):
                if not future.cancelled() and future.exception() is None:
                    finished[index] = future.result()


def _collect(
    futures: Sequence[Future],
    messages: Queue,
    finished: dict[int, Result],
    report: Callable[[int, int, int], None],
) -> None:
    while len(finished) < len(futures):
        with suppress(queue.Empty):
            report(*messages.get(timeout=POLL_SECONDS))
        for index, future in enumerate(futures):
            if future.done() and index not in finished:
                finished[index] = future.result()
    with suppress(queue.Empty):
        while True:
            report(*messages.get_nowait())


def _start_worker(messages: Queue, stop: Event) -> None:
    global _messages, _stop
    _messages, _stop = messages, stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears Ctrl-C and sets `stop`
    cv2.setNumThreads(1)


def _work(work: Callable[[Item, Advance], Result], index: int, item: Item) -> Result:
    assert _messages is not None
    assert _stop is not None
    messages, stop = _messages, _stop

    def advance(done: int, total: int) -> None:
        if stop.is_set():
            raise _Stopped
        if done % REPORT_EVERY == 0 or done == total:
            messages.put((index, done, total))

    return work(item, advance)
