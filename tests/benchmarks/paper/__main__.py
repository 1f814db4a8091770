"""Studies of the paper, each a table and a picture: python -m tests.benchmarks.paper NAME

Each study is a module with its own flags: python -m tests.benchmarks.paper NAME --help.
"""

import importlib
import sys

from vgmpi.runtime.command_line import exit_code_from_exceptions

# name: (module with main(flags), description)
STUDIES = {
    "pruning": (
        "tests.benchmarks.paper.table1_pruning",
        "speed and likeness with and without pruning (Table I)",
    ),
    "statements": (
        "tests.benchmarks.paper.paper_claims",
        "what the paper says of its scenes, in the gallery's runs",
    ),
    "ablation": (
        "tests.benchmarks.paper.ablation",
        "a splash drawn without one part of the method at a time",
    ),
}


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    if not words or words[0] not in STUDIES:
        is_help = bool(words) and words[0] in ("-h", "--help")
        lines = [
            str(__doc__),
            *(f"  {name:10s} {description}" for name, (_, description) in STUDIES.items()),
        ]
        print("\n".join(lines), file=sys.stdout if is_help else sys.stderr)
        return 0 if is_help else 2
    return importlib.import_module(STUDIES[words[0]][0]).main(words[1:])


if __name__ == "__main__":
    sys.exit(main())
