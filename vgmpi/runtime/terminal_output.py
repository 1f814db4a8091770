"""Output to a terminal in which no text from outside is an order to the terminal.

Names in files (of COLMAP, glTF, .ply, materials, scenes) become parts of messages. Their control
characters are written as escapes, here and nowhere else, since each command writes through it.
"""

import contextlib
import re
import sys
from collections.abc import Iterator
from typing import Any

# C0 and C1 but for tab and newline, and what turns the direction of a line; a carriage return is of
# a progress bar at the start of a text, and of a line's end before a newline
_CONTROL = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069]"
    "|(?!^)\r(?!\n)"
)


class EscapingStream:
    """Text stream whose control characters are written as escapes."""

    def __init__(self, stream: Any):
        """Write to another stream."""
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the other stream."""
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text; return its length."""
        self._stream.write(_CONTROL.sub(_escape, text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        """Write texts."""
        for line in lines:
            self.write(line)


def _escape(match: re.Match) -> str:
    """Return the escape of a character."""
    return match[0].encode("unicode_escape").decode()


@contextlib.contextmanager
def escaped_output() -> Iterator[None]:
    """Let stdout and stderr escape control characters while the block runs."""
    before = sys.stdout, sys.stderr
    if not isinstance(sys.stdout, EscapingStream):
        sys.stdout, sys.stderr = EscapingStream(before[0]), EscapingStream(before[1])
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
