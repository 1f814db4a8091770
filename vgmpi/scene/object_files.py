"""Files of the objects of a scene: where they must lie, and what can make a missing one."""

import os
import re
import shlex
from pathlib import Path

from vgmpi.runtime.config.schema import format_input
from vgmpi.runtime.config.toml_source import TomlSource
from vgmpi.runtime.message_text import did_you_mean_file

from .objects import Object
from .point_sets import POINT_SUFFIXES

# The flags of the make_assets.py command that a comment in a scene may hold.
FLAGS = re.compile(r"# +python \S*make_assets\.py(?: [^\s-]\S*)?((?: --\w+(?: [\w.]+)+)+)")


def find_object_file(
    source: TomlSource, k: int, obj: Object, outside: bool
) -> tuple[Path | None, tuple, str]:
    """Find the file of an object.

    Args:
        source: Source of the scene.
        k: Row of the object.
        obj: The object.
        outside: Whether files may lie outside the scene's folder.

    Returns:
        The file or None, the path of its key, and what is wrong with it, "" if nothing is.
    """
    names = {"gaussians": obj.gaussians, "mesh": obj.mesh, "points": obj.points and obj.points.file}
    key = next((key for key, name in names.items() if name), None)
    if key is None:
        return None, (), ""
    path, name = ("object", k, key), names[key] or ""
    if key == "points" and not name.lower().endswith(POINT_SUFFIXES):
        return None, path, f"must end in .ply, .npz or .vtp; {format_input(name)}"
    folder = source.folder
    overridden = source.overridden(path)  # the command line may name any file
    candidates = [Path(name), folder / name] if overridden else [folder / name]
    file = next((c for c in candidates if os.path.isfile(c)), None)
    if file is None and "\0" in name:
        return None, path, f"no file has such a name; {format_input(name)}"
    if file is None:
        missing = candidates[-1]
        hint = _script_hint(source, missing) or did_you_mean_file(missing)
        return None, path, f"there is no file {missing}{hint}"
    if not (overridden or outside) and not file.resolve().is_relative_to(folder.resolve()):
        return None, path, (
            f"{name!r} lies outside the scene's folder: move it below, or set"
            " allow_outside = true at the top of the scene"
        )  # fmt: skip
    return file.resolve(), path, ""


def _script_hint(source: TomlSource, missing: Path) -> str:
    """Return "; python .../make_assets.py ... makes it" if a script there can make a file."""
    for folder in missing.parents:
        script = folder / "assets" / "make_assets.py"
        if os.path.isfile(script) and f'"{missing.stem}": ' in script.read_text(errors="replace"):
            flags = FLAGS.search(source.text)
            words = map(shlex.quote, (relative_to_cwd(script), relative_to_cwd(missing.parent)))
            return f"; python {' '.join(words)}{flags[1] if flags else ''} makes it"
    return ""


def relative_to_cwd(path: Path) -> str:
    """Return the path relative to the current folder if it is inside, else the absolute path."""
    path, cwd = path.resolve(), Path.cwd()
    return str(path.relative_to(cwd) if path.is_relative_to(cwd) else path)
