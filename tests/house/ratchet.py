"""Comparison of a survey with the numbers of ratchets.toml: worse is an error, better a note."""

import tomllib
from collections.abc import Iterator
from typing import NamedTuple

from tests.house.source_file import ROOT
from tests.house.survey import Survey

FILE = "tests/house/ratchets.toml"
SLACK = 0.9  # a count below this fraction of its number must be written there


class Verdict(NamedTuple):
    """Result of a comparison."""

    errors: list[str]
    notes: list[str]  # what may be written into ratchets.toml, and soft limits


def read_ratchets() -> dict:
    """Return the numbers of ratchets.toml."""
    return tomllib.loads((ROOT / FILE).read_text())


def judge_limit(name: str, survey: Survey, ratchets: dict) -> Verdict:
    """Compare sizes with their limits and exceptions.

    Args:
        name: Name of the limit.
        survey: What was measured.
        ratchets: Content of ratchets.toml.
    """
    limits, allowed = ratchets["limits"][name], ratchets.get("exceptions", {}).get(name, {})
    verdict = Verdict([], [])
    for place, size in survey.sizes[name].items():
        if size > allowed.get(place, limits["hard"]):
            most = allowed.get(place, limits["hard"])
            verdict.errors.append(f"{place}: {size} {name}, at most {most} are allowed")
        elif place in allowed and limits["hard"] < size < allowed[place]:
            verdict.notes.append(f'{FILE}: lower {name}, "{place}" to {size}')
        elif place not in allowed and size > limits.get("soft", size):
            verdict.notes.append(f"{place}: {size} {name}, better are {limits['soft']}")
    for place in allowed:
        if survey.sizes[name].get(place, 0) <= limits["hard"]:
            verdict.errors.append(f'{FILE}: remove the exception {name}, "{place}"')
    return verdict


def judge_count(name: str, survey: Survey, ratchets: dict) -> Verdict:
    """Compare a number of places with its bound.

    Args:
        name: Name of the count.
        survey: What was measured.
        ratchets: Content of ratchets.toml.
    """
    places, bound = survey.places[name], ratchets["counts"][name]
    if len(places) > bound:
        hint = f'{name}: {len(places)}, at most {bound}: python -m tests.house "{name}"'
        return Verdict([hint, *(places if bound == 0 else [])], [])
    note = [f'{FILE}: lower "{name}" to {len(places)}'] if len(places) < bound else []
    return Verdict(note, []) if len(places) < SLACK * bound else Verdict([], note)


def table_lines(survey: Survey, ratchets: dict) -> Iterator[str]:
    """Yield the lines of a table: today's number and the bound of each ratchet."""
    for name, limits in ratchets["limits"].items():
        allowed = ratchets.get("exceptions", {}).get(name, {})
        bounds = ", ".join(f"{kind} {value}" for kind, value in limits.items())
        yield f"{max(survey.sizes[name].values()):5d}  {name} ({bounds}; {len(allowed)} exceptions)"
    for name, bound in ratchets["counts"].items():
        yield f"{len(survey.places[name]):5d}  {name} (at most {bound})"
