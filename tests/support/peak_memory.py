"""The peak memory of this process, which the kernel counts and forgets when told."""

import re
from pathlib import Path


def forget() -> None:
    """From now on the peak is what there is now."""
    Path("/proc/self/clear_refs").write_text("5")


def megabytes() -> float:
    """The peak since the start, or since it was forgotten."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return int(found[1]) / 1024
