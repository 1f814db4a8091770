"""The engines by the names that `--engine` takes."""

from ..engines.base import Engine
from ..engines.cpu import Cpu
from ..engines.numpy.engine import Numpy

ENGINES: dict[str, type[Engine]] = {"cpu": Cpu, "numpy": Numpy}  # those of every machine
CARD = "cuda"  # asks for a card and the extra of that name, which is imported where it is named


def engine_of(name: str) -> type[Engine]:
    """The engine of a name."""
    if name == CARD:
        from ..engines.cuda.engine import Cuda

        return Cuda
    return ENGINES[name]
