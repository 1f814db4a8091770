"""End of a child with its parent, however the parent ends (Linux)."""

import ctypes
import signal
from collections.abc import Callable

PR_SET_PDEATHSIG = 1  # number of the call, as in <sys/prctl.h>


def die_with_parent(number: signal.Signals) -> Callable[[], None]:
    """Return a function to call in a child: the kernel then signals it when its parent dies.

    Args:
        number: The signal.
    """
    prctl = getattr(ctypes.CDLL(None), "prctl", None)

    def arm() -> None:
        """Ask the kernel for the signal; runs in the child."""
        if prctl is not None:
            prctl(PR_SET_PDEATHSIG, int(number))

    return arm
