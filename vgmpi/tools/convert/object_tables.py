"""The [[object]] and [material.*] tables of one body: its material, filling and parts."""

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vgmpi.scene.objects import PER_CELL

from . import material_mapping, source_schema
from .body_pose import BodyPose, box_difference, in_box
from .config_reader import Config, Report

Table = dict[str, Any]


class BodyTables(NamedTuple):
    """Tables of a body in our domain's coordinates. names: of its objects."""

    materials: dict[str, Table]
    objects: list[Table]
    names: list[str]


def body_tables(
    config: Config, k: int, pose: BodyPose, ends: np.ndarray, extra_keys: Table, law: Table | None,
    folder: Path, report: Report,
) -> BodyTables:  # fmt: skip
    """Return the tables of body k.

    Args:
        ends: Corners of the domain in their box, shape (2, 3) [m].
        extra_keys: Additional keys of its objects.
        law: Its material, None if it is static.
    """
    body = config.bodies[k]
    inner = np.array([np.maximum(pose.low, ends[0]), np.minimum(pose.high, ends[1])])
    model = getattr(body.stand, "model_path", pose.name)
    if law is not None and not (inner[0] < inner[1]).all():
        key_path = (*body.stand_path, "center_point")
        report.dropped(key_path, model, "all of it lies beyond the walls, where nothing is here")
        return BodyTables({}, [], [])
    is_cut = bool((inner != np.array([pose.low, pose.high])).any()) and law is not None
    if is_cut and pose.x is not None:
        if pose.straight:
            message = f"what of '{pose.name}' lies beyond the walls is drawn, and takes no part"
            if body.stand.particle_filling is not None:
                message += "; it is cut before it is filled"
            report.note(message)
        else:
            report.note(f"'{pose.name}' reaches out of the domain, and is refused for it")
    common = appearance_keys(config, k, pose, law, report) | _with_local_axis(extra_keys, ends[0])
    low, high = (inner[0], inner[1]) if law is not None else (pose.low, pose.high)
    table: Table = {"name": pose.name}
    tables = BodyTables({}, [table], [pose.name])
    if law is None:
        table |= {"role": "scenery", "collider": True}
    else:
        table["material"] = pose.name
        complete, parts = _parts(config, k, pose, inner, bool(extra_keys), report)
        for part in complete:
            law = law | _changed_keys(law, part)
        tables.materials[pose.name] = law
        _add_regions(tables, law, parts, ends[0])
    if pose.file is None:
        table["shape"] = {"box": [(low - ends[0]).tolist(), (high - ends[0]).tolist()]}
    else:
        box = _cutting_box(inner, pose) if is_cut else None
        table |= _gaussian_file_keys(config, k, pose, box, ends[0], folder, law is not None)
    table |= common
    boxes = _scenery_boxes(pose, inner if is_cut else None)
    for i, box in enumerate(boxes):
        table = {"name": f"{pose.name} beyond {i + 1}", "role": "scenery"}
        select = {"min_opacity": body.stand.opacity_threshold, "box": box.tolist()}
        table |= {**_placement_keys(config, k, pose, ends[0], folder), "select": select}
        tables.objects.append(table)
    return tables


def _scenery_boxes(pose: BodyPose, inner: np.ndarray | None) -> list[np.ndarray]:
    """Return boxes in the file's axes with Gaussians that are only drawn.

    They are beyond sim_area, and beyond the walls; inner: region between these, in their box.
    """
    if pose.file is None or not pose.straight:
        return []
    slack = np.ptp(pose.own, axis=0).max()
    complete_box = np.array([pose.own.min(axis=0) - slack, pose.own.max(axis=0) + slack])
    boxes = [] if pose.area is None else box_difference(pose.area, complete_box)
    if inner is not None:
        cutting_box = _cutting_box(inner, pose)
        crop = complete_box if pose.box is None else pose.box
        boxes += box_difference(pose.in_file(cutting_box), crop)
    points = pose.own
    return [box for box in boxes if ((points >= box[0]) & (points <= box[1])).all(axis=1).any()]


def _cutting_box(inner: np.ndarray, pose: BodyPose) -> np.ndarray:
    """Return the box (2, 3), in their box, to cut a body from; it extends beyond uncut sides."""
    low, high = inner
    slack = (pose.high - pose.low).max()
    return np.array([
        np.where(low <= pose.low, pose.low - slack, low),
        np.where(high >= pose.high, pose.high + slack, high),
    ])  # fmt: skip


def _add_regions(
    tables: BodyTables, law: Table, parts: list[source_schema.Part], origin: np.ndarray
) -> None:
    """Add a material and a region for each part of the body with other numbers.

    Args:
        tables: Tables of the body (in/out).
        law: Material of the body.
        parts: Parts in the order of the file, of which the last one counts, as here.
        origin: Corner of the domain in their box, shape (3,) [m].
    """
    (table,) = tables.objects
    regions = []
    for i, part in enumerate(parts):
        name = f"{table['name']} part {i + 1}"
        tables.materials[name] = law | _changed_keys(law, part)
        low, high = np.subtract(part.point, part.size), np.add(part.point, part.size)
        box = [(low - origin).tolist(), (high - origin).tolist()]
        regions.append({"material": name, "box": box})
    if regions:
        table["region"] = regions


def _changed_keys(law: Table, part: source_schema.Part) -> Table:
    """Return the keys of a material that additional_material_params changes."""
    density = law["density"] if part.density is None else part.density
    return {"youngs_modulus": part.E, "poisson_ratio": part.nu, "density": density}


def _with_local_axis(extra_keys: Table, origin: np.ndarray) -> Table:
    """Return the keys for motions with positions in the domain's coordinates."""
    if "pivot" not in extra_keys.get("motion", {}):
        return extra_keys
    pivot = (np.asarray(extra_keys["motion"]["pivot"]) - origin).tolist()
    return extra_keys | {"motion": extra_keys["motion"] | {"pivot": pivot}}


def _gaussian_file_keys(
    config: Config, k: int, pose: BodyPose, box: np.ndarray | None, origin: np.ndarray,
    folder: Path, has_mass: bool,
) -> Table:  # fmt: skip
    """Return the keys for a Gaussian file and its placement. box: region to take, in their box."""
    stand = config.bodies[k].stand
    assert pose.file is not None
    crop = pose.box
    if box is not None and pose.straight:
        low, high = pose.in_file(box)
        if crop is not None:
            low, high = np.maximum(low, crop[0]), np.minimum(high, crop[1])
        crop = np.array([low, high])
    select: Table = {"min_opacity": stand.opacity_threshold}
    if crop is not None:
        select["box"] = crop.tolist()
    table = {**_placement_keys(config, k, pose, origin, folder), "select": select}
    if has_mass or stand.particle_filling is not None:
        filling = stand.particle_filling
        table["fill"] = False if filling is None else "visible" if filling.visualize else True
        count = _per_cell(config, filling) if filling is not None else 8.0
        if count in PER_CELL and count != 8:
            table["particles_per_cell"] = int(count)
    return table


def _placement_keys(
    config: Config, k: int, pose: BodyPose, origin: np.ndarray, folder: Path
) -> Table:
    """Return the keys that place all of a file."""
    assert pose.file is not None
    stand = config.bodies[k].stand
    file = os.path.relpath(pose.file.resolve(), folder.resolve())
    table: Table = {"gaussians": file, "scale": pose.scale}
    rotations = zip(stand.rotation_degree, stand.rotation_axis, strict=True)
    rotation = [
        {"axis": "xyz"[axis], "angle": f"{angle:.12g} deg"} for angle, axis in rotations if angle
    ]
    if rotation:
        table["rotation"] = rotation
    return table | {"origin": (pose.origin - origin).tolist()}


def appearance_keys(
    config: Config, k: int, pose: BodyPose, law: Table | None, report: Report
) -> Table:
    """Return the keys for a body's appearance, and report keys of its filling.

    Args:
        config: Configuration of the other program.
        k: Number of the body.
        pose: Its pose.
        law: Its material, None if it is static.
        report: Keys that are not converted (in/out).
    """
    body = config.bodies[k]
    table: Table = {}
    stand, key_path = body.stand, body.stand_path
    if stand.particle_filling is not None:
        _report_filling(config, k, pose, report)
    if not isinstance(stand, source_schema.VersaGaussStand):
        return table
    fluid = law is not None and law["kind"] == "fluid"
    if stand.has_key("opacity_scale"):
        if fluid:
            table["opacity_scale"] = stand.opacity_scale
        elif stand.opacity_scale != 1:
            report.dropped(
                (*key_path, "opacity_scale"), stand.opacity_scale, "VersaGauss fades fluids alone"
            )
    if stand.color is not None:
        if pose.file is None and fluid:
            table["color"] = [c / 255 for c in stand.color]
        else:
            reason = "a capture keeps its colors" if fluid else "VersaGauss colors fluids alone"
            report.dropped((*key_path, "color"), list(stand.color), reason)
    if stand.camera_path is not None:
        report.dropped(
            (*key_path, "camera_path"), stand.camera_path, "the camera is set in render.toml"
        )
    if stand.scale < 0.5 and pose.file is not None and not fluid:
        reason = "theirs also thins out its Gaussians; `prune` does here"
        report.approximated((*key_path, "scale"), stand.scale, reason)
    kind = getattr(body.law, "type", None)
    if kind == "floor" or (kind == "table" and stand.scale >= 5):
        reason = "theirs stretches it along x and y alone; here all axes have `scale`"
        report.approximated((*body.law_path, "type"), kind, reason)
    elif kind is not None and kind != "table":
        report.dropped((*body.law_path, "type"), kind, "VersaGauss knows 'floor' and 'table' alone")
    return table


def _per_cell(config: Config, filling: source_schema.Filling) -> float:
    """Return the particles per cell of their filling, rounded if it is a whole number."""
    extent = config.run.grid_lim
    if filling.boundary is not None:
        extent = max(np.diff(np.reshape(filling.boundary, (3, 2)), axis=1)[:, 0])
    count = filling.n_grid or 4 * config.run.n_grid
    per_cell = filling.max_partciels_per_cell * (config.cell * count / extent) ** 3
    return round(per_cell) if abs(per_cell - round(per_cell)) < 1e-6 * per_cell else per_cell


def _report_filling(config: Config, k: int, pose: BodyPose, report: Report) -> None:
    """Report the keys of particle_filling that are not converted."""
    body = config.bodies[k]
    filling, key_path = body.stand.particle_filling, (*body.stand_path, "particle_filling")
    assert filling is not None
    if pose.file is None:
        report.dropped(key_path, filling, "there is no Gaussian file to fill (--gaussians)")
        return
    count = _per_cell(config, filling)
    is_available = count in PER_CELL
    for key in filling.model_fields_set & set(source_schema.Filling.model_fields):
        value = getattr(filling, key)
        reason = "what is inside is found by voxels here (docs/how-to/prepare-captures.md)"
        if key == "visualize" or (key in ("n_grid", "max_partciels_per_cell") and is_available):
            continue
        if key == "boundary":
            if value is None:
                continue
            low, high = np.reshape(value, (3, 2)).T
            if (low <= pose.low).all() and (high >= pose.high).all():
                continue
            reason = "it does not hold all of the body, which is filled as a whole here"
        elif key in ("n_grid", "max_partciels_per_cell"):
            reason = (
                f"theirs makes {count:.3g} in a cell; here 8, or 1, 27, 64 (particles_per_cell)"
            )
        elif key == "max_particles_num":
            reason = "all that are needed are made here"
        elif key == "surface":
            reason = "the Gaussians of a fluid's surface stay here"
            if value is False or not config.is_versagauss:
                continue
        report.dropped((*key_path, key), value, reason)


def _parts(
    config: Config, k: int, pose: BodyPose, inner: np.ndarray, has_motion: bool, report: Report
) -> tuple[list[source_schema.Part], list[source_schema.Part]]:
    """Return the parts of a body whose material additional_material_params changes.

    Args:
        config: Configuration of the other program.
        k: Number of the body.
        pose: Its pose.
        inner: Corners of the body between the walls, shape (2, 3) [m].
        has_motion: Whether its motion is prescribed.
        report: Keys that are not converted (in/out).

    Returns:
        The last one that holds all of the body, or none, and those after it that hold a part.
    """
    body = config.bodies[k]
    complete: list[source_schema.Part] = []
    parts: list[source_schema.Part] = []
    for i, part in enumerate(body.law.additional_material_params):
        key_path = (*body.law_path, "additional_material_params", i)
        low, high = np.subtract(part.point, part.size), np.add(part.point, part.size)
        is_filled = body.stand.particle_filling is not None and pose.file is not None
        is_outside = (low >= inner[1]).any() or (high <= inner[0]).any()
        if config.is_versagauss:
            reason = "VersaGauss overwrites E and nu again; a body has one density here"
        elif body.law.material == "snow":  # type: ignore[attr-defined]
            reason = "PhysGaussian computes no stress for snow"
        elif is_outside or not (is_filled or pose.inside(in_box(part.point, part.size))):
            reason = "no part of the body lies in it"
        elif (low < inner[0]).all() and (high > inner[1]).all():
            complete, parts = [part], []
            continue
        elif has_motion:
            reason = "the body is driven, and has one material until it is let go"
        else:
            parts.append(part)
            continue
        report.dropped(key_path, part, reason)
    return complete, parts


def materials_of(config: Config, report: Report) -> list[Table | None]:
    """Return the material of each body, None for a static one."""
    tables: list[Table | None] = []
    for k, body in enumerate(config.bodies):
        if getattr(body.law, "static", False):
            material_mapping.report_rigid_body(body, report)
            tables.append(None)
        else:
            tables.append(material_mapping.material_table(config, k, report))
    return tables
