"""A configuration of PhysGaussian or VersaGauss as a scene."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi import materials
from vgmpi.convert import keys, laws, written
from vgmpi.convert.bodies import look, make, materials_of
from vgmpi.convert.conditions import Acting, acting
from vgmpi.convert.reading import Config, ConvertError, Report, Where, read, refused
from vgmpi.convert.standing import Standing, find_file, stand
from vgmpi.convert.walls import Room, room
from vgmpi.misspelt import nearest

Table = dict[str, Any]
SMALL = -0.001  # of rpic_damping, below which theirs is PIC
# what only VersaGauss reads, in tables that both have
ONLY_VERSAGAUSS = {
    keys.Impulse: ("end_time", "interval"),
    keys.Translation: ("object_index",),
    keys.Turning: ("object_index",),
    keys.Release: ("point",),
    keys.Filling: ("surface",),
}


def converted(path: Path, gaussians: list[Path], folder: Path) -> tuple[str, list[str]]:
    """The text of a scene that lies in `folder`, and a line for each key that is not all in it.

    gaussians: files of the bodies in order. Raises ConvertError.
    """
    config = read(path)
    report = Report(path)
    if len(gaussians) > len(config.bodies):
        said = f"must be given once for each body, of which there are {len(config.bodies)}"
        raise ConvertError([f"{path}: --gaussians: {said}; got {len(gaussians)}"])
    standings = _standings(config, gaussians, report)
    space = room(config, standings, report)
    made_of = materials_of(config, report)
    families = [_family(m) for m in made_of]
    found = acting(config, standings, families, space, report)
    ends = np.array([space.low, space.high]) * config.cell
    emitted = _emitter(config, standings, ends, made_of, report)
    stuff: dict[str, Table] = {}
    objects: list[Table] = []
    names: dict[str, list[str]] = {}
    of: list[str | None] = []
    for k, standing in enumerate(standings):
        if emitted is not None and emitted["object"] == k:
            stuff[standing.name] = made_of[k] or {}
            of.append(standing.name)
            emitted["source"] |= look(config, k, standing, made_of[k], report)
            _tell_of_source(config, k, standing, report)
            continue
        some = make(config, k, standing, ends, found.of.get(k, {}), made_of[k], folder, report)
        stuff |= some.materials
        objects += some.objects
        names[standing.name] = some.names
        of.append(some.names[0] if made_of[k] and some.names else None)
    _whole(config, report)
    top = _settings(config, space, report)
    if any(".." in Path(one.get("gaussians", "")).parts for one in objects):
        top = {"allow_outside": True, **top}
    top |= {"material": stuff, "object": objects + _colliders(found, ends[0])}
    top |= {"coupling": laws.couplings(config, of, report)}
    top |= {"load": _loads(found, names, ends[0])}
    if emitted is not None:
        top["source"] = [emitted["source"]]
    if not (objects or emitted):
        raise refused(path, ("preprocess_params",), "no body is left in the domain")
    return written.text(
        {key: value for key, value in top.items() if value not in ([], {})},
        _head(config, standings, space),
        _tail(report),
    ), report.lines


def _family(law: Table | None) -> str:
    """Of a material; "" for a body that is held."""
    return materials.registry[law["kind"]].family if law else ""  # type: ignore[attr-defined]


def _standings(config: Config, gaussians: list[Path], report: Report) -> list[Standing]:
    taken: set[str] = set()
    out = []
    for k, body in enumerate(config.bodies):
        file, why = find_file(config, k, gaussians)
        out.append(stand(config, k, file, report, taken))
        if file is None:
            said = f"'{out[-1].name}' is a box in place of its Gaussians: {why}"
            if config.several:
                at = (*body.stand_at, "model_path")
                report.lost(at, body.stand.model_path, said)  # type: ignore[attr-defined]
            else:
                report.note(said)
    return out


def _settings(config: Config, space: Room, report: Report) -> Table:
    """The tables [domain], [time] and [accuracy]."""
    run, cell = config.run, config.cell
    frames = int(run.frame_num)
    steps = int(run.frame_dt / run.substep_dt)
    if steps < 1:
        raise refused(
            config.path,
            ("substep_dt",),
            f"must be at most frame_dt = {run.frame_dt:g}; got {run.substep_dt:g}",
        )
    if abs(steps * run.substep_dt - run.frame_dt) > 1e-9 * run.frame_dt:
        why = f"theirs makes {steps} whole steps in a frame, {steps * run.substep_dt:.12g} s"
        report.partly(("frame_dt",), run.frame_dt, why)
    if run.given("substep_dt"):
        why = "the solver chooses the step (time.cfl); time.dt would fix it"
        report.lost(("substep_dt",), run.substep_dt, why)
    if run.given("grid_v_damping_scale"):
        scale = run.grid_v_damping_scale
        why = "theirs does nothing with 1 and more"
        if scale < 1:
            why = "theirs multiplies all velocities by it with every step; nothing here damps so"
        report.lost(("grid_v_damping_scale",), scale, why)
    kinds = {name: kind for name, kind in space.kinds.items() if kind != "open"}
    same = set(space.kinds.values())
    boundary: Any = {"default": "open", **kinds} if len(same) > 1 else same.pop()
    return {
        "title": f"brought over from {config.path.name}",
        "domain": {
            "size": space.size(cell).tolist(),
            "cell": cell,
            "gravity": list(run.g),
            "boundary": boundary,
        },
        "time": {"end": config.end, "frames": frames + 1},
        "accuracy": {"transfer": _transfer(config, report)},
    }


def _transfer(config: Config, report: Report) -> str:
    """Theirs is APIC, with damping of what shears; or PIC."""
    moving = [body for body in config.bodies if not getattr(body.law, "static", False)]
    damped = [
        body for body in moving
        if not (config.several and body.law.material in ("fluid", "snow"))  # type: ignore[attr-defined]
    ]  # fmt: skip
    pic = [body.law.rpic_damping < SMALL for body in damped]
    how = "pic" if pic and all(pic) else "apic"
    for body in moving:
        value, at = body.law.rpic_damping, (*body.law_at, "rpic_damping")
        if not value or not body.law.given("rpic_damping"):
            continue
        if body not in damped:
            kind = body.law.material  # type: ignore[attr-defined]
            report.lost(at, value, f"VersaGauss has no use of it in {kind!r}")
        elif how != "pic":
            why = "it damps what shears in each transfer; transfer = 'apic' here damps nothing more"
            report.lost(at, value, why)
    return how


def _colliders(found: Acting, origin: np.ndarray) -> list[Table]:
    out = []
    for one in found.scenery:
        box = [(corner - origin).tolist() for corner in one["box"]]
        table = {"name": one["name"], "role": "scenery", "collider": True, "shape": {"box": box}}
        out.append(table | ({"motion": one["motion"]} if "motion" in one else {}))
    return out


def _loads(found: Acting, names: dict[str, list[str]], origin: np.ndarray) -> list[Table]:
    out = []
    for one in found.loads:
        of = names.get(one["object"], [])
        if not of:
            continue
        load = one | {"object": of[0] if len(of) == 1 else of}
        if "region" in one:
            load["region"] = {"box": [(corner - origin).tolist() for corner in one["region"]]}
        out.append(load)
    return out


def _emitter(
    config: Config, standings: list[Standing], ends: np.ndarray, made_of: list[Table | None],
    report: Report,
) -> Table | None:  # fmt: skip
    """add_particle as a source, and the number of the body that it takes the place of."""
    one = getattr(config.run, "add_particle", None)
    if one is None:
        return None
    at, k, g = ("add_particle",), one.object_material_index, config.run.g
    low, high = np.reshape(one.boundary, (3, 2)).T + np.asarray(one.move_pos)
    low, high = np.maximum(low, ends[0]), np.minimum(high, ends[1])
    why = ""
    if k >= len(standings) or made_of[min(k, len(standings) - 1)] is None:
        why = "object_material_index is no body that moves"
    elif not one.additional:
        why = "what comes lies in a body that is there, too; a source has its nozzle to itself here"
    elif g[0] or g[1] or not g[2]:
        why = "a source pours in a direction, which is that of gravity along z for want of another"
    elif not (low < high).all() or one.start_time >= min(one.end_time, config.end):
        why = "nothing comes: no box, or no time is left for it"
    elif _family(made_of[k]) == "solid":
        why = "solids do not pour"
    else:
        down = g[2] < 0
        mouth = low[2] if down else high[2]
        room_behind = (ends[1][2] - mouth if down else mouth - ends[0][2]) / config.cell
        why = "there is no room for a nozzle of two cells" if room_behind < 2 else ""
    if why:
        report.lost(at, one, why)
        return None
    width, height, depth = high - low
    centre = [*((low + high) / 2 - ends[0])[:2], mouth - ends[0][2]]
    source: Table = {
        "name": f"{standings[k].name} source",
        "material": standings[k].name,
        "rectangle": {"center": centre, "width": width, "height": height},
        "direction": [0, 0, -1 if down else 1],
        "flow": width * height * depth / config.run.frame_dt,
        "start": one.start_time,
    }
    if one.end_time < config.end:
        source["end"] = one.end_time
    why = "a source of the same volume per time if their box is full; theirs comes at rest, at once"
    report.partly(at, one, why)
    return {"object": k, "source": source}


def _tell_of_source(config: Config, k: int, standing: Standing, report: Report) -> None:
    """Name what a source in place of a body does without."""
    body = config.bodies[k]
    keep = ("scale", "center_point", "rotation_degree", "rotation_axis", "opacity_threshold")
    for key in keep:
        told = standing.file is None and key not in ("scale", "center_point")
        if body.stand.given(key) and not told:
            why = "a source fills the box of add_particle, whatever lies in it"
            report.lost((*body.stand_at, key), getattr(body.stand, key), why)
    if standing.file is not None:
        at = (*body.stand_at, "model_path")
        report.lost(at, str(standing.file), "what a source pours has one colour here")


def _whole(config: Config, report: Report) -> None:
    """Name the keys that stand for no body: the camera, what is unknown, what is too many."""
    run, theirs = config.run, "VersaGauss" if config.several else "PhysGaussian"
    if isinstance(run, keys.VersaGauss):
        if run.modify_material is not None:
            report.lost(("modify_material",), run.modify_material, "a body keeps its material here")
        for key in ("material_params", "preprocess_params"):
            items = getattr(run, key)
            for k in range(run.object_num, len(items)):
                report.lost((key, k), items[k], f"object_num is {run.object_num}")
    for at, table in _tables(config):
        known = (*type(table).model_fields, *(keys.CAMERA if table is run else ()))
        for key, value in (table.model_extra or {}).items():
            why = f"{theirs} does not read it{nearest(key, known)}"
            if table is run and key in keys.CAMERA:
                why = "the camera is set in render.toml (docs/rendering.md)"
            report.lost((*at, key), value, why)
        for key in () if config.several else ONLY_VERSAGAUSS.get(type(table), ()):
            if table.given(key):
                report.lost((*at, key), getattr(table, key), "PhysGaussian does not read it")


def _tables(config: Config) -> Iterator[tuple[Where, keys.Keys]]:
    """All tables of the file, with the places where they stand."""
    yield (), config.run
    for body in config.bodies:
        for at, table in ((body.law_at, body.law), (body.stand_at, body.stand)):
            if at:
                yield at, table
        for i, part in enumerate(body.law.additional_material_params):
            yield (*body.law_at, "additional_material_params", i), part
        if body.stand.particle_filling is not None:
            yield (*body.stand_at, "particle_filling"), body.stand.particle_filling
    for k, condition in config.conditions:
        yield ("boundary_conditions", k), condition
    more = getattr(config.run, "add_particle", None)
    if more is not None:
        yield ("add_particle",), more


def _head(config: Config, standings: list[Standing], space: Room) -> list[str]:
    theirs = "VersaGauss" if config.several else "PhysGaussian"
    lines = [
        f"Made by python -m vgmpi.convert from {config.path.name}, a configuration of {theirs}."
    ]
    origin = space.low * config.cell
    if origin.any():
        shift = ", ".join(written.number(c) for c in origin)
        lines.append(f"Places are those of its box less ({shift}): the domain begins at its walls.")
    if "open" in space.kinds.values():
        lines.append(
            "Where theirs has no wall, sides are open: what comes within a cell of them ends."
        )
    boxes = [one.name for one in standings if one.file is None]
    if boxes:
        lines.append(f"A box stands in place of the Gaussians of: {', '.join(boxes)}.")
    return lines


def _tail(report: Report) -> list[str]:
    start = f"{report.path}: "
    lines = [line.removeprefix(start) for line in report.lines]
    return ["What was not brought over, or in part:", *lines] if lines else []
