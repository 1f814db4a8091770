"""Deprecated path of `vgmpi.io.file_layout`."""

import warnings

from vgmpi.io.file_layout import *  # noqa: F403

warnings.warn("vgmpi.output.layout is now vgmpi.io.file_layout", DeprecationWarning, stacklevel=2)
