"""Vectors that do not fit the registers: how often the sums over rows (kernels/stencil_sums.py) put
one to the stack and take it back, as LLVM compiles them for other processors too. Nothing is run.
"""

import re
from typing import Any

from llvmlite import binding
from numba import cfunc, types

from vgmpi.kernels import stencil_sums
from vgmpi.runtime.cpu_features import widest

PROCESSORS = {  # what it stands for: LLVM's triple, name and features
    "AVX2": ("x86_64-unknown-linux-gnu", "haswell", "+avx2,+fma,+bmi,+bmi2"),
    "AVX-512": ("x86_64-unknown-linux-gnu", "skylake-avx512", ""),
    "ARM NEON": ("aarch64-unknown-linux-gnu", "neoverse-n1", ""),
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


def measure() -> list[dict[str, Any]]:
    """A row per processor, precision and function: puts and takes with whole rows, and with rows in
    the parts that this processor gets; None where LLVM was built without it."""
    rows = []
    for precision, real in REALS.items():
        for name, (put, some) in stencil_sums.STENCIL_FUNCTIONS.items():
            texts = {w: compiled(put(some, p), real) for w, p in stencil_sums.ROW_SPLITS.items()}
            for processor, target in PROCESSORS.items():
                row: dict[str, Any] = {
                    "processor": processor,
                    "precision": precision,
                    "function": name,
                }
                try:
                    row["way"] = stencil_sums.row_split_for(name, widest(*target), real.bitwidth)
                    row["whole"] = count(assembly(texts[4], *target))
                    row["parts"] = count(assembly(texts[row["way"]], *target))
                except RuntimeError:
                    row["whole"] = row["parts"] = None
                rows.append(row)
    return rows


def text(rows: list[dict[str, Any]]) -> str:
    """The table, for people."""
    lines = ["vectors put to the stack + taken back, per function; nodes of a row at a time in ()"]
    for row in sorted(rows, key=lambda row: (row["processor"], row["precision"] == "double")):
        place = f"{row['processor']:9} {row['precision']:7} {row['function']:15}"
        if row["whole"] is None:
            lines.append(f"{place} this LLVM was built without it")
            continue
        (a, b), (c, d) = row["whole"], row["parts"]
        lines.append(f"{place} whole rows {a:4} + {b:<4} as compiled {c:4} + {d:<4} ({row['way']})")
    return "\n".join(lines)
