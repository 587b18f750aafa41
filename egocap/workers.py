"""Spawned worker processes that Ctrl-C ends quietly, and that end with their parent.

Ctrl-C reaches every process of a terminal. A worker that is starting or idle ignores it, so that
it prints no traceback; one with a job leaves it and takes no other. A parent that is killed tells
nobody: each worker watches it, as it would wait for jobs for ever.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from threading import Thread
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class WorkerPool(ProcessPoolExecutor):
    """An executor of spawned processes. An error in its block cancels the jobs not yet begun."""

    def __init__(
        self, workers: int, initializer: Callable[..., object] | None = None, *initargs: Any
    ) -> None:
        super().__init__(workers, get_context("spawn"), _begin, (initializer, *initargs))

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Run `fn` in a worker; the first calls also start the workers."""
        with _interrupts(signal.SIG_BLOCK):  # a new process inherits the mask
            return super().submit(_interruptible, fn, *args, **kwargs)

    def __exit__(self, kind: type[BaseException] | None, *exception: Any) -> None:
        self.shutdown(wait=True, cancel_futures=kind is not None)


def _begin(initializer: Callable[..., object] | None, *initargs: Any) -> None:
    Thread(target=_end_with_parent, daemon=True).start()
    if initializer is not None:
        initializer(*initargs)


def _end_with_parent() -> None:
    parent = parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


_interrupted = False  # in a worker; the pool hands out one job more than it has workers


def _interruptible(fn: Callable[P, R], *args: P.args, **kwargs: P.kwargs) -> R:
    global _interrupted
    if _interrupted:
        raise KeyboardInterrupt
    try:
        with _interrupts(signal.SIG_UNBLOCK):
            return fn(*args, **kwargs)
    except KeyboardInterrupt:
        _interrupted = True
        raise


@contextmanager
def _interrupts(how: int) -> Iterator[None]:
    """Block or unblock SIGINT in this thread; a signal that waits arrives when it is unblocked."""
    before = signal.pthread_sigmask(how, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
