"""The live page of a run in the cell of a notebook, served by a process of its own."""

import re
import subprocess
import threading
import weakref
from pathlib import Path
from typing import Any

from vgmpi.io.run_reader import RunError
from vgmpi.runtime.live_process import launch_page


class LiveCell:
    """Live page of a run in a cell: `address` and `close()`; it ends with the kernel."""

    def __init__(self, folder: Path, particles: int, height: int):
        """Start the page.

        Args:
            folder: Output folder of the run.
            particles: Largest number of Gaussians.
            height: Height of the cell [pixels].

        Raises:
            RunError: If no page can be served, with its one line.
        """
        process = launch_page(
            folder, "--port", 0, "--particles", particles,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert process.stdout is not None
        line = process.stdout.readline().strip()
        match = re.search(r"http://\S+", line)
        if match is None:
            process.kill()
            raise RunError(line or "the live page has not started")
        self.address, self.height = match[0], height
        # later lines of the page are read, so that it never waits
        threading.Thread(target=process.stdout.read, daemon=True).start()
        self._finalizer = weakref.finalize(self, process.terminate)

    def close(self) -> None:
        """End the page."""
        self._finalizer()

    def _repr_html_(self) -> str:
        """Return the page as a frame, for Jupyter."""
        style = f"width: 100%; height: {self.height}px; border: 0"
        return f'<iframe src="{self.address}" style="{style}"></iframe>'

    def _repr_mimebundle_(self, **_: Any) -> dict[str, str]:
        """Return what the cell shows, and a line for places without HTML."""
        return {"text/html": self._repr_html_(), "text/plain": f"live page: {self.address}"}
