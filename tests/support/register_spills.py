"""Vectors that do not fit the registers: how often the sums over rows (kernels/stencil_sums.py) put
one to the stack and take it back, as LLVM compiles them for other processors too. Nothing is run.
"""

import re

from llvmlite import binding
from numba import cfunc, types

PROCESSORS = {  # what it stands for: LLVM's triple, name and features
    "AVX2": ("x86_64-unknown-linux-gnu", "haswell", "+avx2,+fma,+bmi,+bmi2"),
}
REALS: dict[str, types.Float] = {"single": types.float32, "double": types.float64}
# LLVM says of a store to the stack, or of an operand taken from it, that a register was short
_SHORT = re.compile(r"[#/] \d+-byte (?:Folded )?(Spill|Reload)")
_VECTOR = re.compile(r"%[xyz]mm\d|\bq\d")


def count(text: str) -> tuple[int, int]:
    """(vectors put to the stack, taken back) in LLVM's assembly with its remarks."""
    spills = {"Spill": 0, "Reload": 0}
    for line in text.splitlines():
        short = _SHORT.search(line)
        if short and _VECTOR.search(line):
            spills[short[1]] += 1
    return spills["Spill"], spills["Reload"]


def compiled(function, real: types.Float) -> str:
    """LLVM's text of a function of (count, records, weights, base, patch)."""
    row, base = types.CPointer(real), types.CPointer(types.int32)

    # pointers: arrays are counted, by instructions that other processors lack
    @cfunc(types.void(types.int64, row, row, base, row), error_model="numpy")
    def rows(count, records, weights, base, patch):
        """Call the function with pointers."""
        function(count, records, weights, base, patch)

    return rows.inspect_llvm()


def assembly(text: str, triple: str, name: str, features: str) -> str:
    """Return a function's assembly for another processor.

    Args:
        text: LLVM text of the function.
        triple: LLVM's triple.
        name: LLVM's name of the processor.
        features: LLVM's features.

    Raises:
        RuntimeError: LLVM lacks this processor.
    """
    binding.initialize_all_targets()
    binding.initialize_all_asmprinters()
    target = binding.Target.from_triple(triple)
    machine = target.create_target_machine(cpu=name, features=features, opt=3)
    machine.set_asm_verbosity(True)
    module = binding.parse_assembly(text)
    module.triple, module.data_layout = triple, str(machine.target_data)
    return machine.emit_assembly(module)
