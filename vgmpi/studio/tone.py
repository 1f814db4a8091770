"""Display values and linear light: sRGB and a tone curve that keeps base colors.

References:
    Khronos Group. Khronos PBR Neutral tone mapper. 2024.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY

START = 0.8 - 0.04  # of the brightest channel, above which it is compressed
DESATURATION = 0.15
ENTRIES = 32768  # of sRGB values that are known; those between are linear to 1e-6
_TABLE = 1.055 * (np.arange(ENTRIES + 2) / ENTRIES) ** (1 / 2.4) - 0.055


def to_linear(display: np.ndarray) -> np.ndarray:
    """Linear light of sRGB display values 0..1."""
    c = np.clip(display, 0.0, 1.0)
    return np.where(c < 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4)


def scene_linear(display: np.ndarray, tone: bool) -> np.ndarray:
    """Linear light that is shown as these display values: the inverse of `show`.

    Saturated bright colors need light below 0 in their least channel, as the curve desaturates.
    """
    c = to_linear(display)
    if not tone:
        return c
    peak = c.max(axis=-1, keepdims=True)
    d = 1.0 - START
    bright = np.minimum(peak, 0.995)
    before = d * d / (1.0 - bright) - d + START
    g = 1.0 - 1.0 / (DESATURATION * (before - bright) + 1.0)
    colored = (c - g * bright) / np.maximum(1.0 - g, 1e-6) * (before / np.maximum(bright, 1e-6))
    c = np.where(peak > START, colored, c)
    least = c.min(axis=-1, keepdims=True)
    # x - offset of the least channel: x below 0, x^2 6.25 below 0.08, x - 0.04 above
    offset = np.where(least < 0.04, np.sqrt(np.maximum(least, 0.0) / 6.25) - least, 0.04)
    return c + np.where(least < 0.0, 0.0, offset)


@cached(**RAY)
def shown(red, green, blue, tone):
    """Display values of linear light."""
    if tone:
        least = min(red, min(green, blue))
        offset = 0.0
        if least > 0.0:
            offset = least - 6.25 * least * least if least < 0.08 else 0.04
        red, green, blue = red - offset, green - offset, blue - offset
        peak = max(red, max(green, blue))
        if peak > START:
            d = 1.0 - START
            new = 1.0 - d * d / (peak + d - START)
            scale = new / peak
            g = 1.0 - 1.0 / (DESATURATION * (peak - new) + 1.0)
            red = red * scale + g * (new - red * scale)
            green = green * scale + g * (new - green * scale)
            blue = blue * scale + g * (new - blue * scale)
    return _encoded(red), _encoded(green), _encoded(blue)


@cached(**RAY)
def _encoded(c):
    c = min(max(c, 0.0), 1.0)
    if c < 0.0031308:
        return 12.92 * c
    at = c * ENTRIES
    k = int(at)
    return _TABLE[k] + (at - k) * (_TABLE[k + 1] - _TABLE[k])


@cached(nogil=True, error_model="numpy")
def show(light, tone, out):
    """Display values out (height, width, 3) of linear light (height, width, 3)."""
    for j in range(light.shape[0]):
        for k in range(light.shape[1]):
            out[j, k, 0], out[j, k, 1], out[j, k, 2] = shown(
                light[j, k, 0], light[j, k, 1], light[j, k, 2], tone
            )
