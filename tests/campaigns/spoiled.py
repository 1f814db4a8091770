"""TOML texts spoiled at random: what a slip of the hand does, and what malice does."""

import random
import re
from collections.abc import Iterator
from pathlib import Path

_WORD = re.compile(r'"[^"\n]*"|[-+]?\b\d+(?:\.\d*)?(?:[eE][-+]?\d+)?\b|\btrue\b|\bfalse\b')
_NUMBER = re.compile(r"(?<![\w#.])[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_KEY = re.compile(r"(?<![\w\"'])([A-Za-z_]\w*)(?=\s*=)")

UNITS = ["", " m", " cm", " mm", " um", " km", " kg", " s", " ms", " h", " Pa", " GPa", " Hz", " %",
         " deg", " rpm", " K", " kg/m3", " m/s", " m2/s", " Pa s", " furlong", " m^9", " m/m/m",
         " cm/", " /s", " 1/s", " m**2", " °C", " µm"]  # fmt: skip
NUMBERS = ["0", "-0.0", "1", "-1", "2", "3", "7", "1e-5", "1e5", "1e-12", "1e12", "1e-50", "1e50",
           "1e-100", "1e100", "1e-160", "1e160", "1e-300", "1e300", "1.7976931348623157e308",
           "5e-324", "1e309", "-1e309", "inf", "-inf", "nan", "-nan", "2147483647", "2147483648",
           "-2147483649", "9223372036854775807", "-9223372036854775808", "9223372036854775808",
           "0x7fff_ffff", "0o17", "0b1", "1_000_000", "0.1", "0.5", "0.999999", "1.0000001", "100",
           "1000", "100000", "10000000000"]  # fmt: skip
OTHERS = ["true", "false", '""', "[]", "{}", "[[]]", "[{}]", "[1]", "[1, 2]", "[1, 2, 3]",
          "[0, 0, 0]", "[1, 2, 3, 4]", '["a", "b"]', "[nan, 0, 0]", "[1e300, 1e300, 1e300]",
          "[[0, 0, 0], [0, 0, 0]]", "[[1, 1, 1], [0, 0, 0]]", "[[0, 0, 0], [1e9, 1e9, 1e9]]",
          "{ a = 1 }", "{ kind = 1 }", "1979-05-27", "07:32:00", "1979-05-27T07:32:00Z",
          "'''\na\nb'''", '"\\u0000"', '"\\u001b[31m"', '"../../../etc/passwd"', '"/dev/zero"',
          '"/dev/stdin"', '"."', '"~"', '"#12345"', '"#gggggg"', '"none"', '"auto"', '"off"',
          '"1 cm"', '"1e400 cm"', '"-1 cm"', '"cm"', '"nan m"', '"١ m"']  # fmt: skip
UNICODE = ["é", "水", "🦆", "\u202e", "\u0000", "\x1b[2J", "\ufeff", "\u2028", "\r", "\x85",
           "\ud7ff", "a\u0301", "\U0010ffff"]  # fmt: skip


class Spoiler:
    """texts: good ones, whose lines and words also go into each other. keys: names of keys that a
    table may get."""

    def __init__(self, texts: list[str], keys: list[str]):
        self.texts, self.keys = texts, keys
        self.lines = [line for text in texts for line in text.splitlines() if "=" in line]
        self.words = sorted({w for text in texts for w in _WORD.findall(text)})

    def spoiled(self, random: random.Random) -> bytes:
        """One of the texts after one to three blows."""
        text, gentle = random.choice(self.texts), random.random() < 0.5
        for _ in range(random.choice((1, 1, 1, 2, 3))):
            text = random.choice(_GENTLE if gentle else _BLOWS)(self, text, random)
        data = text.encode()
        if not gentle and random.random() < 0.15:
            data = _bytes_flipped(data, random)
        return data

    def files(self, count: int, seed: int, folder: Path) -> Iterator[tuple[random.Random, Path]]:
        """`count` spoiled texts in files of the folder, each with the random numbers it is of: the
        same whatever their count."""
        for k in range(count):
            draw, path = random.Random(f"{seed} {k}"), folder / f"{k:04}.toml"
            path.write_bytes(self.spoiled(draw))
            yield draw, path

    def good(self, folder: Path) -> list[Path]:
        """The texts as they are, in files of the folder."""
        paths = [folder / f"good{k}.toml" for k in range(len(self.texts))]
        for path, text in zip(paths, self.texts, strict=True):
            path.write_text(text)
        return paths

    def value(self, random: random.Random) -> str:
        """Something that may stand behind a sign =."""
        match random.randrange(8):
            case 0 | 1:
                return random.choice(NUMBERS)
            case 2:
                return f'"{random.choice(NUMBERS)}{random.choice(UNITS)}"'
            case 3 | 4:
                return random.choice(self.words)
            case 5:
                return "[" + ", ".join(random.choice(NUMBERS) for _ in range(3)) + "]"
            case _:
                return random.choice(OTHERS)


def _value_replaced(known: Spoiler, text: str, random: random.Random) -> str:
    return _sub(_WORD, text, random, lambda m: known.value(random))


def _whole_value_replaced(known: Spoiler, text: str, random: random.Random) -> str:
    """Lists and tables too, as far as they stand on one line."""
    found = re.compile(r"(?m)(?<==)[^=\n#]*$")
    return _sub(found, text, random, lambda m: " " + known.value(random))


def _number_replaced(known: Spoiler, text: str, random: random.Random) -> str:
    return _sub(_NUMBER, text, random, lambda m: random.choice(NUMBERS))


def _value_exchanged(known: Spoiler, text: str, random: random.Random) -> str:
    """For one that the same key has elsewhere."""

    def other(match: re.Match) -> str:
        lines = [x for x in known.lines if x.split("=")[0].strip() == match[1]]
        return random.choice(lines or [match[0]])

    return _sub(re.compile(r"(?m)^(\w+) *=.*$"), text, random, other)


def _scaled_a_little(known: Spoiler, text: str, random: random.Random) -> str:
    k = random.choice((-2, -1, 1, 2))
    return _sub(_NUMBER, text, random, lambda m: _times(m[0], k))


def _scaled(known: Spoiler, text: str, random: random.Random) -> str:
    k = random.choice((-300, -100, -30, -9, -6, -3, -2, -1, 1, 2, 3, 6, 9, 30, 100, 300))
    return _sub(_NUMBER, text, random, lambda m: _times(m[0], k))


def _times(number: str, k: int) -> str:
    whole, _, power = number.lower().partition("e")
    return f"{whole}e{int(power or 0) + k}"


def _negated(known: Spoiler, text: str, random: random.Random) -> str:
    return _sub(_NUMBER, text, random, lambda m: f"-{m[0].lstrip('+-')}")


def _unit_changed(known: Spoiler, text: str, random: random.Random) -> str:
    found = re.compile(r'"\s*([-+]?[\d.]+(?:e-?\d+)?)\s*[A-Za-z/%0-9 ]*"')
    return _sub(found, text, random, lambda m: f'"{m[1]}{random.choice(UNITS)}"')


def _line_deleted(known: Spoiler, text: str, random: random.Random) -> str:
    lines = text.splitlines()
    del lines[random.randrange(len(lines))]
    return "\n".join(lines or [""]) + "\n"


def _line_doubled(known: Spoiler, text: str, random: random.Random) -> str:
    lines = text.splitlines()
    lines.insert(random.randrange(len(lines) + 1), random.choice(lines))
    return "\n".join(lines) + "\n"


def _lines_swapped(known: Spoiler, text: str, random: random.Random) -> str:
    lines = text.splitlines()
    a, b = random.randrange(len(lines)), random.randrange(len(lines))
    lines[a], lines[b] = lines[b], lines[a]
    return "\n".join(lines) + "\n"


def _foreign_line(known: Spoiler, text: str, random: random.Random) -> str:
    lines = text.splitlines()
    lines.insert(random.randrange(len(lines) + 1), random.choice(known.lines))
    return "\n".join(lines) + "\n"


def _key_added(known: Spoiler, text: str, random: random.Random) -> str:
    """A key of any table behind a random header."""
    lines = text.splitlines()
    at = [k + 1 for k, line in enumerate(lines) if line.startswith("[")] or [0]
    lines.insert(random.choice(at), f"{random.choice(known.keys)} = {known.value(random)}")
    return "\n".join(lines) + "\n"


def _key_misspelt(known: Spoiler, text: str, random: random.Random) -> str:
    def wrong(match: re.Match) -> str:
        key, k = match[1], random.randrange(len(match[1]))
        ways = (key[:k] + key[k + 1 :] or "x", key[:k] + key[k] + key[k:], key.upper(),
                f'"{key} "', f'"{key}{random.choice(UNICODE[:3])}"', f"{key}.{key}", '""',
                random.choice(known.keys))  # fmt: skip
        return random.choice(ways)

    return _sub(_KEY, text, random, wrong)


def _table_moved(known: Spoiler, text: str, random: random.Random) -> str:
    """Or doubled, or left out."""
    tables = re.split(r"(?m)^(?=\[)", text)
    k = random.randrange(len(tables))
    table = tables[k] if random.random() < 0.3 else tables.pop(k)
    if random.random() < 0.7:
        tables.insert(random.randrange(len(tables) + 1), table)
    return "".join(tables)


def _header_changed(known: Spoiler, text: str, random: random.Random) -> str:
    def other(match: re.Match) -> str:
        name = match[1].strip("[]")
        ways = (f"[[{name}]]", f"[{name}]", f"[{name}.x]", f"[x.{name}]", f"[{name}", '[""]',
                f'["{name}"]', f"[{name}.{name}]", f"[[{name}.shape]]")  # fmt: skip
        return random.choice(ways)

    return _sub(re.compile(r"(?m)^(\[+[^\]\n]*\]+)"), text, random, other)


def _nested(known: Spoiler, text: str, random: random.Random) -> str:
    n = random.choice((3, 50, 99, 150, 400, 3000))
    ways = (("[", "", "]"), ("{a=", "1", "}"), ("{ union = [", "", "]}"))
    first, middle, last = random.choice(ways)
    deep = first * n + middle + last * n
    return _sub(re.compile(r"(?m)(?<==)[^=\n#]*$"), text, random, lambda m: " " + deep)


def _many(known: Spoiler, text: str, random: random.Random) -> str:
    """A list, a text, a key or a number of great length, or many tables."""
    n = random.choice((10, 300, 5000))
    match random.randrange(6):
        case 5:  # a table of many dotted parts
            return f"{text}\n{'a.' * n}a = 1\n"
        case 0:
            long = "[" + "1, " * n + "]"
        case 1:
            long = '"' + random.choice(["x", "水", " ", "%s", "{0}", "\\n"]) * n + '"'
        case 2:
            long = "9" * n
        case 3:
            long = "1." + "0" * n + "1"
        case _:
            tables = re.split(r"(?m)^(?=\[)", text)
            return text + random.choice(tables) * min(n, 300)
    return _sub(_WORD, text, random, lambda m: long)


def _unicode(known: Spoiler, text: str, random: random.Random) -> str:
    k = random.randrange(len(text) + 1)
    return text[:k] + random.choice(UNICODE) + text[k:]


def _cut(known: Spoiler, text: str, random: random.Random) -> str:
    """Cut off, or another text behind it."""
    if random.random() < 0.5:
        return text[: random.randrange(len(text) + 1)]
    return text + random.choice(known.texts)


def _bytes_flipped(data: bytes, random: random.Random) -> bytes:
    out = bytearray(data)
    for _ in range(random.choice((1, 1, 3, 8)) if out else 0):
        k = random.randrange(len(out))
        out[k] = random.choice((out[k] ^ 1 << random.randrange(8), random.randrange(256)))
    return bytes(out)


def _sub(found: re.Pattern, text: str, random: random.Random, other) -> str:
    """The text with one of the places found, outside of comments, replaced."""
    comments = [m.span() for m in re.finditer(r'(?m)(?:^|\s)#[^"\n]*$', text)]
    places = [m for m in found.finditer(text) if not any(a <= m.start() < b for a, b in comments)]
    if not places:
        return text
    if random.random() < 0.5:  # keys that are there once, such as cell, get as much as others
        by_key: dict[str, list[re.Match]] = {}
        for m in places:
            line = text[text.rfind("\n", 0, m.start()) + 1 :]
            by_key.setdefault(line.partition("=")[0].strip(), []).append(m)
        places = by_key[random.choice(sorted(by_key))]
    match = random.choice(places)
    return text[: match.start()] + other(match) + text[match.end() :]


# after which a text is often still one that passes
_GENTLE = (
    *(_number_replaced,) * 2,
    *(_value_exchanged,) * 3,
    *(_scaled_a_little,) * 3,
    _scaled,
    _negated,
    _line_deleted,
    _table_moved,
)
_BLOWS = (
    *(_value_replaced,) * 5,
    *(_whole_value_replaced,) * 3,
    *(_scaled,) * 4,
    *(_key_added,) * 5,
    *(_foreign_line,) * 2,
    *(_key_misspelt,) * 2,
    _negated,
    _unit_changed,
    _line_deleted,
    _line_doubled,
    _lines_swapped,
    _table_moved,
    _header_changed,
    _nested,
    _many,
    _unicode,
    _cut,
)
