"""Peak signal-to-noise ratio (PSNR) of two pictures."""

import numpy as np


def psnr(squared_error: np.ndarray) -> float:
    """Return the peak signal-to-noise ratio [dB] of squared errors of colors in 0..1.

    It is infinite for an empty or vanishing error.
    """
    mean = float(squared_error.mean()) if squared_error.size else 0.0
    return -10.0 * np.log10(mean) if mean > 0 else np.inf
