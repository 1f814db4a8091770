"""Options of compiled functions.

Nothing in this folder is compiled with fastmath: the compiler's reordering and contraction depend
on which functions it has inlined, and that on what was compiled and cached before. In torn sheets
one more rounding shows as 50 levels of a pixel, so that two processes would draw different
pictures.
"""

from typing import Any

# options of functions that a ray calls often: they allocate nothing, so references to arrays need
# not be counted, which would take most of their time
RAY: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
# options of the functions at the end of a ray's calls. A call hands over every array of the scene,
# up to some hundred numbers, and takes longer than what these functions do; they are compiled into
# the functions that call them. Without fastmath this changes no rounding.
LEAF: dict[str, Any] = {**RAY, "forceinline": True}
# options of functions that Python calls and that trace rays: they own what they call, so that LLVM
# inlines what is called once, and leaves out unused arguments of the rest
KERNEL: dict[str, Any] = {"nogil": True, "error_model": "numpy", "owns_callees": True}
