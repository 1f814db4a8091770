"""Lines of the keys of a TOML text, which no parser of the standard library tells."""

import re
import tomllib
from bisect import bisect_right

BARE = re.compile(r"[A-Za-z0-9_-]+")
BASIC = re.compile(r'"(?:[^"\\\n]|\\.)*"')
LITERAL = re.compile(r"'[^'\n]*'")
_SPACE = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
_LONG = re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}(?!")' + r"|'''.*?'{3,5}(?!')", re.DOTALL)
_SCALAR = re.compile(r"[^,\]}\n#]*")


def locate_keys(text: str) -> dict[tuple, int]:
    """Return the line (from 1) of every table, key and array item of a valid TOML text.

    The keys of the result are paths of names and indices, as in the parsed data.
    """
    scan = _TomlPositionScanner(text)
    scan.scan_document()
    return scan.line


class _TomlPositionScanner:
    """Scanner that passes once over a valid TOML text and records the lines of its keys."""

    def __init__(self, text: str):
        self.text, self.position = text, 0
        self.breaks = [m.start() for m in re.finditer("\n", text)]
        self.line: dict[tuple, int] = {}
        self.last: dict[tuple, int] = {}  # index of the latest item of each array of tables

    def scan_document(self) -> None:
        """Scan the whole text."""
        table: tuple = ()
        while self.skip() < len(self.text):
            if self.text[self.position] == "[":
                table = self.header()
            else:
                self.pair(table)

    def header(self) -> tuple:
        """Scan a table header; return the path of the table."""
        start, double = self.position, self.text.startswith("[[", self.position)
        self.position += 2 if double else 1
        parts = self.key()
        self.position += 2 if double else 1
        path: tuple = ()
        for k, part in enumerate(parts):
            path += (part,)
            if double and k == len(parts) - 1:
                self.last[path] = self.last.get(path, -1) + 1
            if path in self.last:
                self.mark(path, start)
                path += (self.last[path],)
            self.mark(path, start)
        return path

    def pair(self, table: tuple) -> None:
        """Scan `key = value`."""
        start, path = self.position, table
        for part in self.key():
            path += (part,)
            self.mark(path, start)
        self.position += 1  # skips "="
        self.value(path)

    def key(self) -> list[str]:
        """Scan a dotted key; return its parts."""
        parts = []
        while True:
            self.skip()
            match = (
                BASIC.match(self.text, self.position)
                or LITERAL.match(self.text, self.position)
                or BARE.match(self.text, self.position)
            )
            if match is None:
                raise AssertionError(f"no key at character {self.position} of a valid TOML text")
            self.position = match.end()
            parts.append(next(iter(tomllib.loads(f"{match[0]} = 0"))))
            self.skip()
            if not self.text.startswith(".", self.position):
                return parts
            self.position += 1

    def value(self, path: tuple) -> None:
        """Scan a value."""
        self.skip()
        opening = self.text[self.position]
        if opening in "[{":
            self.position += 1
            self.items(path, "]" if opening == "[" else "}")
            return
        match = (
            _LONG.match(self.text, self.position)
            or BASIC.match(self.text, self.position)
            or LITERAL.match(self.text, self.position)
            or _SCALAR.match(self.text, self.position)
        )
        self.position = match.end() if match else self.position

    def items(self, path: tuple, closing: str) -> None:
        """Scan the items of an array or an inline table."""
        count = 0
        while self.text[self.skip()] != closing:
            if self.text[self.position] == ",":
                self.position += 1
            elif closing == "]":
                self.mark((*path, count), self.position)
                self.value((*path, count))
                count += 1
            else:
                self.pair(path)
        self.position += 1

    def skip(self) -> int:
        """Skip whitespace and comments; return the new position."""
        match = _SPACE.match(self.text, self.position)
        self.position = match.end() if match else self.position
        return self.position

    def mark(self, path: tuple, position: int) -> None:
        """Record the line of a path, unless it has one."""
        self.line.setdefault(path, bisect_right(self.breaks, position) + 1)
