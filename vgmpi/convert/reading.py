"""A configuration file read, checked, and taken apart into bodies and conditions."""

import json
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from pydantic import ValidationError

from vgmpi.convert import keys
from vgmpi.inputs import MOST_TEXT, content
from vgmpi.misspelt import nearest
from vgmpi.source import printable
from vgmpi.tables import explain, got

Where = tuple[str | int, ...]


class ConvertError(ValueError):
    """Why a configuration cannot be brought over: `lines`, one finished sentence per error."""

    def __init__(self, lines: list[str]):
        super().__init__("\n".join(lines))
        self.lines = lines


class Body(NamedTuple):
    """One body of a configuration. law_at, stand_at: where its keys stand in the file."""

    law: keys.Law
    stand: keys.Stand
    law_at: Where
    stand_at: Where


class Config(NamedTuple):
    """A configuration. conditions: their places in the list, and what they say; end: how long
    their program computes [s]."""

    path: Path
    run: keys.PhysGaussian | keys.VersaGauss
    bodies: list[Body]
    conditions: list[tuple[int, keys.Condition]]

    @property
    def several(self) -> bool:
        """Whether it is VersaGauss's."""
        return isinstance(self.run, keys.VersaGauss)

    @property
    def cell(self) -> float:
        return self.run.grid_lim / self.run.n_grid

    @property
    def end(self) -> float:
        return int(self.run.frame_num) * self.run.frame_dt


class Report:
    """What was not brought over, or in part: one line per key."""

    def __init__(self, path: Path):
        self.path = path
        self.lines: list[str] = []

    def lost(self, at: Where, value: Any, why: str) -> None:
        """This key is not in the scene."""
        self._add(at, value, f"not brought over: {why}")

    def partly(self, at: Where, value: Any, why: str) -> None:
        """This key is in the scene, but does not do all that it does there."""
        self._add(at, value, f"brought over in part: {why}")

    def note(self, said: str) -> None:
        """Something about the whole scene."""
        self.lines.append(printable(f"{self.path}: {said}"))

    def _add(self, at: Where, value: Any, said: str) -> None:
        key = ".".join(str(part) for part in at)
        self.lines.append(printable(f"{self.path}: {key}: {shown(value)}: {said}"))


def shown(value: Any) -> str:
    """A value as JSON has it, as much as a line bears."""
    if isinstance(value, keys.Keys):
        value = value.model_dump(exclude_unset=True)
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def read(path: Path) -> Config:
    """The configuration in a file. Raises ConvertError."""
    data = _data(path)
    several = any(key in data for key in ("object_num", "material_params", "preprocess_params"))
    errors: list[tuple[Where, str]] = []
    table = keys.VersaGauss if several else keys.PhysGaussian
    try:
        run = table.model_validate(data)
    except ValidationError as error:
        errors += explain(error, table)
        run = None
    raw = data.get("boundary_conditions")
    conditions = _conditions(raw if isinstance(raw, list) else [], several, errors)
    if run is None or errors:
        _refuse(path, errors)
    bodies = _bodies(run, errors)
    if errors:
        _refuse(path, errors)
    return Config(path, run, bodies, conditions)


def refused(path: Path, at: Where, said: str) -> ConvertError:
    """The error for one key."""
    key = ".".join(str(part) for part in at)
    return ConvertError([printable(f"{path}: {key}: {said}")])


def _refuse(path: Path, errors: list[tuple[Where, str]]) -> NoReturn:
    raise ConvertError([line for at, said in errors for line in refused(path, at, said).lines])


def _data(path: Path) -> dict[str, Any]:
    """The JSON object in a file."""
    if "\0" in str(path):
        raise ConvertError([f"{printable(path)}: no file has such a name"])
    try:
        data = json.loads(content(path, MOST_TEXT).decode("utf-8-sig"))
    except OSError as error:
        raise ConvertError([printable(f"{path}: {error.strerror or error}")]) from None
    except UnicodeDecodeError as error:
        raise ConvertError([printable(f"{path}: not UTF-8 text (byte {error.start})")]) from None
    except RecursionError:
        raise ConvertError([printable(f"{path}: not valid JSON: nested too deeply")]) from None
    except json.JSONDecodeError as error:
        said = f"{path}:{error.lineno}: not valid JSON: {error.msg} (column {error.colno})"
        raise ConvertError([printable(said)]) from None
    except ValueError:  # more digits than Python turns into an integer
        said = f"{path}: not valid JSON: an integer must fit in 64 bits"
        raise ConvertError([printable(said)]) from None
    if not isinstance(data, dict):
        raise ConvertError([printable(f"{path}: must be an object of keys, {{...}}; {got(data)}")])
    return data


def _conditions(
    raw: list[Any], several: bool, errors: list[tuple[Where, str]]
) -> list[tuple[int, keys.Condition]]:
    """Those without errors. VersaGauss has one kind more."""
    known: dict[str, type[keys.Condition]] = dict(keys.CONDITIONS)
    if several:
        known["add_plane"] = keys.Plane
    found = []
    for k, item in enumerate(raw):
        at: Where = ("boundary_conditions", k)
        if not isinstance(item, dict):
            errors.append((at, f"must be an object of keys; {got(item)}"))
            continue
        kind = item.get("type")
        table = known.get(kind) if isinstance(kind, str) else None
        if table is None:
            allowed = f"must be one of {', '.join(known)}{nearest(kind, known)}; {got(kind)}"
            errors.append(((*at, "type"), allowed))
            continue
        try:
            found.append((k, table.model_validate(item)))
        except ValidationError as error:
            errors += [((*at, *inner), said) for inner, said in explain(error, table)]
    return found


def _bodies(
    run: keys.PhysGaussian | keys.VersaGauss, errors: list[tuple[Where, str]]
) -> list[Body]:
    """The bodies that their program makes."""
    if isinstance(run, keys.PhysGaussian):
        bodies = [Body(run, run, (), ())]
    else:
        count = run.object_num
        for key in ("material_params", "preprocess_params"):
            if len(getattr(run, key)) < count:
                said = f"must have an item for each of object_num = {count} bodies"
                errors.append(((key,), f"{said}; got {len(getattr(run, key))}"))
        if errors:
            return []
        places = ((("material_params", k), ("preprocess_params", k)) for k in range(count))
        bodies = [
            Body(run.material_params[k], run.preprocess_params[k], *at)
            for k, at in enumerate(places)
        ]
    for body in bodies:
        turns = len(body.stand.rotation_degree), len(body.stand.rotation_axis)
        if turns[0] != turns[1]:
            said = f"must have an axis for each of the {turns[0]} angles of rotation_degree"
            errors.append(((*body.stand_at, "rotation_axis"), f"{said}; got {turns[1]}"))
    return bodies
