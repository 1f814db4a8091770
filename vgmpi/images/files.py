"""The files of a scene, written together when all of them are known."""

import io
import logging
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vgmpi.gaussians import ply
from vgmpi.gaussians.cloud import Cloud
from vgmpi.images.layout import LayoutError
from vgmpi.images.scenes import as_made
from vgmpi.source import printable

LOG = "images.log"


class Folder:
    """What is to lie in the folder `out`; nothing is written before write().

    overwrite: replace a scene or settings there that somebody changed. Raises LayoutError where
    the folder cannot be written to, or such a file lies in it.
    """

    def __init__(self, out: Path, overwrite: bool):
        self.out = out
        self._files: list[tuple[Path, bytes | Cloud]] = []
        above = next(p for p in (out, *out.resolve().parents) if p.exists())
        if not above.is_dir() or not os.access(above, os.W_OK):
            raise LayoutError([printable(f"{out}: is no folder that can be written to")])
        for name in ("scene.toml", "render.toml"):
            there = out / name
            if not overwrite and there.exists() and not _ours(there):
                said = "is not as this command made it: --overwrite replaces it"
                raise LayoutError([printable(f"{there}: {said}")])

    def picture(self, name: str, pixels: np.ndarray) -> None:
        """A PNG of uint8 pixels (height, width), or with 3 or 4 channels."""
        from PIL import Image

        held = io.BytesIO()
        Image.fromarray(pixels).save(held, "png")
        self._files.append((self.out / name, held.getvalue()))

    def gaussians(self, name: str, cloud: Cloud) -> None:
        """A .ply."""
        self._files.append((self.out / name, cloud))

    def text(self, name: str, text: str) -> None:
        """A text in the folder."""
        self.whole(self.out / name, text)

    def whole(self, path: Path, text: str) -> None:
        """A text anywhere."""
        self._files.append((path, text.encode()))

    def write(self) -> None:
        """All files, in their order; each has its name only when it is complete. Raises OSError."""
        for path, content in self._files:
            path.parent.mkdir(parents=True, exist_ok=True)
            if isinstance(content, Cloud):
                ply.write(path, content)
            else:
                replace(path, content)


def replace(path: Path, content: bytes) -> None:
    """Write a file that has its name only when it is complete. Raises OSError."""
    part = path.with_name(f"{path.name}.part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def _ours(path: Path) -> bool:
    try:
        return as_made(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError):
        return False


class Decisions(logging.Handler):
    """Lines of what was decided, told as they come and kept for images.log."""

    def __init__(self, tell: Callable[[str], None]):
        super().__init__()
        self.tell = tell
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        line = printable(record.getMessage())
        self.lines.append(line)
        self.tell(line)

    def write(self, out: Path) -> None:
        """images.log in the folder. Raises OSError."""
        replace(out / LOG, "".join(f"{line}\n" for line in self.lines).encode())
