"""How much two pictures look alike, as one number."""

import numpy as np


def decibels(square: np.ndarray) -> float:
    """Peak signal-to-noise ratio [dB] of squared errors of colours in 0..1; infinite for none."""
    mean = float(square.mean()) if square.size else 0.0
    return -10.0 * np.log10(mean) if mean > 0 else np.inf
