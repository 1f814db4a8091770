"""3x3 tensors as nine scalars, row by row: functions for every engine (plain numbers, arrays,
compiled).
"""


def det_minus_one(h):
    """det(I + H) - 1 from H alone, exact to rounding for small H. h: nine scalars."""
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = h
    first = h0 + h4 + h8
    second = (h0 * h4 - h1 * h3) + (h0 * h8 - h2 * h6) + (h4 * h8 - h5 * h7)
    third = h0 * (h4 * h8 - h5 * h7) - h1 * (h3 * h8 - h5 * h6) + h2 * (h3 * h7 - h4 * h6)
    return first + second + third


def left_cauchy_green_minus_one(h):
    """b - I = H + H^T + H H^T for F = I + H, as (00, 11, 22, 01, 02, 12)."""
    h0, h1, h2, h3, h4, h5, h6, h7, h8 = h
    return (
        2.0 * h0 + h0 * h0 + h1 * h1 + h2 * h2,
        2.0 * h4 + h3 * h3 + h4 * h4 + h5 * h5,
        2.0 * h8 + h6 * h6 + h7 * h7 + h8 * h8,
        h1 + h3 + h0 * h3 + h1 * h4 + h2 * h5,
        h2 + h6 + h0 * h6 + h1 * h7 + h2 * h8,
        h5 + h7 + h3 * h6 + h4 * h7 + h5 * h8,
    )
