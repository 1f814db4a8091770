"""Options of compiled functions.

Nothing in this folder is compiled with fastmath: the compiler's reordering and contraction depend
on which functions it has inlined, and that on what was compiled and cached before. In torn sheets
one more rounding shows as 50 levels of a pixel, so that two processes would draw different
pictures.
"""

# options of functions that a ray calls often: they allocate nothing, so references to arrays need
# not be counted, which would take most of their time
RAY = {"nogil": True, "error_model": "numpy", "_nrt": False}
# options of the functions at the end of a ray's calls. A call hands over every array of the scene,
# up to some hundred numbers, and takes longer than what these functions do; they are compiled into
# the functions that call them. Without fastmath this changes no rounding.
LEAF = {**RAY, "forceinline": True}
