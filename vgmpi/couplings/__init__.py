"""Every module in this folder is a coupling, but for folders and names that begin with _;
importing the folder registers them all. The registry is in the order of their kinds, whatever files
are called.
"""

from ..tables import register_kinds
from .base import registry

register_kinds(__name__, __path__, registry)

__all__ = ["registry"]
