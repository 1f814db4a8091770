"""Progress of a video: frames drawn, pace and remaining time, on a terminal or as log lines."""

import logging
import sys
import threading
import time
from typing import Any

from vgmpi.runtime.message_text import format_duration

log = logging.getLogger("vgmpi")

EVERY = 5.0  # [s] between log lines, and between updates of a bar


class FrameProgress:
    """Progress bar on a terminal, else a log line every five seconds.

    It is a context, in which `add` counts a frame. A thread shows the progress, so that a frame
    that takes long is seen to be drawn.
    """

    def __init__(self, total: int, quiet: bool = False, finished: int = 0):
        """Set up the progress.

        Args:
            total: Number of frames.
            quiet: Whether nothing is shown.
            finished: Number of frames that were drawn before, which say nothing about the pace.
        """
        self.total, self.quiet = total, quiet
        self.begun_with = self.count = finished
        self.began = time.monotonic()
        self.bar: Any = None  # tqdm, on a terminal
        self.ended = threading.Event()
        self.thread = threading.Thread(target=self._show_repeatedly, daemon=True)

    def __enter__(self) -> "FrameProgress":
        if self.quiet:
            return self
        if sys.stderr.isatty():
            from tqdm import tqdm  # a single picture does without

            bar_format = "{l_bar}{bar}| {postfix}"
            self.bar = tqdm(total=self.total, initial=self.count, bar_format=bar_format)
            self._show()
        self.thread.start()
        return self

    def __exit__(self, kind, value, trace) -> None:
        self.ended.set()
        if self.thread.is_alive():
            self.thread.join()
        if self.bar is not None:
            self.bar.close()

    def add(self) -> None:
        """Count a finished frame."""
        self.count += 1
        if self.bar is not None:
            self._show()

    def line(self) -> str:
        """Return how far the video is, as text."""
        where = f"frame {self.count} of {self.total}"
        drawn, elapsed = self.count - self.begun_with, time.monotonic() - self.began
        if not drawn:
            return f"{where}, {format_duration(elapsed)} so far"
        pace = elapsed / drawn
        left = format_duration(pace * (self.total - self.count))
        return f"{where}, {pace:.2f} s per frame, {left} left"

    def _show_repeatedly(self) -> None:
        """Show the progress every few seconds until the end."""
        while not self.ended.wait(EVERY):
            self._show()

    def _show(self) -> None:
        """Show the progress once."""
        if self.bar is None:
            log.info("%s", self.line())
            return
        self.bar.n = self.count
        self.bar.set_postfix_str(self.line(), refresh=True)
