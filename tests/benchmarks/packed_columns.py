"""Splashed liquids over the same columns packed at rest: the rows of test_packed_columns.py.

Splashes are chaotic: a slightly other stiffness gives another run of the same statistics.
"""

import tempfile
from pathlib import Path

from tests.physics import test_packed_columns

HEAD = (
    "| scene | max_speed [m/s] | time | height | lowest layer | surface [cells] |\n"
    + "|---" * 6
    + "|"
)


def rows(case: str, speed: float) -> list[str]:
    """Return the rows of the table, one per time.

    Args:
        case: "released", "shaken" or "broken".
        speed: `max_speed` of the water [m/s].
    """
    with tempfile.TemporaryDirectory() as folder:
        measures = test_packed_columns.after(Path(folder), case, "shifting", speed=speed)
    return [
        f"| {case} | {speed:g} | {time:g} s | {100 * (height - 1):+.1f} % | {lowest:.3f} |"
        f" {surface:.2f} |"
        for time, (height, lowest, surface) in measures.items()
    ]
