"""Scans of a TOML text for what no parser of the standard library tells: bounds, and lines of keys.

The bounds hold before a parser sees a text, as parsing takes memory for all that it holds. A table
of n dotted parts, and the lines of its n keys, take memory as n squared; an item takes some hundred
times the letters that it is written with.
"""

import re
import tomllib
from bisect import bisect_right
from typing import NamedTuple

MAX_NESTING = 32  # [levels] deepest nesting of tables and lists
MAX_ITEMS = 300_000  # lines, keys, and items of lists in one text
TOO_DEEP = f"nested more than {MAX_NESTING} levels deep"

# strings and comments, which hold anything, and the characters that nest, divide or join
_TOKEN = re.compile(
    r'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"{3,5}|\Z)'
    r"|'''(?:[^']++|'(?!''))*+(?:'{3,5}|\Z)"
    r'|"(?:[^"\\\n]++|\\.)*+(?:"|$)'
    r"|'[^'\n]*+(?:'|$)"
    r"|#[^\n]*+"
    r"|[\[\]{},=.]|\n\s*+",
    re.DOTALL | re.MULTILINE,
)
BARE = re.compile(r"[A-Za-z0-9_-]+")
BASIC = re.compile(r'"(?:[^"\\\n]|\\.)*"')
LITERAL = re.compile(r"'[^'\n]*'")
_SPACE = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
_LONG = re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}(?!")' + r"|'''.*?'{3,5}(?!')", re.DOTALL)
_SCALAR = re.compile(r"[^,\]}\n#]*")


class Excess(NamedTuple):
    """Place and nature of what exceeds a bound."""

    line: int  # from 1
    message: str


def find_excess(text: str) -> Excess | None:
    """Return where a TOML text exceeds a bound first, None if it does not.

    The text need not be valid: up to its first fault, it is divided as a parser divides it.
    """
    level = part_count = item_count = 0
    for match in _TOKEN.finditer(text):
        token = match[0][0]
        if token in "\"'#":
            continue
        item_count += 1
        if token == ".":
            part_count += 1
        else:
            part_count = 0
            level += (token in "[{") - (token in "]}")
        if level + part_count > MAX_NESTING or item_count > MAX_ITEMS:
            too_many = f"has more than {MAX_ITEMS:,} lines, keys and items of lists"
            message = too_many if item_count > MAX_ITEMS else TOO_DEEP
            return Excess(text.count("\n", 0, match.start()) + 1, message)
    return None


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
