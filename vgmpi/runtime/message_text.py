"""Texts of messages: suggestions for a misspelled word or file name, and durations."""

import difflib
import itertools
import os
from collections.abc import Iterable
from pathlib import Path


def did_you_mean(word: object, valid: Iterable[str]) -> str:
    """Return " (did you mean 'x'?)" for the valid word closest to `word`, else "" if none is."""
    by_lower_case = {str(item).lower(): item for item in valid}
    close = difflib.get_close_matches(str(word).lower(), list(by_lower_case), 1)
    return f" (did you mean '{by_lower_case[close[0]]}'?)" if close else ""


def did_you_mean_file(missing: Path) -> str:
    """Return a suggestion for a missing file: an entry of its folder, or of a parent that exists.

    Only names of files and folders are read, up to 10,000.
    """
    for above in missing.parents:
        try:
            with os.scandir(above) as entries:
                names = [entry.name for entry in itertools.islice(entries, 10_000)]
        except OSError:
            continue  # this folder is misspelled too, or not readable
        return did_you_mean(missing.relative_to(above).parts[0], names)
    return ""


def format_duration(seconds: float) -> str:
    """Format a duration [s] for display."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 600:
        return f"{seconds / 60:.1f} min"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
