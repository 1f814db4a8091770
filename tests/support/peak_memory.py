"""The peak memory of this process, which the kernel counts and forgets when told; and programs in a
process of their own, of which it is measured."""

import json
import re
import sys
from pathlib import Path


def forget() -> None:
    """From now on the peak is what there is now."""
    Path("/proc/self/clear_refs").write_text("5")


def megabytes() -> float:
    """The peak since the start, or since it was forgotten."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found
    return int(found[1]) / 1024


def read_apart(program: str, folder: Path) -> list:
    """The rows of JSON that a program, as text, prints of a folder; it says nothing else."""
    from tests.support.launch import run

    job = run([sys.executable, "-c", program, folder])
    assert job.returncode == 0 and job.stderr == "", job.stderr[-2000:]
    return [json.loads(line) for line in job.stdout.splitlines()]
