"""How far two pictures are apart."""

import numpy as np


def psnr(a, b, peak=1.0):
    """Peak signal to noise ratio [dB] of values from 0 to `peak`; others are cut to them."""
    a, b = (np.clip(np.asarray(values, np.float64), 0, peak) for values in (a, b))
    return 10 * np.log10(peak**2 / np.mean((a - b) ** 2))
