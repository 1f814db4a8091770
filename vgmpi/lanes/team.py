"""Work that is divided among the threads that share it: a processor's thread does all of it by
itself, a card's threads a part each (engines/cuda/team.py has these for a card).

A kernel that walks over nodes says `for node in each(64)` where what is done at one of them does
not depend on the others, and `meet()` where what follows reads what others of the team wrote.
"""

from ..device.jit import within
from .lanes import place


@within
def each(count):
    """The numbers below `count` that this thread does."""
    return range(count)


@within
def meet():
    """Wait until all of the team are here."""


@within
def flat(array):
    """The place of an array of any shape (lanes.place). On a card arrays come flat."""
    return place(array.reshape(array.size))


@within
def count_up(sums, at, whole):
    """sums[at] += whole, where others may do so at the same time."""
    sums[at] += whole
