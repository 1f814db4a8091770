"""Bounds on a TOML text that hold before a parser sees it: parsing takes memory for all it holds.

A table of n dotted parts, and the lines of its n keys, take memory as n squared; an item takes some
hundred times the letters that it is written with.
"""

import re
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
