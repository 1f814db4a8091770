"""What a coupling is: a table of the scene that says how two materials or objects act on each
other.
"""

from typing import get_args

registry: dict[str, type] = {}


def coupling(cls: type) -> type:
    """Register a coupling's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two couplings call themselves {kind!r}")
    registry[kind] = cls
    return cls
