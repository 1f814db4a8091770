"""Conditions that act on bodies: what holds, moves, lets go and pushes them.

Only whole bodies are driven here. A condition of theirs that takes hold of a part of one is named.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from vgmpi.convert import keys
from vgmpi.convert.reading import Config, Report, Where
from vgmpi.convert.standing import Standing, in_box
from vgmpi.convert.walls import RESET, Room

Table = dict[str, Any]


class Drive(NamedTuple):
    """A motion of a whole body from one time to another [s]: velocity [m/s], and spin [rad/s] about
    an axis through a point."""

    start: float
    end: float
    velocity: tuple[float, float, float]
    spin: float
    axis: tuple[float, float, float]
    about: tuple[float, float, float]
    at: Where
    value: Any


class Acting(NamedTuple):
    """What acts on bodies. ends: (2, 3) of the domain in their box; of: more keys of their tables,
    by their numbers; loads, scenery: tables with places in their box."""

    ends: np.ndarray
    of: dict[int, Table]
    loads: list[Table]
    scenery: list[Table]


def acting(
    config: Config, standings: list[Standing], families: list[str], room: Room, report: Report
) -> Acting:
    """What the conditions that are no walls become. families: of the bodies' materials, "" for
    those that are held."""
    ends = np.array([room.low, room.high]) * config.cell
    drives: dict[int, list[Drive]] = {k: [] for k in range(len(standings))}
    found = Acting(ends, {}, [], [])
    for k, one in config.conditions:
        at: Where = ("boundary_conditions", k)
        if k in room.used:
            continue
        if isinstance(one, keys.Translation | keys.Turning):
            _drive(config, standings, one, at, drives, report)
        elif isinstance(one, keys.Cuboid):
            _cuboid(config, standings, one, at, drives, found, report)
        elif isinstance(one, keys.Release):
            _release(config, standings, families, one, at, found, report)
        elif isinstance(one, keys.Impulse):
            _impulse(config, standings, families, one, at, found, report)
    for k, some in drives.items():
        motion = _motion(config, k, some, families[k] == "", report)
        if motion and k in found.of:
            report.lost(some[0].at, some[0].value, "the body is let go layer by layer")
        elif motion:
            found.of[k] = motion
    return found


def _value(one: keys.Condition) -> Table:
    return {"type": one.type, **one.model_dump(exclude_unset=True, exclude={"type"})}


def _part(standing: Standing, share: float, at: Where, value: Any, report: Report) -> bool:
    """Whether a region takes hold of the whole body; names it where it does not."""
    if share == 1.0:
        return True
    what = f"{100 * share:.3g} % of its Gaussians" if standing.x is not None else "a part of it"
    where = f"{what} ('{standing.name}')" if share else f"no part of '{standing.name}'"
    report.lost(at, value, f"only whole bodies are driven here, and it takes hold of {where}")
    return False


def _drive(
    config: Config, standings: list[Standing], one: keys.Translation | keys.Turning, at: Where,
    drives: dict[int, list[Drive]], report: Report,
) -> None:  # fmt: skip
    k = one.object_index if config.several else 0
    if k >= len(standings):
        report.lost((*at, "object_index"), k, f"there are {len(standings)} bodies, the first is 0")
        return
    spin, axis, velocity = 0.0, (0.0, 0.0, 1.0), one.point
    if isinstance(one, keys.Translation):
        region, velocity = in_box(one.point, one.size), one.velocity
    else:
        length = math.hypot(*one.normal)
        if not length > 0:
            report.lost((*at, "normal"), list(one.normal), "it has no direction")
            return
        axis = tuple(c / length for c in one.normal)  # type: ignore[assignment]
        region = _in_cylinder(one, np.asarray(axis))
        spin = -one.rotation_scale  # theirs turns from h1 to h2 = h1 x normal: the left hand's way
        velocity = tuple(one.translation_scale * c for c in axis)  # type: ignore[assignment]
    value = _value(one)
    if _part(standings[k], standings[k].inside(region), at, value, report):
        drives[k].append(
            Drive(one.start_time, one.end_time, velocity, spin, axis, one.point, at, value)
        )


def _in_cylinder(one: keys.Turning, axis: np.ndarray):
    half, radius = one.half_height_and_radius

    def within(x: np.ndarray) -> np.ndarray:
        away = x - np.asarray(one.point)
        along = away @ axis
        return (np.abs(along) < half) & (
            np.linalg.norm(away - along[:, None] * axis, axis=1) < radius
        )

    return within


def _cuboid(
    config: Config, standings: list[Standing], one: keys.Cuboid, at: Where,
    drives: dict[int, list[Drive]], found: Acting, report: Report,
) -> None:  # fmt: skip
    """A box whose nodes have a velocity drives the bodies in it, or is one they collide with."""
    value = _value(one)
    shares = [s.inside(in_box(one.point, one.size)) for s in standings]
    if one.reset == 1:
        report.lost((*at, "reset"), one.reset, RESET)
    if any(one.velocity) and config.several:
        report.lost(
            at, value, "it stays and carries along what is in it, as a belt; none does here"
        )
        return
    if any(shares):
        for k, share in enumerate(shares):
            if share and _part(standings[k], share, at, value, report):
                drives[k].append(
                    Drive(one.start_time, one.end_time, one.velocity, 0.0, (0.0, 0.0, 1.0),
                          one.point, at, value)
                )  # fmt: skip
        return
    if one.start_time > 0 or one.end_time < config.end:
        report.lost(at, value, "a collider is there from the start to the end here")
        return
    table: Table = {"box": [np.subtract(one.point, one.size), np.add(one.point, one.size)]}
    if any(one.velocity):
        table["motion"] = {"velocity": list(one.velocity)}
    found.scenery.append({"name": f"cuboid {at[1]}", **table})
    report.partly(at, value, "a collider, which lets go of what it touches; theirs holds it fast")


def _motion(config: Config, k: int, some: list[Drive], held: bool, report: Report) -> Table:
    """The keys for motions of one body, one after the other. held: between them it stands still."""
    some = sorted(some, key=lambda drive: drive.start)
    legs: list[Drive] = []
    free = 0.0  # from when on nothing drives it
    for one in some:
        turns = [leg for leg in legs if leg.spin]
        same = not turns or not one.spin or (turns[0].axis, turns[0].about) == (one.axis, one.about)
        if one.end <= one.start or one.start >= config.end:
            report.lost(one.at, one.value, "it never acts: its times end before they begin")
        elif one.start < free - 1e-9:
            report.lost(one.at, one.value, "the body is driven by another condition at that time")
        elif one.start > free + 1e-9 and not held:
            why = "a body is driven from the start on here, and let go once"
            report.lost(one.at, one.value, why)
        elif not same:
            report.lost(one.at, one.value, "a body turns about one axis here, and has one already")
        else:
            legs.append(one)
            free = one.end
    if not legs:
        return {}
    moves = [leg for leg in legs if leg.spin or any(leg.velocity)]
    if not moves:
        return {} if held else {"frozen_until": free}
    first = next((leg for leg in legs if leg.spin), legs[0])
    turning = {"axis": list(first.axis), "about": list(first.about)} if first.spin else {}
    if len(legs) == 1 and legs[0].start == 0 and (not held or free >= config.end):
        motion: Table = {"velocity": list(first.velocity)} if any(first.velocity) else {}
        motion |= {"spin": first.spin} if first.spin else {}
        return {"motion": motion | {"until": free} | turning}
    frames = _keyframes(legs, config.end)
    return {"motion": {"keyframes": frames, "pace": "linear"} | turning}


def _keyframes(legs: list[Drive], end: float) -> list[Table]:
    """Where they take a body; between them it stands still."""
    frames: list[Table] = []
    move, angle, now = np.zeros(3), 0.0, 0.0
    for leg in legs:
        if leg.start > now + 1e-9:
            frames.append({"time": leg.start, "move": move.tolist(), "angle": angle})
        now = min(leg.end, max(end, leg.start))
        move = move + (now - leg.start) * np.asarray(leg.velocity)
        angle += (now - leg.start) * leg.spin
        frames.append({"time": now, "move": move.tolist(), "angle": angle})
    return frames


def _release(
    config: Config, standings: list[Standing], families: list[str], one: keys.Release, at: Where,
    found: Acting, report: Report,
) -> None:  # fmt: skip
    """Layers from the farthest to the nearest of a plane are let go one after the other."""
    value, body = _value(one), standings[0]
    if np.count_nonzero(one.normal) != 1:
        report.lost(at, value, "theirs takes hold of nothing unless `normal` is along one axis")
        return
    axis = int(np.argmax(np.abs(one.normal)))
    if families[0] in ("", "solid"):
        why = "only what flows, sand and snow are let go by layers here: a solid's would come apart"
        report.lost(at, value, why)
        return
    if axis != 2:
        report.lost(at, value, "layers are let go from below or from above here, along z alone")
        return
    if one.start_time > 0:
        report.lost(at, value, "a body is frozen from the start on here")
        return
    layers = one.num_layers if config.several else 50  # PhysGaussian sets it so
    middle, half = (one.point, 0.5) if config.several else ((1.0, 1.0, 1.0), 1.0)
    across = body.inside(lambda x: (np.abs(x[:, :2] - np.asarray(middle)[:2]) < half).all(axis=1))
    far = abs(one.start_position - one.end_position)
    away = np.array([body.low[2], body.high[2]]) - one.end_position
    sided = away[0] >= -1e-6 or away[1] <= 1e-6
    if across < 1.0 or not sided or np.abs(away).max() > far * (1 + 1e-6):
        why = "it does not hold all of the body, or lets it go from both sides"
        report.lost(at, value, why)
        return
    last, first = sorted(
        one.end_time / layers * max(1, math.ceil(layers * (1 - d / far) - 1e-6)) for d in abs(away)
    )[::-1]
    if not last > first:
        report.lost(at, value, "all of the body is in one layer of theirs")
        return
    found.of[0] = {
        "frozen_until": first,
        "released_by": last,
        "release": "from above" if away[1] > -away[0] else "from below",
    }
    if not config.several and one.num_layers != 50:
        report.lost((*at, "num_layers"), one.num_layers, "PhysGaussian makes 50, whatever it is")
    report.partly(at, value, "the layers are a cell high, at an even pace between the same times")


def _impulse(
    config: Config, standings: list[Standing], families: list[str], one: keys.Impulse, at: Where,
    found: Acting, report: Report,
) -> None:  # fmt: skip
    """Every particle in a box gets the same: what all get follows from their number."""
    value = _value(one)
    each = config.run.substep_dt * one.num_dt * np.asarray(one.force)
    shown = ", ".join(f"{c:g}" for c in each)
    said = f"theirs gives each particle ({shown}) N s, whatever its mass"
    region = in_box(one.point, one.size)
    rows = [k for k, family in enumerate(families) if family]
    counts = {k: _number(config, k, standings[k], region, found.ends) for k in rows}
    if any(count is None for count in counts.values()):
        why = f"{said}: how many there are is not known (no file, or it is filled or thinned out)"
        report.lost(at, value, f"{why}; [[load]] impulse is that of all together")
        return
    if config.several and one.start_time > 0:
        report.lost(at, value, f"{said} that is in the box then; a load keeps those of the start")
        return
    if config.several and one.end_time - one.start_time > one.interval:
        report.lost(at, value, f"{said} every {one.interval:g} s; a load is given once")
        return
    if not any(counts.values()) or one.start_time >= config.end:
        report.lost(at, value, "no particle gets it")
        return
    if not any(one.force):
        report.lost(at, value, "it pushes nothing")
        return
    for k, count in counts.items():
        if count:
            load: Table = {"object": standings[k].name, "impulse": (count * each).tolist()}
            if standings[k].inside(region) < 1.0:
                load["region"] = [np.subtract(one.point, one.size), np.add(one.point, one.size)]
            found.loads.append(load | ({"after": one.start_time} if one.start_time else {}))
    report.partly(at, value, f"{said}; here all get the same together, shared by rest volume")


def _number(
    config: Config, k: int, standing: Standing, region: Any, ends: np.ndarray
) -> int | None:
    """How many of their particles of a body a region in the domain holds; None where it is not
    known."""
    stand = config.bodies[k].stand
    thinned = config.several and stand.scale < 0.5
    if standing.x is None or stand.particle_filling is not None or thinned:
        return None
    x = standing.x
    return int(np.count_nonzero(region(x) & ((x >= ends[0]) & (x <= ends[1])).all(axis=1)))
