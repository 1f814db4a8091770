"""What a campaign found."""

from typing import NamedTuple


class Result(NamedTuple):
    """counts: of outcomes by their name. failures: a line each, with where the case is kept."""

    tried: int
    counts: dict[str, int]
    failures: list[str]
