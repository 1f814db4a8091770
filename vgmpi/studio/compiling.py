"""Options of compiled functions."""

# of functions that a ray calls many times: they allocate nothing, so arrays need not be counted,
# which would take most of their time
RAY = {"nogil": True, "error_model": "numpy", "fastmath": True, "_nrt": False}
