"""Conversion of a PhysGaussian or VersaGauss configuration to a scene."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi import materials
from vgmpi.runtime.config import toml_writer
from vgmpi.runtime.message_text import did_you_mean

from . import material_mapping, source_schema
from .body_pose import BodyPose, body_pose, find_file
from .boundary_conditions import ActiveConditions, convert_conditions
from .config_reader import Config, ConvertError, KeyPath, Report, key_error, read_config
from .domain_walls import ConvertedDomain, convert_domain
from .object_tables import appearance_keys, body_tables, materials_of

Table = dict[str, Any]
PIC_THRESHOLD = -0.001  # [-] rpic_damping below which their scheme is PIC
# Keys that only VersaGauss reads, in tables that both programs have.
ONLY_VERSAGAUSS = {
    source_schema.Impulse: ("end_time", "interval"),
    source_schema.Translation: ("object_index",),
    source_schema.Turning: ("object_index",),
    source_schema.Release: ("point",),
    source_schema.Filling: ("surface",),
}


def convert_scene(path: Path, gaussians: list[Path], folder: Path) -> tuple[str, list[str]]:
    """Return the text of a scene in `folder`, and a line for each key not converted in full.

    gaussians: files of the bodies in order. Raises ConvertError.
    """
    config = read_config(path)
    report = Report(path)
    if len(gaussians) > len(config.bodies):
        message = f"must be given once for each body, of which there are {len(config.bodies)}"
        raise ConvertError([f"{path}: --gaussians: {message}; got {len(gaussians)}"])
    poses = _body_poses(config, gaussians, report)
    domain = convert_domain(config, poses, report)
    laws_of = materials_of(config, report)
    families = [_family(m) for m in laws_of]
    active = convert_conditions(config, poses, families, domain, report)
    ends = np.array([domain.low, domain.high]) * config.cell
    emitted = _emitter(config, poses, ends, laws_of, report)
    materials_out: dict[str, Table] = {}
    objects: list[Table] = []
    names: dict[str, list[str]] = {}
    names_of: list[str | None] = []
    for k, pose in enumerate(poses):
        if emitted is not None and emitted["object"] == k:
            materials_out[pose.name] = laws_of[k] or {}
            names_of.append(pose.name)
            emitted["inlet"] |= appearance_keys(config, k, pose, laws_of[k], report)
            _report_inlet(config, k, pose, report)
            continue
        tables = body_tables(
            config, k, pose, ends, active.object_keys.get(k, {}), laws_of[k], folder, report
        )
        materials_out |= tables.materials
        objects += tables.objects
        names[pose.name] = tables.names
        names_of.append(tables.names[0] if laws_of[k] and tables.names else None)
    _report_unread_keys(config, report)
    top = _settings(config, domain, report)
    if any(".." in Path(obj.get("gaussians", "")).parts for obj in objects):
        top = {"allow_outside": True, **top}
    top |= {"material": materials_out, "object": objects + _colliders(active, ends[0])}
    top |= {"coupling": material_mapping.coupling_tables(config, names_of, report)}
    top |= {"load": _loads(active, names, ends[0])}
    if emitted is not None:
        top["inlet"] = [emitted["inlet"]]
    if not (objects or emitted):
        raise key_error(path, ("preprocess_params",), "no body is left in the domain")
    return toml_writer.text(
        {key: value for key, value in top.items() if value not in ([], {})},
        _head(config, poses, domain),
        _tail(report),
    ), report.lines


def _family(law: Table | None) -> str:
    """Return the family of a material; "" for a static body."""
    return materials.registry[law["kind"]].family if law else ""


def _body_poses(config: Config, gaussians: list[Path], report: Report) -> list[BodyPose]:
    """Return the poses of all bodies."""
    used_names: set[str] = set()
    poses = []
    for k, body in enumerate(config.bodies):
        file, reason = find_file(config, k, gaussians)
        poses.append(body_pose(config, k, file, report, used_names))
        if file is None:
            message = f"'{poses[-1].name}' is a box in place of its Gaussians: {reason}"
            if config.is_versagauss:
                key_path = (*body.stand_path, "model_path")
                report.dropped(key_path, body.stand.model_path, message)  # type: ignore[attr-defined]
            else:
                report.note(message)
    return poses


def _settings(config: Config, domain: ConvertedDomain, report: Report) -> Table:
    """Return the tables [domain], [time] and [accuracy]."""
    run, cell = config.run, config.cell
    frames = int(run.frame_num)
    steps = int(run.frame_dt / run.substep_dt)
    if steps < 1:
        raise key_error(
            config.path,
            ("substep_dt",),
            f"must be at most frame_dt = {run.frame_dt:g}; got {run.substep_dt:g}",
        )
    if abs(steps * run.substep_dt - run.frame_dt) > 1e-9 * run.frame_dt:
        reason = f"theirs makes {steps} whole steps in a frame, {steps * run.substep_dt:.12g} s"
        report.approximated(("frame_dt",), run.frame_dt, reason)
    if run.has_key("substep_dt"):
        reason = "the solver chooses the step (time.cfl); time.dt would fix it"
        report.dropped(("substep_dt",), run.substep_dt, reason)
    if run.has_key("grid_v_damping_scale"):
        scale = run.grid_v_damping_scale
        reason = "theirs does nothing with 1 and more"
        if scale < 1:
            reason = "theirs multiplies all velocities by it with every step; nothing here damps so"
        report.dropped(("grid_v_damping_scale",), scale, reason)
    kinds = {name: kind for name, kind in domain.kinds.items() if kind != "open"}
    distinct = set(domain.kinds.values())
    boundary: Any = {"default": "open", **kinds} if len(distinct) > 1 else distinct.pop()
    return {
        "title": f"brought over from {config.path.name}",
        "domain": {
            "size": domain.size(cell).tolist(),
            "cell": cell,
            "gravity": list(run.g),
            "boundary": boundary,
        },
        "time": {"end": config.end, "frames": frames + 1},
        "accuracy": {"transfer": _transfer(config, report)},
    }


def _transfer(config: Config, report: Report) -> str:
    """Return the transfer scheme: theirs is APIC, with damping of shear, or PIC."""
    moving_bodies = [body for body in config.bodies if not getattr(body.law, "static", False)]
    damped = [
        body for body in moving_bodies
        if not (config.is_versagauss and body.law.material in ("fluid", "snow"))  # type: ignore[attr-defined]
    ]  # fmt: skip
    pic = [body.law.rpic_damping < PIC_THRESHOLD for body in damped]
    scheme = "pic" if pic and all(pic) else "apic"
    for body in moving_bodies:
        value, key_path = body.law.rpic_damping, (*body.law_path, "rpic_damping")
        if not value or not body.law.has_key("rpic_damping"):
            continue
        if body not in damped:
            kind = body.law.material  # type: ignore[attr-defined]
            report.dropped(key_path, value, f"VersaGauss has no use of it in {kind!r}")
        elif scheme != "pic":
            reason = (
                "it damps what shears in each transfer; transfer = 'apic' here damps nothing more"
            )
            report.dropped(key_path, value, reason)
    return scheme


def _colliders(active: ActiveConditions, origin: np.ndarray) -> list[Table]:
    """Return the tables of scenery."""
    tables = []
    for item in active.scenery:
        box = [(corner - origin).tolist() for corner in item["box"]]
        table = {"name": item["name"], "role": "scenery", "collider": True, "shape": {"box": box}}
        tables.append(table | ({"motion": item["motion"]} if "motion" in item else {}))
    return tables


def _loads(
    active: ActiveConditions, names: dict[str, list[str]], origin: np.ndarray
) -> list[Table]:
    """Return the tables of loads."""
    tables = []
    for item in active.loads:
        targets = names.get(item["object"], [])
        if not targets:
            continue
        load = item | {"object": targets[0] if len(targets) == 1 else targets}
        if "region" in item:
            load["region"] = {"box": [(corner - origin).tolist() for corner in item["region"]]}
        tables.append(load)
    return tables


def _emitter(
    config: Config, poses: list[BodyPose], ends: np.ndarray, laws_of: list[Table | None],
    report: Report,
) -> Table | None:  # fmt: skip
    """Return add_particle as an inlet, and the number of the body that it replaces."""
    emitter = getattr(config.run, "add_particle", None)
    if emitter is None:
        return None
    key_path, k, g = ("add_particle",), emitter.object_material_index, config.run.g
    low, high = np.reshape(emitter.boundary, (3, 2)).T + np.asarray(emitter.move_pos)
    low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    reason = ""
    if k >= len(poses) or laws_of[min(k, len(poses) - 1)] is None:
        reason = "object_material_index is no body that moves"
    elif not emitter.additional:
        reason = (
            "what comes lies in a body that is there, too; an inlet has its nozzle to itself here"
        )
    elif g[0] or g[1] or not g[2]:
        reason = (
            "an inlet pours in a direction, which is that of gravity along z for want of another"
        )
    elif not (low < high).all() or emitter.start_time >= min(emitter.end_time, config.end):
        reason = "nothing comes: no box, or no time is left for it"
    elif _family(laws_of[k]) == "solid":
        reason = "solids do not pour"
    else:
        down = g[2] < 0
        mouth = low[2] if down else high[2]
        cells_behind = (ends[1][2] - mouth if down else mouth - ends[0][2]) / config.cell
        reason = "there is no room for a nozzle of two cells" if cells_behind < 2 else ""
    if reason:
        report.dropped(key_path, emitter, reason)
        return None
    width, height, depth = high - low
    center = [*((low + high) / 2 - ends[0])[:2], mouth - ends[0][2]]
    inlet: Table = {
        "name": f"{poses[k].name} inlet",
        "material": poses[k].name,
        "rectangle": {"center": center, "width": width, "height": height},
        "direction": [0, 0, -1 if down else 1],
        "volume_flow_rate": width * height * depth / config.run.frame_dt,
        "start_time": emitter.start_time,
    }
    if emitter.end_time < config.end:
        inlet["end_time"] = emitter.end_time
    reason = (
        "an inlet of the same volume per time if their box is full; theirs comes at rest, at once"
    )
    report.approximated(key_path, emitter, reason)
    return {"object": k, "inlet": inlet}


def _report_inlet(config: Config, k: int, pose: BodyPose, report: Report) -> None:
    """Report the keys of a body that an inlet in its place does not use."""
    body = config.bodies[k]
    unused_keys = ("scale", "center_point", "rotation_degree", "rotation_axis", "opacity_threshold")
    for key in unused_keys:
        is_reported = pose.file is None and key not in ("scale", "center_point")
        if body.stand.has_key(key) and not is_reported:
            reason = "an inlet fills the box of add_particle, whatever lies in it"
            report.dropped((*body.stand_path, key), getattr(body.stand, key), reason)
    if pose.file is not None:
        key_path = (*body.stand_path, "model_path")
        report.dropped(key_path, str(pose.file), "what an inlet pours has one color here")


def _report_unread_keys(config: Config, report: Report) -> None:
    """Report keys that belong to no body: the camera, unknown keys, surplus items."""
    run, program = config.run, "VersaGauss" if config.is_versagauss else "PhysGaussian"
    if isinstance(run, source_schema.VersaGauss):
        if run.modify_material is not None:
            report.dropped(
                ("modify_material",), run.modify_material, "a body keeps its material here"
            )
        for key in ("material_params", "preprocess_params"):
            items = getattr(run, key)
            for k in range(run.object_num, len(items)):
                report.dropped((key, k), items[k], f"object_num is {run.object_num}")
    for key_path, table in _tables(config):
        valid = (*type(table).model_fields, *(source_schema.CAMERA if table is run else ()))
        for key, value in (table.model_extra or {}).items():
            reason = f"{program} does not read it{did_you_mean(key, valid)}"
            if table is run and key in source_schema.CAMERA:
                reason = "the camera is set in render.toml (docs/how-to/render.md)"
            report.dropped((*key_path, key), value, reason)
        for key in () if config.is_versagauss else ONLY_VERSAGAUSS.get(type(table), ()):
            if table.has_key(key):
                report.dropped(
                    (*key_path, key), getattr(table, key), "PhysGaussian does not read it"
                )


def _tables(config: Config) -> Iterator[tuple[KeyPath, source_schema.Keys]]:
    """Yield all tables of the file with their key paths."""
    yield (), config.run
    for body in config.bodies:
        for key_path, table in ((body.law_path, body.law), (body.stand_path, body.stand)):
            if key_path:
                yield key_path, table
        for i, part in enumerate(body.law.additional_material_params):
            yield (*body.law_path, "additional_material_params", i), part
        if body.stand.particle_filling is not None:
            yield (*body.stand_path, "particle_filling"), body.stand.particle_filling
    for k, condition in config.conditions:
        yield ("boundary_conditions", k), condition
    emitter = getattr(config.run, "add_particle", None)
    if emitter is not None:
        yield ("add_particle",), emitter


def _head(config: Config, poses: list[BodyPose], domain: ConvertedDomain) -> list[str]:
    """Return the comments at the top of the scene."""
    program = "VersaGauss" if config.is_versagauss else "PhysGaussian"
    lines = [
        f"Made by python -m vgmpi convert from {config.path.name}, a configuration of {program}."
    ]
    origin = domain.low * config.cell
    if origin.any():
        shift = ", ".join(toml_writer.number(c) for c in origin)
        lines.append(f"Places are those of its box less ({shift}): the domain begins at its walls.")
    if "open" in domain.kinds.values():
        lines.append(
            "Where theirs has no wall, sides are open: what comes within a cell of them ends."
        )
    boxes = [pose.name for pose in poses if pose.file is None]
    if boxes:
        lines.append(f"A box stands in place of the Gaussians of: {', '.join(boxes)}.")
    return lines


def _tail(report: Report) -> list[str]:
    """Return the comments at the end of the scene."""
    start = f"{report.path}: "
    lines = [line.removeprefix(start) for line in report.lines]
    return ["What was not brought over, or in part:", *lines] if lines else []
