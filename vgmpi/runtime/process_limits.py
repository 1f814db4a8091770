"""Limits and variables of this process with which no command can work."""

import os
import resource

# [bytes] address space of a run of two steps of 30,000 particles (VmPeak 0.80 GiB); with less, MPI
# and the linear algebra of numpy end by a signal or do not end
MIN_ADDRESS_SPACE = 1 << 30
_THREADS = "NUMBA_NUM_THREADS"


def find_unusable_limit() -> str:
    """Return one line on a limit or variable with which commands would fail, or ""."""
    space = resource.getrlimit(resource.RLIMIT_AS)[0]
    if space != resource.RLIM_INFINITY and space < MIN_ADDRESS_SPACE:
        return (
            f"the address space is limited to {space / 2**20:.0f} MiB (ulimit -v): at least"
            f" {MIN_ADDRESS_SPACE / 2**20:.0f} MiB are needed"
        )
    text = os.environ.get(_THREADS, "1").strip()
    if not (text.isdecimal() and int(text) > 0):
        return f"{_THREADS}: must be a whole number of at least 1; got {text!r}"
    return ""
