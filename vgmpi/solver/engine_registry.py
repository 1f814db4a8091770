"""Registry of the engines by the names that `--engine` takes."""

from vgmpi.solver.engines.cpu import Cpu
from vgmpi.solver.engines.engine_protocol import Engine
from vgmpi.solver.engines.numpy_reference.reference_engine import Numpy

ENGINES: dict[str, type[Engine]] = {"cpu": Cpu, "numpy": Numpy}  # engines of every machine
CARD = "cuda"  # needs a GPU and the extra of that name


def engine_of(name: str) -> type[Engine]:
    """Return the engine class of a name; the CUDA engine is imported only when it is named."""
    if name == CARD:
        from vgmpi.solver.engines.cuda.cuda_engine import Cuda

        return Cuda
    return ENGINES[name]
