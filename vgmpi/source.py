"""A TOML text with the line of every key, and what `--set key=value` replaces in it."""

import logging
import re
import tomllib
from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path

from vgmpi.inputs import MOST_TEXT, content
from vgmpi.tables import SceneError, TomlError, unit

log = logging.getLogger("vgmpi")

_BARE = re.compile(r"[A-Za-z0-9_-]+")
_SPACE = re.compile(r"(?:[ \t\r\n]+|#[^\n]*)*")
_BASIC = re.compile(r'"(?:[^"\\\n]|\\.)*"')
_LITERAL = re.compile(r"'[^'\n]*'")
_LONG = re.compile(r'"""(?:[^\\]|\\.)*?"{3,5}(?!")' + r"|'''.*?'{3,5}(?!')", re.DOTALL)
_SCALAR = re.compile(r"[^,\]}\n#]*")
_LONG_NUMBER = re.compile(r"[0-9_]{4300,}")  # more than Python turns into an integer
# what stands behind a sign = or in a list and is no number, quotes and brackets taken aside
_BARE_VALUE = re.compile(r"[=,\[]\s*([^\s=,\[\]{}\"'][^=,\[\]{}\"']{0,100})")
_NUMBER = re.compile(r"[-+]?[0-9][0-9_.]*(?:[eE][-+]?[0-9]+)?\s*([A-Za-z%][^\n]*?)\s*")
DEEPEST = 100  # tables and lists in each other


class Source:
    """The data of a TOML file and where each piece of it was written.

    `text`: the file's text, `data`: nested dicts and lists with the overrides applied, `folder`:
    where the file lies.
    """

    def __init__(
        self,
        path: str | Path,
        overrides: tuple[str, ...] | list[str] = (),
        text: str | None = None,
        error: type[TomlError] = SceneError,
        old_names: Mapping[str, Mapping[str, str]] | None = None,
    ):
        """text: instead of what is in the file. error: what is raised where the file cannot be
        read, is not TOML or cannot be overridden. old_names: by table at the top, what keys inside
        were called before and are called now; a warning says which were found."""
        self.path = Path(path)
        if "\0" in str(path):
            raise error([f"{printable(path)}: no file has such a name"])
        self.folder = self.path.resolve().parent
        try:
            self.text = content(self.path, MOST_TEXT).decode() if text is None else text
            self.data = tomllib.loads(self.text)
            self._line = key_lines(self.text)
        except OSError as caught:
            raise error([printable(f"{path}: {caught.strerror or caught}")]) from None
        except UnicodeDecodeError as caught:
            raise error([f"{printable(path)}: not UTF-8 text (byte {caught.start})"]) from None
        except RecursionError:
            raise error([f"{printable(path)}: not valid TOML: nested too deeply"]) from None
        except ValueError as caught:  # not TOML, or a number too long to be read
            raise error([_syntax(printable(path), self.text, str(caught))]) from None
        self._set: dict[tuple, str] = {}
        self._old_names = old_names or {}
        self._old: dict[tuple, str] = {}  # of keys by their new path, as they were written
        self._refuse_extremes(error)
        for table, names in self._old_names.items():
            self._rename(self.data.get(table), (table,), names)
        bad = [said for item in overrides if (said := self._override(item))]
        if bad:
            raise error([printable(said) for said in bad])
        self._refuse_extremes(error)
        self._warn_of_old_names()

    def place(self, path: tuple) -> tuple[int, str]:
        """(line for sorting, "file:line" or "--set key=value") of a key, or of what holds it."""
        for stop in range(len(path), 0, -1):
            if path[:stop] in self._set:
                return 10**9, f"--set {short(self._set[path[:stop]])}"
            if path[:stop] in self._line:
                line = self._line[path[:stop]]
                return line, f"{self.path}:{line}"
            for given, item in self._set.items():
                if given[:stop] == path[:stop]:  # which made the table that holds it
                    return 10**9, f"--set {short(item)}"
        return 1, f"{self.path}:1"

    def lines(self, errors: list[tuple[tuple, str]]) -> list[str]:
        """One line per error, in the order of the file."""
        placed = []
        for path, said in errors:
            path = self._written(path)
            line, where = self.place(path)
            placed.append((line, printable(f"{where}: {self.key(path)}: {said}")))
        placed.sort(key=lambda item: item[0])
        return list(dict.fromkeys(said for _, said in placed))

    def key(self, path: tuple) -> str:
        """The path as a user would write it: objects by name where they have one."""
        parts = [str(p) if p != "" and "." not in str(p) else f'"{p}"' for p in path]
        if len(path) > 1 and isinstance(path[1], int):
            try:
                name = self.data[path[0]][path[1]]["name"]
                parts[1] = name if isinstance(name, str) else parts[1]
            except (KeyError, TypeError, IndexError):
                pass
        return ".".join(parts)

    def _written(self, path: tuple) -> tuple:
        """The path as it is in the file: without the number 0 where one thing stands for a list."""
        here: object = self.data
        out: tuple = ()
        for part in path:
            if isinstance(part, int) and isinstance(here, dict | str):
                continue
            out += (part,)
            try:
                here = here[part]  # type: ignore[index]
            except (KeyError, IndexError, TypeError):
                here = None
        return out

    def overridden(self, path: tuple) -> bool:
        """Whether the value of this key came from the command line."""
        return any(path[:stop] in self._set for stop in range(1, len(path) + 1))

    def _refuse_extremes(self, error: type[TomlError]) -> None:
        """Raise for what TOML need not hold and nothing here is made for: integers of more than 64
        bits, and tables and lists that are nested deeply."""
        wrong: list[tuple[tuple, str]] = []
        left: list[tuple[tuple, object]] = [((), self.data)]
        while left:
            path, here = left.pop()
            if isinstance(here, int) and not -(2**63) <= here < 2**63:
                wrong.append((path, f"must fit in 64 bits; got one of {here.bit_length()} bits"))
            if not isinstance(here, dict | list):
                continue
            if len(path) > DEEPEST:
                wrong.append((path[:3], f"must not be nested more than {DEEPEST} deep"))
                continue
            items = here.items() if isinstance(here, dict) else enumerate(here)
            left += [((*path, k), value) for k, value in items]
        if wrong:
            raise error(self.lines(wrong))

    def _rename(self, here: object, path: tuple, names: Mapping[str, str]) -> None:
        """Give keys of old names the new ones, below `path`. Where both are there the old one
        stays, to be refused as a key that is not known."""
        if isinstance(here, list):
            for k, item in enumerate(here):
                self._rename(item, (*path, k), names)
        if not isinstance(here, dict):
            return
        for old in list(here):
            key = names.get(old, old)
            if key != old and key not in here:
                here[key] = here.pop(old)
                was, now = (*path, old), (*path, key)
                for p in [p for p in self._line if p[: len(was)] == was]:
                    self._line[now + p[len(was) :]] = self._line.pop(p)
                self._old[now] = old
                self._rename(here[key], now, names)
            else:
                self._rename(here[old], (*path, old), names)

    def _warn_of_old_names(self) -> None:
        """One line per name for the whole file."""
        for old in dict.fromkeys(self._old.values()):
            found = sorted(self.place(p) + (p,) for p, name in self._old.items() if name == old)
            _, where, path = found[0]
            more = [said.removeprefix(f"{self.path}:") for _, said, _ in found[1:]]
            also = f" (so are those at {', '.join(more)})" if more else ""
            key = self.key(path)
            said = f"{where}: {old!r} is the old name of {key}{also}"
            log.warning("%s", printable(said))

    def _override(self, item: str) -> str:
        """Apply one "key=value"; returns what is wrong with it, or nothing."""
        given = f"--set {short(item)}"
        key, sign, text = item.partition("=")
        parts = [part.strip().strip("\"'") for part in key.split(".")]
        names = self._old_names.get(parts[0], {})
        was = next((part for part in parts[2:] if part in names), "")
        parts = parts[:2] + [names.get(part, part) for part in parts[2:]]
        if not sign or not all(parts):
            return f"{given}: expected key=value, for example domain.cell='1 cm'"
        here: dict | list = self.data
        path: tuple = ()
        for k, part in enumerate(parts):
            name = part if isinstance(here, dict) else _index(here, part)
            if name is None:
                known = [str(x.get("name", i)) for i, x in enumerate(here) if isinstance(x, dict)]
                has = ", ".join(known) or f"{len(here)} items"
                return f"{given}: {'.'.join(parts[:k])} has no item '{part}'; it has {has}"
            path += (name,)
            if k == len(parts) - 1:
                here[name] = _value(text)  # type: ignore[index]
                break
            if isinstance(here, dict):
                here.setdefault(name, {})
            here = here[name]  # type: ignore[index]
            if not isinstance(here, dict | list):
                return f"{given}: {'.'.join(parts[: k + 1])} is not a table"
        self._set = {p: said for p, said in self._set.items() if p[: len(path)] != path}
        self._set[path] = item
        if was:
            self._old[path] = was
        return ""


def key_lines(text: str) -> dict[tuple, int]:
    """Line (from 1) of every table, key and array item of a valid TOML text.

    Keyed by the path of names and indices that leads to it in the parsed data.
    """
    scan = _Scan(text)
    scan.document()
    return scan.line


class _Scan:
    """One pass over a text already known to be valid TOML."""

    def __init__(self, text: str):
        self.text, self.at = text, 0
        self.breaks = [m.start() for m in re.finditer("\n", text)]
        self.line: dict[tuple, int] = {}
        self.last: dict[tuple, int] = {}  # index of the newest item of each array of tables

    def document(self) -> None:
        table: tuple = ()
        while self.skip() < len(self.text):
            if self.text[self.at] == "[":
                table = self.header()
            else:
                self.pair(table)

    def header(self) -> tuple:
        start, double = self.at, self.text.startswith("[[", self.at)
        self.at += 2 if double else 1
        parts = self.key()
        self.at += 2 if double else 1
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
        start, path = self.at, table
        for part in self.key():
            path += (part,)
            self.mark(path, start)
        self.at += 1  # the sign =
        self.value(path)

    def key(self) -> list[str]:
        parts = []
        while True:
            self.skip()
            match = (
                _BASIC.match(self.text, self.at)
                or _LITERAL.match(self.text, self.at)
                or _BARE.match(self.text, self.at)
            )
            if match is None:
                raise AssertionError(f"no key at character {self.at} of a valid TOML text")
            self.at = match.end()
            parts.append(next(iter(tomllib.loads(f"{match[0]} = 0"))))
            self.skip()
            if not self.text.startswith(".", self.at):
                return parts
            self.at += 1

    def value(self, path: tuple) -> None:
        self.skip()
        opening = self.text[self.at]
        if opening in "[{":
            self.at += 1
            self.items(path, "]" if opening == "[" else "}")
            return
        match = (
            _LONG.match(self.text, self.at)
            or _BASIC.match(self.text, self.at)
            or _LITERAL.match(self.text, self.at)
            or _SCALAR.match(self.text, self.at)
        )
        self.at = match.end() if match else self.at

    def items(self, path: tuple, closing: str) -> None:
        count = 0
        while self.text[self.skip()] != closing:
            if self.text[self.at] == ",":
                self.at += 1
            elif closing == "]":
                self.mark((*path, count), self.at)
                self.value((*path, count))
                count += 1
            else:
                self.pair(path)
        self.at += 1

    def skip(self) -> int:
        match = _SPACE.match(self.text, self.at)
        self.at = match.end() if match else self.at
        return self.at

    def mark(self, path: tuple, at: int) -> None:
        self.line.setdefault(path, bisect_right(self.breaks, at) + 1)


def printable(text: object) -> str:
    """The text on one line, with the characters that a terminal would obey written as "\\x1b"."""
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in str(text))
    return "".join(shown)


def short(item: str) -> str:
    """Of something that a file holds, as much as a line bears."""
    return item if len(item) <= 200 else f"{item[:197]}..."


def _syntax(path: str, text: str, said: str) -> str:
    if "integer string conversion" in said:
        long = _LONG_NUMBER.search(text)
        above = text.count("\n", 0, long.start()) if long else 0
        return f"{path}:{above + 1}: not valid TOML: an integer must fit in 64 bits"
    match = re.search(r"\(at line (\d+), column (\d+)\)", said)
    line = match[1] if match else str(max(1, len(text.splitlines())))
    column = f" (column {match[2]})" if match else ""
    hint = _unquoted(text.split("\n")[int(line) - 1][:1000]) if match else ""
    return printable(f"{path}:{line}: not valid TOML: {said.partition(' (at ')[0]}{column}{hint}")


def _unquoted(line: str) -> str:
    """The hint at the first value of a line that lacks its quotes: `0.6 s`, or a word; else ""."""
    for value in _BARE_VALUE.findall(_BASIC.sub('""', _LITERAL.sub('""', line)).partition("#")[0]):
        number, name = _NUMBER.fullmatch(value), value.strip()
        word = _BARE.fullmatch(name) and name[0].isalpha()
        if name in ("true", "false", "inf", "nan") or not (number or word):
            continue
        try:
            unit(number[1] if number else "")
        except ValueError:
            continue
        what = "a value with a unit" if number else "a word"
        return f'; {what} needs quotes: "{name}"'
    return ""


def _index(items: list, part: str) -> int | None:
    if part.isdecimal() and len(part) < 10:
        return int(part) if int(part) < len(items) else None
    names = [item.get("name") if isinstance(item, dict) else None for item in items]
    return names.index(part) if part in names else None


def _value(text: str):
    """The TOML value, or the text itself: a shell eats the quotes of "1 cm"."""
    try:
        read = tomllib.loads(f"value = {text}")
    except (ValueError, RecursionError):  # also of a number too long to be read
        return text.strip()
    return read["value"] if list(read) == ["value"] else text.strip()
