"""How bodies stand at the start: what is so near that steps have to reckon with it."""

from typing import NamedTuple


class Surroundings(NamedTuple):
    """Of one object's particles."""

    blocks: int = 0  # that they lie in
    phases: tuple[tuple[str, float], ...] = ()  # share of them at most a block from each other one
    collider: float = 0.0  # and from a collider
