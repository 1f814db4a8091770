"""How bodies stand at a moment: what is so near that steps have to reckon with it."""

from typing import NamedTuple


class Near(NamedTuple):
    """What is near another phase."""

    phase: str
    share: float  # of the particles, at most a block from it
    blocks: int  # that these lie in
    nodes: int  # blocks of nodes that both reach


class Surroundings(NamedTuple):
    """Of one object's particles."""

    blocks: int = 0  # that they lie in
    phases: tuple[Near, ...] = ()  # of each other one
    collider: float = 0.0  # share of them at most a block from a collider
