"""Options of compiled functions.

Nothing in this folder is compiled with fastmath: the compiler's reordering and contraction depend
on which functions it has inlined, and that on what was compiled and cached before. In torn sheets
one more rounding shows as 50 levels of a pixel, so that two processes would draw different
pictures.
"""

# options of functions that a ray calls often: they allocate nothing, so references to arrays need
# not be counted, which would take most of their time
RAY = {"nogil": True, "error_model": "numpy", "_nrt": False}
