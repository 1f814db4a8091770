"""The memory that this process may still take, and whether something fits into it.

What is asked for is counted from below: what is refused would not have fitted.
"""

from pathlib import Path

_OWN, _CGROUPS = Path("/proc/self/cgroup"), Path("/sys/fs/cgroup")
# where control groups tell their limits, what they use, and how much of that is files: of version 2
# and 1
_LIMITS = (
    ("0::", _CGROUPS, "memory.max", "memory.current", "{}_file"),
    (":memory:", _CGROUPS / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes",
     "total_{}_file"),
)  # fmt: skip


class TooLarge(ValueError):
    """Something that does not fit into the memory; one line that says what it needs and has."""


def check(needed: float, what: str) -> None:
    """Raises TooLarge where `needed` bytes, of `what`, are more than there are, swap included."""
    have = free(swap=True)
    if have and needed > have:
        raise TooLarge(f"{what} {gib(needed)}; {gib(have)} are free on this machine")


def gib(size: float) -> str:
    """A number of bytes for people."""
    return f"{size / 2**30:.3g} GiB" if size < 2**40 else f"{size / 2**40:.3g} TiB"


def free(swap: bool = False) -> int:
    """Bytes this process may still take: free memory, or what its control groups leave; 0 if not
    known. Files in memory count as free. swap: with the room that is left on disks."""
    try:
        told = _table(Path("/proc/meminfo"), 1024)
        found = [told["MemAvailable"]]
    except (OSError, KeyError, ValueError, IndexError):
        return 0
    return min([*found, *_left()]) + (told.get("SwapFree", 0) if swap else 0)


def _left() -> list[int]:
    """What the control groups of this process and those around them leave [bytes]."""
    found = []
    try:
        lines = _OWN.read_text().splitlines()
    except OSError:
        return []
    for mark, root, most, current, files in _LIMITS:
        own = next((line.split(mark)[1].lstrip("/") for line in lines if mark in line), "")
        for group in (root / own, *(root / each for each in Path(own).parents)):
            try:
                limit = (group / most).read_text().strip()
                if limit != "max":
                    of, used = _table(group / "memory.stat"), int((group / current).read_text())
                    cached = sum(of.get(files.format(k), 0) for k in ("active", "inactive"))
                    found.append(max(int(limit) - used + cached, 1))
            except (OSError, ValueError, IndexError):
                pass  # not there, or not for us to see
    return found


def _table(path: Path, unit: int = 1) -> dict[str, int]:
    """Lines of a name and a number."""
    words = (line.replace(":", " ").split() for line in path.read_text().splitlines())
    return {w[0]: int(w[1]) * unit for w in words}
