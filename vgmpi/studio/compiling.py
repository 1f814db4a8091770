"""Options of compiled functions.

Nothing in this folder is compiled with fastmath: what the compiler may reorder or contract depends
on which functions it has inlined, and that on what was compiled and kept before. In torn sheets one
rounding more shows as 50 levels of a pixel, so that two processes would draw different pictures.
"""

# of functions that a ray calls many times: they allocate nothing, so arrays need not be counted,
# which would take most of their time
RAY = {"nogil": True, "error_model": "numpy", "_nrt": False}
