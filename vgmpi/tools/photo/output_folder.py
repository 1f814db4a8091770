"""Output folder of a scene, whose files are written together at the end."""

import io
import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.runtime.user_files import replace_file

from .layout_config import LayoutError
from .scene_writer import is_unchanged

LOG = "images.log"


class Folder:
    """Files for the output folder `out`; nothing is written before write().

    Args:
        out: Folder of the scene.
        overwrite: Whether to replace a scene or settings there that somebody changed.

    Raises:
        LayoutError: The folder cannot be written to, or such a file lies in it.
    """

    def __init__(self, out: Path, overwrite: bool):
        self.out = out
        self._files: list[tuple[Path, bytes | GaussianCloud]] = []
        ancestor = next(p for p in (out, *out.resolve().parents) if p.exists())
        if not ancestor.is_dir() or not os.access(ancestor, os.W_OK):
            raise LayoutError(
                [escape_control_characters(f"{out}: is no folder that can be written to")]
            )
        for name in ("scene.toml", "render.toml"):
            existing = out / name
            if not overwrite and existing.exists() and not _is_unchanged(existing):
                message = "is not as this command made it: --overwrite replaces it"
                raise LayoutError([escape_control_characters(f"{existing}: {message}")])

    def picture(self, name: str, pixels: np.ndarray) -> None:
        """Add a PNG of uint8 pixels (height, width), or with 3 or 4 channels."""
        from PIL import Image

        buffer = io.BytesIO()
        Image.fromarray(pixels).save(buffer, "png")
        self._files.append((self.out / name, buffer.getvalue()))

    def gaussians(self, name: str, cloud: GaussianCloud) -> None:
        """Add a .ply of Gaussians."""
        self._files.append((self.out / name, cloud))

    def text(self, name: str, text: str) -> None:
        """Add a text file in the folder."""
        self.text_file(self.out / name, text)

    def text_file(self, path: Path, text: str) -> None:
        """Add a text file at any path."""
        self._files.append((path, text.encode()))

    def write(self) -> None:
        """Write all files in their order, each atomically.

        Raises:
            OSError: A file cannot be written.
        """
        for path, content in self._files:
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, GaussianCloud):
                ply.write(path, content)
            else:
                replace_file(path, content)


def _is_unchanged(path: Path) -> bool:
    """Return whether the file is still as this command wrote it."""
    try:
        return is_unchanged(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return False


class Decisions(logging.Handler):
    """Log handler that prints the lines of all decisions and records them for images.log."""

    def __init__(self, print_line: Callable[[str], None]):
        super().__init__()
        self.print_line = print_line
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Print and record one line."""
        line = escape_control_characters(record.getMessage())
        self.lines.append(line)
        self.print_line(line)

    def write(self, out: Path) -> None:
        """Write images.log into the folder.

        Raises:
            OSError: The file cannot be written.
        """
        replace_file(out / LOG, "".join(f"{line}\n" for line in self.lines).encode())
