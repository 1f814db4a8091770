"""Cores that this process may use."""

import math
import os
import time
from pathlib import Path

_STATISTICS = Path("/proc/stat")
MIN_SPAN = 0.2  # [s] least time over which idle cores are measured
_OWN, _CGROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
_TOPOLOGY = "/sys/devices/system/cpu/cpu{}/topology/thread_siblings_list"


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
    try:
        lines = _OWN.read_text().splitlines()
    except OSError:
        return granted
    for line in lines:
        _, controllers, path = line.split(":", 2)
        is_second = not controllers
        if not is_second and "cpu" not in controllers.split(","):
            continue
        root, own = _CGROUPS if is_second else _CGROUPS / "cpu", Path(path.lstrip("/"))
        for group in (root / own, *(root / above for above in own.parents)):
            try:
                if is_second:
                    limit, period = (group / "cpu.max").read_text().split()
                else:
                    limit = (group / "cpu.cfs_quota_us").read_text().strip()
                    period = (group / "cpu.cfs_period_us").read_text().strip()
                if limit not in ("max", "-1"):
                    granted = min(granted, int(limit) / int(period))
            except (OSError, ValueError, ZeroDivisionError):
                pass  # missing or not readable
    return granted
