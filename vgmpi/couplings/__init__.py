"""Every module in this folder is a coupling; importing the folder registers them all, in name
order.
"""

import importlib
import pkgutil

from .base import registry

for _name in sorted(m.name for m in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_name}")

__all__ = ["registry"]
