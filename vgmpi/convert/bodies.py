"""The [[object]] and [material.*] tables of one body: its stuff, its filling, its parts."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.convert import keys, laws
from vgmpi.convert.reading import Config, Report
from vgmpi.convert.standing import Standing, around
from vgmpi.scene.objects import PER_CELL

Table = dict[str, Any]


class Piece(NamedTuple):
    """A part of a body between two planes: its corners (3,) in their box; what is other there."""

    low: np.ndarray
    high: np.ndarray
    other: keys.Part | None


class Made(NamedTuple):
    """Tables of a body in our domain's coordinates. names: of its objects."""

    materials: dict[str, Table]
    objects: list[Table]
    names: list[str]


def make(
    config: Config, k: int, standing: Standing, ends: np.ndarray, more: Table, law: Table | None,
    folder: Path, report: Report,
) -> Made:  # fmt: skip
    """The tables of body k. ends: (2, 3) of the domain in their box; more: what else its objects
    have; law: its material, None where it is held; folder: of the scene."""
    body = config.bodies[k]
    inner = np.array([np.maximum(standing.low, ends[0]), np.minimum(standing.high, ends[1])])
    model = getattr(body.stand, "model_path", standing.name)
    if law is not None and not (inner[0] < inner[1]).all():
        at = (*body.stand_at, "center_point")
        report.lost(at, model, "all of it lies beyond the walls, where nothing is here")
        return Made({}, [], [])
    beyond = bool((inner != np.array([standing.low, standing.high])).any()) and law is not None
    if beyond and standing.x is not None:
        if standing.straight:
            said = f"what of '{standing.name}' lies beyond the walls is drawn, and takes no part"
            if body.stand.particle_filling is not None:
                said += "; it is cut before it is filled"
            report.note(said)
        else:
            report.note(f"'{standing.name}' reaches out of the domain, and is refused for it")
    common = look(config, k, standing, law, report) | _moved(more, ends[0])
    pieces = _pieces(config, k, standing, bool(more), report)
    out = Made({}, [], [])
    for i, piece in enumerate(pieces):
        low, high = piece.low, piece.high
        if law is not None:
            low, high = np.maximum(low, inner[0]), np.minimum(high, inner[1])
        if not (low < high).all():
            continue
        name = standing.name if len(pieces) == 1 else f"{standing.name} part {i + 1}"
        table: Table = {"name": name}
        if law is None:
            table |= {"role": "scenery", "collider": True}
        else:
            table["material"] = name
            out.materials[name] = law | _other(law, piece.other)
        if standing.file is None:
            table["shape"] = {"box": [(low - ends[0]).tolist(), (high - ends[0]).tolist()]}
        else:
            cut = beyond or len(pieces) > 1
            box = _wide(piece, inner, standing) if cut else None
            table |= _file(config, k, standing, box, ends[0], folder, law is not None)
        if len(pieces) > 1:
            table["phase"] = standing.name
        out.objects.append(table | common)
        out.names.append(name)
    drawn = _drawn(standing, inner if beyond else None)
    for i, box in enumerate(drawn):
        table = {"name": f"{standing.name} beyond {i + 1}", "role": "scenery"}
        select = {"min_opacity": body.stand.opacity_threshold, "box": box.tolist()}
        table |= {**_placed(config, k, standing, ends[0], folder), "select": select}
        out.objects.append(table)
    return out


def _drawn(standing: Standing, inner: np.ndarray | None) -> list[np.ndarray]:
    """Boxes in the file's axes with Gaussians that are only drawn: beyond sim_area, and beyond the
    walls; inner: what lies between these, in their box."""
    if standing.file is None or not standing.straight:
        return []
    slack = np.ptp(standing.own, axis=0).max()
    all_of_it = np.array([standing.own.min(axis=0) - slack, standing.own.max(axis=0) + slack])
    found = [] if standing.area is None else around(standing.area, all_of_it)
    if inner is not None:
        wide = _wide(Piece(inner[0], inner[1], None), inner, standing)
        part = all_of_it if standing.box is None else standing.box
        found += around(standing.in_file(wide), part)
    own = standing.own
    return [box for box in found if ((own >= box[0]) & (own <= box[1])).all(axis=1).any()]


def _wide(piece: Piece, inner: np.ndarray, standing: Standing) -> np.ndarray:
    """The box (2, 3) that a piece is cut from, in their box: beyond the body where nothing cuts."""
    low, high = np.maximum(piece.low, inner[0]), np.minimum(piece.high, inner[1])
    slack = (standing.high - standing.low).max()
    return np.array([
        np.where(low <= standing.low, standing.low - slack, low),
        np.where(high >= standing.high, standing.high + slack, high),
    ])  # fmt: skip


def _other(law: Table, part: keys.Part | None) -> Table:
    """What additional_material_params changes in a material."""
    if part is None:
        return {}
    density = law["density"] if part.density is None else part.density
    return {"youngs_modulus": part.E, "poisson_ratio": part.nu, "density": density}


def _moved(more: Table, origin: np.ndarray) -> Table:
    """The keys for motions with places in the domain's coordinates."""
    if "about" not in more.get("motion", {}):
        return more
    about = (np.asarray(more["motion"]["about"]) - origin).tolist()
    return more | {"motion": more["motion"] | {"about": about}}


def _file(
    config: Config, k: int, standing: Standing, box: np.ndarray | None, origin: np.ndarray,
    folder: Path, has_mass: bool,
) -> Table:  # fmt: skip
    """The keys for a Gaussian file and how it is placed. box: of what is taken, in their box."""
    stand = config.bodies[k].stand
    assert standing.file is not None
    part = standing.box
    if box is not None and standing.straight:
        low, high = standing.in_file(box)
        if part is not None:
            low, high = np.maximum(low, part[0]), np.minimum(high, part[1])
        part = np.array([low, high])
    select: Table = {"min_opacity": stand.opacity_threshold}
    if part is not None:
        select["box"] = part.tolist()
    out = {**_placed(config, k, standing, origin, folder), "select": select}
    if has_mass or stand.particle_filling is not None:
        filling = stand.particle_filling
        out["fill"] = False if filling is None else "shown" if filling.visualize else True
        count = _per_cell(config, filling) if filling is not None else 8.0
        if count in PER_CELL and count != 8:
            out["particles_per_cell"] = int(count)
    return out


def _placed(config: Config, k: int, standing: Standing, origin: np.ndarray, folder: Path) -> Table:
    """The keys that bring all of a file to its place."""
    assert standing.file is not None
    stand = config.bodies[k].stand
    file = os.path.relpath(standing.file.resolve(), folder.resolve())
    out: Table = {"gaussians": file, "scale": standing.scale}
    turns = zip(stand.rotation_degree, stand.rotation_axis, strict=True)
    rotation = [
        {"axis": "xyz"[axis], "angle": f"{angle:.12g} deg"} for angle, axis in turns if angle
    ]
    if rotation:
        out["rotation"] = rotation
    return out | {"origin": (standing.origin - origin).tolist()}


def look(config: Config, k: int, standing: Standing, law: Table | None, report: Report) -> Table:
    """What a body looks like, and what of its filling is not here."""
    body = config.bodies[k]
    out: Table = {}
    stand, at = body.stand, body.stand_at
    if stand.particle_filling is not None:
        _tell_of_filling(config, k, standing, report)
    if not isinstance(stand, keys.VersaGaussStand):
        return out
    fluid = law is not None and law["kind"] == "fluid"
    if stand.given("opacity_scale"):
        if fluid:
            out["opacity_scale"] = stand.opacity_scale
        elif stand.opacity_scale != 1:
            report.lost(
                (*at, "opacity_scale"), stand.opacity_scale, "VersaGauss fades fluids alone"
            )
    if stand.color is not None:
        if standing.file is None and fluid:
            out["colour"] = [c / 255 for c in stand.color]
        else:
            why = "a capture keeps its colours" if fluid else "VersaGauss colours fluids alone"
            report.lost((*at, "color"), list(stand.color), why)
    if stand.camera_path is not None:
        report.lost((*at, "camera_path"), stand.camera_path, "the camera is set in render.toml")
    if stand.scale < 0.5 and standing.file is not None and not fluid:
        why = "theirs also thins out its Gaussians; `prune` does here"
        report.partly((*at, "scale"), stand.scale, why)
    kind = getattr(body.law, "type", None)
    if kind == "floor" or (kind == "table" and stand.scale >= 5):
        why = "theirs stretches it along x and y alone; here all axes have `scale`"
        report.partly((*body.law_at, "type"), kind, why)
    elif kind is not None and kind != "table":
        report.lost((*body.law_at, "type"), kind, "VersaGauss knows 'floor' and 'table' alone")
    return out


def _per_cell(config: Config, filling: keys.Filling) -> float:
    """Particles that theirs fills a cell of the solver with, rounded where it is a whole number."""
    spread = config.run.grid_lim
    if filling.boundary is not None:
        spread = max(np.diff(np.reshape(filling.boundary, (3, 2)), axis=1)[:, 0])
    count = filling.n_grid or 4 * config.run.n_grid
    per_cell = filling.max_partciels_per_cell * (config.cell * count / spread) ** 3
    return round(per_cell) if abs(per_cell - round(per_cell)) < 1e-6 * per_cell else per_cell


def _tell_of_filling(config: Config, k: int, standing: Standing, report: Report) -> None:
    """Name the keys of particle_filling that are not here."""
    body = config.bodies[k]
    filling, at = body.stand.particle_filling, (*body.stand_at, "particle_filling")
    assert filling is not None
    if standing.file is None:
        report.lost(at, filling, "there is no Gaussian file to fill (--gaussians)")
        return
    count = _per_cell(config, filling)
    same = count in PER_CELL
    for key in filling.model_fields_set & set(keys.Filling.model_fields):
        value = getattr(filling, key)
        why = "what is inside is found by voxels here (docs/preparation.md)"
        if key == "visualize" or (key in ("n_grid", "max_partciels_per_cell") and same):
            continue
        if key == "boundary":
            if value is None:
                continue
            low, high = np.reshape(value, (3, 2)).T
            if (low <= standing.low).all() and (high >= standing.high).all():
                continue
            why = "it does not hold all of the body, which is filled as a whole here"
        elif key in ("n_grid", "max_partciels_per_cell"):
            why = f"theirs makes {count:.3g} in a cell; here 8, or 1, 27, 64 (particles_per_cell)"
        elif key == "max_particles_num":
            why = "all that are needed are made here"
        elif key == "surface":
            why = "the Gaussians of a fluid's surface stay here"
            if value is False or not config.several:
                continue
        report.lost((*at, key), value, why)


def _pieces(
    config: Config, k: int, standing: Standing, driven: bool, report: Report
) -> list[Piece]:
    """A body cut along one axis where additional_material_params changes its material."""
    body, whole = config.bodies[k], Piece(standing.low, standing.high, None)
    axis, found = None, []
    for i, part in enumerate(body.law.additional_material_params):
        at = (*body.law_at, "additional_material_params", i)
        low, high = np.subtract(part.point, part.size), np.add(part.point, part.size)
        open_axes = [
            a for a in range(3) if low[a] >= standing.low[a] or high[a] <= standing.high[a]
        ]
        if config.several:
            why = "VersaGauss overwrites E and nu again; a body has one density here"
        elif body.law.material == "snow":  # type: ignore[attr-defined]
            why = "PhysGaussian computes no stress for snow"
        elif driven and open_axes:
            why = "the body is driven, and cut into no parts"
        elif (low >= standing.high).any() or (high <= standing.low).any():
            why = "no part of the body lies in it"
        elif len(open_axes) > 1 or (open_axes and axis not in (None, open_axes[0])):
            why = "a body is cut along one axis here, across which the box must reach"
        elif open_axes and body.stand.particle_filling is not None and standing.file is not None:
            why = "a capture that is filled is cut into no parts"
        elif open_axes and standing.file is not None and not standing.straight:
            why = "a part of a file is a box along its own axes, which the rotation turns away"
        else:
            axis = open_axes[0] if open_axes else axis
            found.append((low, high, part))
            continue
        report.lost(at, part, why)
    if axis is None:
        return [whole._replace(other=found[-1][2] if found else None)]
    return _slabs(whole, axis, found)


def _slabs(whole: Piece, axis: int, found: list[tuple]) -> list[Piece]:
    """Between all planes that cut it; the last one that holds a piece counts."""
    low, high = whole.low[axis], whole.high[axis]
    cuts = {float(end[axis]) for lows, highs, _ in found for end in (lows, highs)}
    edges = [low, *sorted(c for c in cuts if low < c < high), high]
    out: list[Piece] = []
    for a, b in zip(edges, edges[1:]):
        middle = (a + b) / 2
        other = None
        for lows, highs, part in found:
            other = part if lows[axis] < middle < highs[axis] else other
        if out and out[-1].other is other:
            a = out.pop().low[axis]
        ends = whole.low.copy(), whole.high.copy()
        ends[0][axis], ends[1][axis] = a, b
        out.append(Piece(*ends, other))
    return out


def materials_of(config: Config, report: Report) -> list[Table | None]:
    """The material of each body, None for one that is held."""
    found: list[Table | None] = []
    for k, body in enumerate(config.bodies):
        if getattr(body.law, "static", False):
            laws.held(body, report)
            found.append(None)
        else:
            found.append(laws.material(config, k, report))
    return found
