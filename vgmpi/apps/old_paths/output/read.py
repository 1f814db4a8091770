"""Deprecated path of `vgmpi.io.run_reader`."""

import warnings

from vgmpi.io.run_reader import *  # noqa: F403
from vgmpi.io.run_reader import RunError  # noqa: F401
from vgmpi.io.run_reader import RunReader as RunFiles  # noqa: F401

warnings.warn("vgmpi.output.read is now vgmpi.io.run_reader", DeprecationWarning, stacklevel=2)
