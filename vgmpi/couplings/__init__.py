"""Every module in this folder is a coupling, but for folders and names that begin with _;
importing the folder registers them all. The registry is in the order of their kinds, whatever files
are called.
"""

import importlib
import pkgutil

from .base import registry

for _module in sorted(pkgutil.iter_modules(__path__)):
    if not _module.ispkg and not _module.name.startswith("_"):
        importlib.import_module(f"{__name__}.{_module.name}")
for _kind in sorted(registry):
    registry[_kind] = registry.pop(_kind)

__all__ = ["registry"]
