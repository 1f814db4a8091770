"""What may be meant by a word or a file that is not there."""

import difflib
import itertools
import os
from collections.abc import Iterable
from pathlib import Path


def nearest(word: object, known: Iterable[str]) -> str:
    """ " (did you mean 'x'?)" where a known word is close to this one, else nothing."""
    of = {str(one).lower(): one for one in known}
    near = difflib.get_close_matches(str(word).lower(), list(of), 1)
    return f" (did you mean '{of[near[0]]}'?)" if near else ""


def nearest_file(missing: Path) -> str:
    """As `nearest`, for a file that is not there: what lies in its folder, or folders beside one of
    its own that is not there either. Names of files and folders alone are read, up to 10,000."""
    for above in missing.parents:
        try:
            with os.scandir(above) as there:
                names = [entry.name for entry in itertools.islice(there, 10_000)]
        except OSError:
            continue  # this folder is misspelt too, or nobody may look into it
        return nearest(missing.relative_to(above).parts[0], names)
    return ""
