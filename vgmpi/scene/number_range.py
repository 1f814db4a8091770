"""Range of the numbers of materials that the precision of a run can compute with."""

import math
from typing import Any

# Moduli, densities and their ratios stay normal numbers of the precision within this range.
LIMITS = {"single": 1e30, "double": 1e200}


def numbers_out_of_range(material: Any, precision: str) -> list[tuple[str, str]]:
    """Return (key, message) of each number of a material that the precision cannot compute with.

    Args:
        material: Table of a material.
        precision: `accuracy.precision`.
    """
    limit, errors = LIMITS[precision], []
    for key, value in material:
        if not isinstance(value, float) or value == 0.0 or not math.isfinite(value):
            continue
        if not 1.0 / limit <= abs(value) <= limit:
            limits = f"between {1.0 / limit:.0e} and {limit:.0e}"
            errors.append((
                key,
                f"is {value:g} in SI units; {precision} precision computes with numbers {limits}",
            ))  # fmt: skip
    return errors
