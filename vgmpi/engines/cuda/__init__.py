"""The engine of a graphics card: the processor's kernels, read and compiled anew (program.py)."""
