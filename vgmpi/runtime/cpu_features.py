"""Features of the processor for which code is compiled."""

import functools
import pathlib
import platform
import zlib

from llvmlite import binding
from numba import config

_SUM = """
target triple = "{triple}"
define <16 x float> @sum(<16 x float> %a, <16 x float> %b) {{
  %c = fadd <16 x float> %a, %b
  ret <16 x float> %c
}}
"""


def model() -> str:
    """Return the processor's model name and the kind for which code is compiled."""
    name = platform.machine() or "unknown"
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        names = (line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
        name = next(names, name)
    except OSError:
        pass  # not Linux
    return f"{name} ({processor()})"


def processor() -> str:
    """Return the kind of processor for compilation: its name and a checksum of its features."""
    name = config.CPU_NAME or binding.get_host_cpu_name()
    features = config.CPU_FEATURES
    if features is None:
        features = binding.get_host_cpu_features().flatten()
    return f"{name} {zlib.crc32(features.encode()):08x}"


@functools.cache
def vector_bytes() -> int:
    """Return the width [bytes] of the widest vector register in use: 64, 32 or 16."""
    features = config.CPU_FEATURES
    if features is None:
        # a processor given by name alone has the features of its kind
        features = "" if config.CPU_NAME else binding.get_host_cpu_features().flatten()
    name = config.CPU_NAME or binding.get_host_cpu_name()
    return widest(binding.get_process_triple(), name, features)


def widest(triple: str, name: str, features: str) -> int:
    """Return the width [bytes] of the register that LLVM uses for vectors of 64 bytes.

    Args:
        triple: LLVM target triple.
        name: Processor name known to LLVM.
        features: Processor features.
    """
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    target = binding.Target.from_triple(triple)
    machine = target.create_target_machine(cpu=name, features=features)
    text = machine.emit_assembly(binding.parse_assembly(_SUM.format(triple=triple)))
    return 64 if "zmm" in text else 32 if "ymm" in text else 16
