"""What code is compiled for, and whether it is compiled already."""

import functools
import hashlib
import pathlib
import platform
import zlib

from llvmlite import binding
from numba import config

from .jit import cache_folder, user_folder

__all__ = ["model", "processor", "stamp", "user_folder", "vector_bytes", "widest"]

_SUM = """
target triple = "{triple}"
define <16 x float> @sum(<16 x float> %a, <16 x float> %b) {{
  %c = fadd <16 x float> %a, %b
  ret <16 x float> %c
}}
"""


def model() -> str:
    """The processor by the name its maker gave it, and the kind code is compiled for."""
    name = platform.machine() or "unknown"
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        found = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        name = next(found, name)
    except OSError:
        pass  # not Linux
    return f"{name} ({processor()})"


def processor() -> str:
    """The kind of processor code is compiled for: its name, and a number for its features."""
    name = config.CPU_NAME or binding.get_host_cpu_name()
    features = config.CPU_FEATURES
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    return f"{name} {zlib.crc32(features.encode()):08x}"


@functools.cache
def vector_bytes() -> int:
    """Bytes of the widest vector register that code is compiled for: 64, 32 or 16."""
    features = config.CPU_FEATURES
    if features is None:
        # a processor named alone is taken by what it has itself
        features = "" if config.CPU_NAME else binding.get_host_cpu_features().flatten()
    name = config.CPU_NAME or binding.get_host_cpu_name()
    return widest(binding.get_process_triple(), name, features)


def widest(triple: str, name: str, features: str) -> int:
    """As `vector_bytes`, of any processor LLVM knows: the register it takes for 64 bytes."""
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    target = binding.Target.from_triple(triple)
    machine = target.create_target_machine(cpu=name, features=features)
    text = machine.emit_assembly(binding.parse_assembly(_SUM.format(triple=triple)))
    return 64 if "zmm" in text else 32 if "ymm" in text else 16


def stamp(*kind) -> pathlib.Path:
    """A file that exists where the kernels for `kind`, anything with a fixed text, are compiled."""
    seal = hashlib.sha256(f"{kind} {processor()}".encode()).hexdigest()[:16]
    return pathlib.Path(config.CACHE_DIR or cache_folder()) / f"{seal}.compiled"
