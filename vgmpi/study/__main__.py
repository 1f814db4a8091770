"""python -m vgmpi.study NAME: what a choice costs, and what it does to the result.

Each study is a file of its own with its own flags: python -m vgmpi.study NAME --help.
"""

import importlib
import sys

from ..ends import guarded

# name: the module whose main(flags) does it, and what it is
STUDIES = {
    "tradeoff": (
        "vgmpi.study.tradeoff",
        "accuracy and time of a scene, over its cells and other knobs",
    ),
    "energy": (
        "vgmpi.study.energy",
        "what is left of its motion after many steps, with each transfer",
    ),
}


@guarded
def main(argv: list[str] | None = None) -> int:
    words = sys.argv[1:] if argv is None else argv
    if not words or words[0] not in STUDIES:
        wanted = bool(words) and words[0] in ("-h", "--help")
        said = [str(__doc__), *(f"  {name:10s} {what}" for name, (_, what) in STUDIES.items())]
        print("\n".join(said), file=sys.stdout if wanted else sys.stderr)
        return 0 if wanted else 2
    return importlib.import_module(STUDIES[words[0]][0]).main(words[1:])


if __name__ == "__main__":
    sys.exit(main())
