"""Limits of this process: memory and cores that it may use, and what no command can work with.

Requirements on memory are lower bounds: a refused request would not have fitted.
"""

import math
import os
import resource
import time
from collections.abc import Iterator
from pathlib import Path

_OWN, _CGROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
# Files in which control groups of versions 2 and 1 tell their limit, their usage, and how much of
# that is cached files.
_MEMORY_FILES = ("memory.max", "memory.current", "{}_file")
_MEMORY_FILES_1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_{}_file")
_STATISTICS = Path("/proc/stat")
_TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"
MIN_SPAN = 0.2  # [s] least time over which idle cores are measured
# [bytes] address space of a run of two steps of 30,000 particles (VmPeak 0.80 GiB); with less, MPI
# and the linear algebra of numpy end by a signal or do not end
MIN_ADDRESS_SPACE = 1 << 30
_THREADS = "NUMBA_NUM_THREADS"


class InsufficientMemoryError(ValueError):
    """Error of something that exceeds the memory; one line with what it needs and what there is."""


def require_memory(needed: float, what: str) -> None:
    """Refuse what exceeds the available memory, including swap.

    Args:
        needed: Size [bytes].
        what: Beginning of the message, up to the size.

    Raises:
        InsufficientMemoryError: If it does not fit.
    """
    available = available_memory(swap=True)
    if available and needed > available:
        raise InsufficientMemoryError(
            f"{what} {format_bytes(needed)}; {format_bytes(available)} are free on this machine"
        )


def format_bytes(size: float) -> str:
    """Return a number of bytes as text in GiB or TiB."""
    return f"{size / 2**30:.3g} GiB" if size < 2**40 else f"{size / 2**40:.3g} TiB"


def available_memory(swap: bool = False) -> int:
    """Return the bytes that this process may still take; 0 if that is not known.

    The least of the free memory and of what its control groups leave counts; cached files count
    as free.

    Args:
        swap: Add free swap space.
    """
    try:
        meminfo = _table(Path("/proc/meminfo"), 1024)
        limits = [meminfo["MemAvailable"]]
    except (OSError, KeyError, ValueError, IndexError):
        return 0
    return min([*limits, *_cgroup_headroom()]) + (meminfo.get("SwapFree", 0) if swap else 0)


def _cgroup_headroom() -> list[int]:
    """Return what the control groups of this process and their parents leave [bytes]."""
    limits = []
    for group, is_version_2 in _control_groups("memory"):
        limit_file, current, files = _MEMORY_FILES if is_version_2 else _MEMORY_FILES_1
        try:
            limit = (group / limit_file).read_text().strip()
            if limit != "max":
                statistics = _table(group / "memory.stat")
                used = int((group / current).read_text())
                cached = sum(statistics.get(files.format(k), 0) for k in ("active", "inactive"))
                limits.append(max(int(limit) - used + cached, 1))
        except (OSError, ValueError, IndexError):
            pass  # missing or not readable
    return limits


def _table(path: Path, unit: int = 1) -> dict[str, int]:
    """Return the numbers of a file with lines of a name and a number, times `unit`."""
    words = (line.replace(":", " ").split() for line in path.read_text().splitlines())
    return {w[0]: int(w[1]) * unit for w in words}


def available_cores() -> int:
    """Return the number of cores that this process may use; hardware threads count as cores."""
    return len(_allowed())


def physical_cores() -> int:
    """Return the number of physical cores that this process may use, by affinity and quota.

    Hardware threads of one core count once. A control group may grant less time than the cores
    have (`docker run --cpus`).
    """
    allowed = _allowed()
    siblings = set()
    for number in allowed:
        try:
            siblings.add(Path(_TOPOLOGY.format(number)).read_text().strip())
        except OSError:  # not Linux, or hidden from this container
            siblings.add(str(number))
    return max(1, math.ceil(min(len(siblings), _quota())))


class FreeCores:
    """Meter of the cores that other programs leave, from its making to `measure`."""

    def __init__(self):
        """Begin to measure."""
        self._start = time.monotonic(), time.process_time(), _idle_seconds()

    def measure(self) -> float:
        """Return the number of cores that were idle or this process's own; inf if unknown.

        It waits until MIN_SPAN is over.
        """
        began, own, idle = self._start
        time.sleep(max(0.0, began + MIN_SPAN - time.monotonic()))
        span, idle = time.monotonic() - began, _idle_seconds() - idle
        return math.inf if math.isnan(idle) else (idle + time.process_time() - own) / span


def _idle_seconds() -> float:
    """Return the time [s] that the cores of this process have been idle; nan if unknown."""
    allowed = {f"cpu{number}" for number in _allowed()}
    try:
        rows = [line.split() for line in _STATISTICS.read_text().splitlines()]
        ticks = sum(int(row[4]) + int(row[5]) for row in rows if row and row[0] in allowed)
    except (OSError, ValueError, IndexError):
        return math.nan
    return ticks / os.sysconf("SC_CLK_TCK")


def _allowed() -> list[int]:
    """Return the numbers of the hardware threads that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return sorted(os.sched_getaffinity(0))
    return list(range(os.cpu_count() or 1))


def _quota() -> float:
    """Return the processor time per time that control groups grant; infinity if all."""
    granted = math.inf
    for group, is_version_2 in _control_groups("cpu"):
        try:
            if is_version_2:
                limit, period = (group / "cpu.max").read_text().split()
            else:
                limit = (group / "cpu.cfs_quota_us").read_text().strip()
                period = (group / "cpu.cfs_period_us").read_text().strip()
            if limit not in ("max", "-1"):
                granted = min(granted, int(limit) / int(period))
        except (OSError, ValueError, ZeroDivisionError):
            pass  # missing or not readable
    return granted


def _control_groups(controller: str) -> Iterator[tuple[Path, bool]]:
    """Yield the control groups of this process and their parents that may limit a resource.

    Args:
        controller: Name of the resource, "memory" or "cpu".

    Yields:
        Folder of a group, and whether it is of version 2.
    """
    try:
        lines = _OWN.read_text().splitlines()
    except OSError:
        return
    for line in lines:
        _, controllers, path = line.split(":", 2)
        is_version_2 = not controllers
        if is_version_2 or controller in controllers.split(","):
            root, own = _CGROUPS if is_version_2 else _CGROUPS / controller, Path(path.lstrip("/"))
            yield from ((root / group, is_version_2) for group in (own, *own.parents))


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
