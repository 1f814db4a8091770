"""python -m postprocess.study NAME: a study of the paper, as a table and a picture.

Each study is a file of its own with its own flags: python -m postprocess.study NAME --help.
"""

import importlib
import sys

from vgmpi.ends import guarded

# name: the module whose main(flags) does it, and what it is
STUDIES = {
    "pruning": ("postprocess.table_one", "speed and likeness with and without pruning (Table I)"),
    "statements": (
        "postprocess.statements",
        "what the paper says of its scenes, in the gallery's runs",
    ),
    "ablation": ("postprocess.ablation", "a splash drawn without one part of the method at a time"),
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
