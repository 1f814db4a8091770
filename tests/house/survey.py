"""Sizes and places that the ratchets judge, from one pass over the Python files."""

import functools
from collections import defaultdict
from collections.abc import Callable, Iterable
from typing import NamedTuple

from tests.house import ghosts, imports, sizes, words
from tests.house.source_file import PROGRAM, SourceFile, list_files, name_module

SHORT = 100  # lines below which a module counts as short
MANY_ARGUMENTS = 8
FINDERS: dict[str, Callable[[SourceFile], Iterable[str]]] = {
    "private names": words.find_names,
    "private fields": words.find_fields,
    "private attributes": words.find_attributes,
    "aliases": words.find_aliases,
    "step results by position": words.find_positions,
}


class Survey(NamedTuple):
    """What was measured."""

    sizes: dict[str, dict[str, int]]  # by limit and name
    places: dict[str, list[str]]  # by the name of a count


def survey_files(files: Iterable[SourceFile]) -> Survey:
    """Measure files, of which none is kept: syntax trees are large.

    Args:
        files: Files of the program, then others.
    """
    found: dict = defaultdict(dict)
    places: dict = defaultdict(list)
    known, prose, links, deferred = ghosts.Definitions(), [], {}, {}
    modules = frozenset(name_module(path) for path in list_files(*PROGRAM))
    for file in files:
        for limit, name, size in sizes.measure_sizes(file):
            found[limit][name] = max(size, found[limit].get(name, 0))
        if file.path.startswith("tests/"):
            known.add_path(file.path)
            places["private attributes of tests"] += words.find_attributes(file)
        if not file.is_of_program:
            continue
        for name, find in FINDERS.items():
            places[name] += find(file)
        links[file.module] = imports.list_imports(file, modules.__contains__) & modules
        deferred[file.module] = imports.list_deferred_imports(file, modules.__contains__)
        found["imports"][file.path] = len(links[file.module])
        prose.append((file.path, list(ghosts.read_prose(file)), known.add(file)))
    places["modules of one importer"] = imports.find_single_importers(links, deferred)
    places["modules below 100 lines"] = [
        path
        for path, lines in found["lines of a file"].items()
        if 0 < lines < SHORT and path.startswith(PROGRAM)
    ]
    places["more than 8 arguments"] = [
        name for name, count in found["arguments"].items() if count > MANY_ARGUMENTS
    ]
    known.words |= ghosts.list_outside_words()
    places["ghosts"] = [ghost for row in prose for ghost in ghosts.find_ghosts(*row, known)]
    return Survey(found, places)


@functools.cache
def survey_program() -> Survey:
    """Return the survey of this repository."""
    return survey_files(map(SourceFile, list_files(*PROGRAM, "tests", "runs")))
