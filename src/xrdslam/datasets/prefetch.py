"""Frames read ahead of their use by one background thread."""

from collections import deque
from collections.abc import Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import torch

from xrdslam.core.frame import Frame

__all__ = ["prefetch"]


def prefetch(
    frames: Iterator[Frame], device: torch.device | str = "cpu", lookahead: int = 2
) -> Generator[Frame, None, None]:
    """Yield the same frames in the same order, on `device`, at most `lookahead` of them read before they are asked for.

    What reading raises arrives here, at the frame where it happened, after those before it. Closing the iterator (or
    an error in the loop around it) ends the thread once the frame it is reading is read.
    """
    thread = ThreadPoolExecutor(1, thread_name_prefix="prefetch")
    pending: deque[Future[Frame | None]] = deque()
    try:
        while True:
            while len(pending) <= lookahead:
                pending.append(thread.submit(_next_on, frames, device))
            frame = pending.popleft().result()
            if frame is None:
                return
            yield frame
            del frame  # otherwise one more is alive while the next is waited for
    finally:
        thread.shutdown(wait=True, cancel_futures=True)


def _next_on(frames: Iterator[Frame], device: torch.device | str) -> Frame | None:
    frame = next(frames, None)
    return None if frame is None else frame.to(device)
