"""Reader of a configuration file: checks it and splits it into bodies and conditions."""

import json
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

from pydantic import ValidationError

from vgmpi.runtime.config.schema import format_input, format_validation_errors
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.runtime.message_text import did_you_mean
from vgmpi.runtime.user_files import MAX_TEXT_BYTES, read_regular_file

from . import source_schema

KeyPath = tuple[str | int, ...]


class ConvertError(ValueError):
    """Error for a configuration that cannot be converted: `lines`, one sentence per error."""

    def __init__(self, lines: list[str]):
        super().__init__("\n".join(lines))
        self.lines = lines


class Body(NamedTuple):
    """Body of a configuration. law_path, stand_path: paths of its keys in the file."""

    law: source_schema.Law
    stand: source_schema.Stand
    law_path: KeyPath
    stand_path: KeyPath


class Config(NamedTuple):
    """Configuration of the other program.

    conditions: their numbers in the list, and the conditions; end: time [s] that their program
    computes.
    """

    path: Path
    run: source_schema.PhysGaussian | source_schema.VersaGauss
    bodies: list[Body]
    conditions: list[tuple[int, source_schema.Condition]]

    @property
    def is_versagauss(self) -> bool:
        """Return whether it is a configuration of VersaGauss."""
        return isinstance(self.run, source_schema.VersaGauss)

    @property
    def cell(self) -> float:
        """Return the cell size [m]."""
        return self.run.grid_lim / self.run.n_grid

    @property
    def end(self) -> float:
        """Return the simulated time [s]."""
        return int(self.run.frame_num) * self.run.frame_dt


class Report:
    """Keys that were not converted, or only in part: one line per key."""

    def __init__(self, path: Path):
        self.path = path
        self.lines: list[str] = []

    def dropped(self, key_path: KeyPath, value: Any, reason: str) -> None:
        """Report a key that is not in the scene.

        Args:
            key_path: Path of the key in the file.
            value: Its value.
            reason: Reason for the line.
        """
        self._add(key_path, value, f"not brought over: {reason}")

    def approximated(self, key_path: KeyPath, value: Any, reason: str) -> None:
        """Report a key that is in the scene, but without all of its effect.

        Args:
            key_path: Path of the key in the file.
            value: Its value.
            reason: Reason for the line.
        """
        self._add(key_path, value, f"brought over in part: {reason}")

    def note(self, message: str) -> None:
        """Report something about the whole scene."""
        self.lines.append(escape_control_characters(f"{self.path}: {message}"))

    def _add(self, key_path: KeyPath, value: Any, message: str) -> None:
        """Add the line of one key."""
        key = ".".join(str(part) for part in key_path)
        self.lines.append(
            escape_control_characters(f"{self.path}: {key}: {shortened_json(value)}: {message}")
        )


def shortened_json(value: Any) -> str:
    """Return a value as JSON, cut to the length that a line permits."""
    if isinstance(value, source_schema.Keys):
        value = value.model_dump(exclude_unset=True)
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 60 else f"{text[:57]}..."


def read_config(path: Path) -> Config:
    """Return the configuration in a file. Raises ConvertError."""
    data = _read_json(path)
    is_versagauss = any(
        key in data for key in ("object_num", "material_params", "preprocess_params")
    )
    errors: list[tuple[KeyPath, str]] = []
    table = source_schema.VersaGauss if is_versagauss else source_schema.PhysGaussian
    try:
        run = table.model_validate(data)
    except ValidationError as error:
        errors += format_validation_errors(error, table)
        run = None
    raw = data.get("boundary_conditions")
    conditions = _conditions(raw if isinstance(raw, list) else [], is_versagauss, errors)
    if run is None or errors:
        _raise_errors(path, errors)
    bodies = _bodies(run, errors)
    if errors:
        _raise_errors(path, errors)
    return Config(path, run, bodies, conditions)


def key_error(path: Path, key_path: KeyPath, message: str) -> ConvertError:
    """Return the error for one key."""
    key = ".".join(str(part) for part in key_path)
    return ConvertError([escape_control_characters(f"{path}: {key}: {message}")])


def _raise_errors(path: Path, errors: list[tuple[KeyPath, str]]) -> NoReturn:
    """Raise ConvertError with all errors."""
    lines = [f"{path}: {'.'.join(map(str, key))}: {message}" for key, message in errors]
    raise ConvertError(list(dict.fromkeys(map(escape_control_characters, lines))))


def _read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file."""
    if "\0" in str(path):
        raise ConvertError([f"{escape_control_characters(path)}: no file has such a name"])
    try:
        data = json.loads(read_regular_file(path, MAX_TEXT_BYTES).decode("utf-8-sig"))
    except OSError as error:
        raise ConvertError(
            [escape_control_characters(f"{path}: {error.strerror or error}")]
        ) from None
    except UnicodeDecodeError as error:
        raise ConvertError(
            [escape_control_characters(f"{path}: not UTF-8 text (byte {error.start})")]
        ) from None
    except RecursionError:
        raise ConvertError(
            [escape_control_characters(f"{path}: not valid JSON: nested too deeply")]
        ) from None
    except json.JSONDecodeError as error:
        message = f"{path}:{error.lineno}: not valid JSON: {error.msg} (column {error.colno})"
        raise ConvertError([escape_control_characters(message)]) from None
    except ValueError:  # more digits than Python turns into an integer
        message = f"{path}: not valid JSON: an integer must fit in 64 bits"
        raise ConvertError([escape_control_characters(message)]) from None
    if not isinstance(data, dict):
        raise ConvertError(
            [
                escape_control_characters(
                    f"{path}: must be an object of keys, {{...}}; {format_input(data)}"
                )
            ]
        )
    return data


def _conditions(
    raw: list[Any], is_versagauss: bool, errors: list[tuple[KeyPath, str]]
) -> list[tuple[int, source_schema.Condition]]:
    """Return the valid conditions with their numbers. VersaGauss has one kind more."""
    classes: dict[str, type[source_schema.Condition]] = dict(source_schema.CONDITIONS)
    if is_versagauss:
        classes["add_plane"] = source_schema.Plane
    conditions = []
    for k, item in enumerate(raw):
        key_path: KeyPath = ("boundary_conditions", k)
        if not isinstance(item, dict):
            errors.append((key_path, f"must be an object of keys; {format_input(item)}"))
            continue
        kind = item.get("type")
        table = classes.get(kind) if isinstance(kind, str) else None
        if table is None:
            allowed = f"must be one of {', '.join(classes)}{did_you_mean(kind, classes)}"
            errors.append(((*key_path, "type"), f"{allowed}; {format_input(kind)}"))
            continue
        try:
            conditions.append((k, table.model_validate(item)))
        except ValidationError as error:
            errors += [
                ((*key_path, *inner), message)
                for inner, message in format_validation_errors(error, table)
            ]
    return conditions


def _bodies(
    run: source_schema.PhysGaussian | source_schema.VersaGauss, errors: list[tuple[KeyPath, str]]
) -> list[Body]:
    """Return the bodies of a configuration."""
    if isinstance(run, source_schema.PhysGaussian):
        bodies = [Body(run, run, (), ())]
    else:
        count = run.object_num
        for key in ("material_params", "preprocess_params"):
            if len(getattr(run, key)) < count:
                message = f"must have an item for each of object_num = {count} bodies"
                errors.append(((key,), f"{message}; got {len(getattr(run, key))}"))
        if errors:
            return []
        path_pairs = ((("material_params", k), ("preprocess_params", k)) for k in range(count))
        bodies = [
            Body(run.material_params[k], run.preprocess_params[k], *paths)
            for k, paths in enumerate(path_pairs)
        ]
    for body in bodies:
        counts = len(body.stand.rotation_degree), len(body.stand.rotation_axis)
        if counts[0] != counts[1]:
            message = f"must have an axis for each of the {counts[0]} angles of rotation_degree"
            errors.append(((*body.stand_path, "rotation_axis"), f"{message}; got {counts[1]}"))
    return bodies
