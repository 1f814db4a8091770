"""Couplings: every module of this folder is one, except folders and names that begin with _.

Importing the folder registers them all, in the order of their kinds and not of file names.
"""

from vgmpi.runtime.config.schema import register_kinds

from .interaction import registry

register_kinds(__name__, __path__, registry)

__all__ = ["registry"]
