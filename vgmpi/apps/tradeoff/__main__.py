"""Command `python -m vgmpi tradeoff NAME`: cost of a choice and its effect on the result.

Each study is a file of its own with its own flags: python -m vgmpi tradeoff NAME --help.
"""

import importlib
import sys

from vgmpi.runtime.exit_handler import exit_code_from_exceptions

# name: the module whose main(flags) runs the study, and its description
STUDIES = {
    "tradeoff": (
        "vgmpi.apps.tradeoff.setting_study",
        "accuracy and time of a scene, over its cells and other knobs",
    ),
    "energy": (
        "vgmpi.apps.tradeoff.energy_drift",
        "what is left of its motion after many steps, with each transfer",
    ),
}


@exit_code_from_exceptions
def main(argv: list[str] | None = None) -> int:
    """Run the study that the first word names, and return its exit code."""
    words = sys.argv[1:] if argv is None else argv
    if not words or words[0] not in STUDIES:
        wanted = bool(words) and words[0] in ("-h", "--help")
        lines = [
            str(__doc__),
            *(f"  {name:10s} {description}" for name, (_, description) in STUDIES.items()),
        ]
        print("\n".join(lines), file=sys.stdout if wanted else sys.stderr)
        return 0 if wanted else 2
    return importlib.import_module(STUDIES[words[0]][0]).main(words[1:])


if __name__ == "__main__":
    sys.exit(main())
