"""Memory that this process may still take, and whether something fits into it.

Requirements are lower bounds: a refused request would not have fitted.
"""

from pathlib import Path

_OWN, _CGROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
# Files in which control groups of versions 2 and 1 tell their limit, their usage, and how much of
# that is cached files.
_LIMITS = (
    ("0::", _CGROUPS, "memory.max", "memory.current", "{}_file"),
    (":memory:", _CGROUPS / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes",
     "total_{}_file"),
)  # fmt: skip


class InsufficientMemoryError(ValueError):
    """Error of something that exceeds the memory; one line with what it needs and what there is."""


def require_memory(needed: float, what: str) -> None:
    """Raise TooLarge if `needed` bytes for `what` exceed the available memory, including swap."""
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
    try:
        lines = _OWN.read_text().splitlines()
    except OSError:
        return []
    for prefix, root, limit_file, current, files in _LIMITS:
        own_group = next(
            (line.split(prefix)[1].lstrip("/") for line in lines if prefix in line), ""
        )
        for group in (root / own_group, *(root / each for each in Path(own_group).parents)):
            try:
                limit = (group / limit_file).read_text().strip()
                if limit != "max":
                    statistics, used = (
                        _table(group / "memory.stat"),
                        int((group / current).read_text()),
                    )
                    cached = sum(statistics.get(files.format(k), 0) for k in ("active", "inactive"))
                    limits.append(max(int(limit) - used + cached, 1))
            except (OSError, ValueError, IndexError):
                pass  # missing or not readable
    return limits


def _table(path: Path, unit: int = 1) -> dict[str, int]:
    """Return the numbers of a file with lines of a name and a number, times `unit`."""
    words = (line.replace(":", " ").split() for line in path.read_text().splitlines())
    return {w[0]: int(w[1]) * unit for w in words}
