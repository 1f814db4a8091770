"""Conversion of conditions that act on bodies: motions, releases, impulses and colliders.

Whole bodies have prescribed motions here, and parts of solids are pinned from the start to the end.
Other conditions on a part of a body are reported.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from . import source_schema
from .body_pose import BodyPose, in_box
from .config_reader import Config, KeyPath, Report
from .domain_walls import RESET, ConvertedDomain
from .pinned_conditions import PinnedConditions, held_region, in_cylinder

Table = dict[str, Any]


class PrescribedMotion(NamedTuple):
    """Motion of a whole body from one time to another [s].

    It is a velocity [m/s], and a spin [rad/s] about an axis through a point.
    """

    start: float
    end: float
    velocity: tuple[float, float, float]
    spin: float
    axis: tuple[float, float, float]
    about: tuple[float, float, float]
    key_path: KeyPath
    value: Any


class ActiveConditions(NamedTuple):
    """Conditions that act on bodies.

    ends: corners of the domain in their box, shape (2, 3) [m]; object_keys: additional keys of
    objects, by number of the body; loads, scenery: tables with positions in their box.
    """

    ends: np.ndarray
    object_keys: dict[int, Table]
    loads: list[Table]
    scenery: list[Table]


def convert_conditions(
    config: Config,
    poses: list[BodyPose],
    families: list[str],
    domain: ConvertedDomain,
    report: Report,
) -> ActiveConditions:
    """Convert the conditions that are not walls.

    Args:
        config: Configuration of the other program.
        poses: Poses of the bodies.
        families: Families of the bodies' materials, "" for static bodies.
        domain: Converted domain.
        report: Keys that are not converted (in/out).
    """
    ends = np.array([domain.low, domain.high]) * config.cell
    drives: dict[int, list[PrescribedMotion]] = {k: [] for k in range(len(poses))}
    active = ActiveConditions(ends, {}, [], [])
    pins = PinnedConditions(config, poses, families, ends[0])
    for k, condition in config.conditions:
        key_path: KeyPath = ("boundary_conditions", k)
        if k in domain.used:
            continue
        if isinstance(condition, source_schema.Translation | source_schema.Turning):
            _convert_motion(config, poses, condition, key_path, drives, pins, report)
        elif isinstance(condition, source_schema.Cuboid):
            _convert_cuboid(config, poses, condition, key_path, drives, active, pins, report)
        elif isinstance(condition, source_schema.Release):
            _convert_release(config, poses, families, condition, key_path, active, report)
        elif isinstance(condition, source_schema.Impulse):
            _convert_impulse(config, poses, families, condition, key_path, active, report)
    for k, motions in drives.items():
        motion = _motion_keys(config, motions, families[k] == "", report)
        if motion and k in active.object_keys:
            report.dropped(
                motions[0].key_path, motions[0].value, "the body is let go layer by layer"
            )
        elif motion:
            active.object_keys[k] = motion
    pins.merge_into(active.object_keys, report)
    return active


def _value(condition: source_schema.Condition) -> Table:
    """Return a condition as a table."""
    return {"type": condition.type, **condition.model_dump(exclude_unset=True, exclude={"type"})}


def _acts_on_whole_body(
    pose: BodyPose, fraction: float, key_path: KeyPath, value: Any, report: Report
) -> bool:
    """Return whether a region contains the whole body; report it if not."""
    if fraction == 1.0:
        return True
    part = f"{100 * fraction:.3g} % of its Gaussians" if pose.x is not None else "a part of it"
    portion = f"{part} ('{pose.name}')" if fraction else f"no part of '{pose.name}'"
    report.dropped(
        key_path, value, f"only whole bodies are driven here, and it takes hold of {portion}"
    )
    return False


def _convert_motion(
    config: Config, poses: list[BodyPose],
    condition: source_schema.Translation | source_schema.Turning,
    key_path: KeyPath, drives: dict[int, list[PrescribedMotion]], pins: PinnedConditions,
    report: Report,
) -> None:  # fmt: skip
    """Convert a prescribed translation or rotation."""
    k = condition.object_index if config.is_versagauss else 0
    if k >= len(poses):
        report.dropped(
            (*key_path, "object_index"), k, f"there are {len(poses)} bodies, the first is 0"
        )
        return
    spin, axis, velocity = 0.0, (0.0, 0.0, 1.0), condition.point
    if isinstance(condition, source_schema.Translation):
        region, velocity = in_box(condition.point, condition.size), condition.velocity
    else:
        length = math.hypot(*condition.normal)
        if not length > 0:
            report.dropped((*key_path, "normal"), list(condition.normal), "it has no direction")
            return
        axis = tuple(c / length for c in condition.normal)  # type: ignore[assignment]
        region = in_cylinder(condition, np.asarray(axis))
        spin = -condition.rotation_scale  # theirs is left-handed: from h1 to h2 = h1 x normal
        velocity = tuple(condition.translation_scale * c for c in axis)  # type: ignore[assignment]
    value = _value(condition)
    if pins.add(k, held_region(condition, region, velocity, spin, axis)):
        return
    if _acts_on_whole_body(poses[k], poses[k].inside(region), key_path, value, report):
        drives[k].append(
            PrescribedMotion(
                condition.start_time,
                condition.end_time,
                velocity,
                spin,
                axis,
                condition.point,
                key_path,
                value,
            )
        )


def _convert_cuboid(
    config: Config, poses: list[BodyPose], condition: source_schema.Cuboid, key_path: KeyPath,
    drives: dict[int, list[PrescribedMotion]], active: ActiveConditions, pins: PinnedConditions,
    report: Report,
) -> None:  # fmt: skip
    """Convert a box with prescribed velocity: it moves the bodies inside, or is a collider."""
    value = _value(condition)
    fractions = [s.inside(in_box(condition.point, condition.size)) for s in poses]
    if condition.reset == 1:
        report.dropped((*key_path, "reset"), condition.reset, RESET)
    if any(condition.velocity) and config.is_versagauss:
        report.dropped(
            key_path, value, "it stays and carries along what is in it, as a belt; none does here"
        )
        return
    if any(fractions):
        within = in_box(condition.point, condition.size)
        region = held_region(condition, within, condition.velocity, 0.0, (0.0, 0.0, 1.0))
        for k, fraction in enumerate(fractions):
            if fraction and pins.add(k, region):
                reason = "holds the particles of the start; theirs holds what enters, too"
                report.approximated(key_path, value, reason)
            elif fraction and _acts_on_whole_body(poses[k], fraction, key_path, value, report):
                drives[k].append(
                    PrescribedMotion(condition.start_time, condition.end_time, condition.velocity,
                                     0.0, (0.0, 0.0, 1.0), condition.point, key_path, value)
                )  # fmt: skip
        return
    if condition.start_time > 0 or condition.end_time < config.end:
        report.dropped(key_path, value, "a collider is there from the start to the end here")
        return
    table: Table = {
        "box": [
            np.subtract(condition.point, condition.size),
            np.add(condition.point, condition.size),
        ]
    }
    if any(condition.velocity):
        table["motion"] = {"velocity": list(condition.velocity)}
    active.scenery.append({"name": f"cuboid {key_path[1]}", **table})
    report.approximated(
        key_path, value, "a collider, which lets go of what it touches; theirs holds it fast"
    )


def _motion_keys(
    config: Config, motions: list[PrescribedMotion], is_static: bool, report: Report
) -> Table:
    """Return the keys for the successive motions of one body; a static one rests between them."""
    motions = sorted(motions, key=lambda drive: drive.start)
    segments: list[PrescribedMotion] = []
    free_from = 0.0  # [s] nothing moves it from then on
    for motion_part in motions:
        rotations = [segment for segment in segments if segment.spin]
        same_axis = (
            not rotations
            or not motion_part.spin
            or (rotations[0].axis, rotations[0].about) == (motion_part.axis, motion_part.about)
        )
        if motion_part.end <= motion_part.start or motion_part.start >= config.end:
            report.dropped(
                motion_part.key_path,
                motion_part.value,
                "it never acts: its times end before they begin",
            )
        elif motion_part.start < free_from - 1e-9:
            report.dropped(
                motion_part.key_path,
                motion_part.value,
                "the body is driven by another condition at that time",
            )
        elif motion_part.start > free_from + 1e-9 and not is_static:
            reason = "a body is driven from the start on here, and let go once"
            report.dropped(motion_part.key_path, motion_part.value, reason)
        elif not same_axis:
            report.dropped(
                motion_part.key_path,
                motion_part.value,
                "a body turns about one axis here, and has one already",
            )
        else:
            segments.append(motion_part)
            free_from = motion_part.end
    if not segments:
        return {}
    moves = [segment for segment in segments if segment.spin or any(segment.velocity)]
    if not moves:
        return {} if is_static else {"release_time": free_from}
    first = next((segment for segment in segments if segment.spin), segments[0])
    axis_keys = {"axis": list(first.axis), "pivot": list(first.about)} if first.spin else {}
    if len(segments) == 1 and segments[0].start == 0 and (not is_static or free_from >= config.end):
        motion: Table = {"velocity": list(first.velocity)} if any(first.velocity) else {}
        motion |= {"angular_velocity": first.spin} if first.spin else {}
        return {"motion": motion | {"end_time": free_from} | axis_keys}
    frames = _keyframes(segments, config.end)
    return {"motion": {"keyframes": frames, "interpolation": "linear"} | axis_keys}


def _keyframes(segments: list[PrescribedMotion], end: float) -> list[Table]:
    """Return the keyframes of successive motions, with rest between them."""
    frames: list[Table] = []
    move, angle, time = np.zeros(3), 0.0, 0.0
    for segment in segments:
        if segment.start > time + 1e-9:
            frames.append({"time": segment.start, "translation": move.tolist(), "angle": angle})
        time = min(segment.end, max(end, segment.start))
        move = move + (time - segment.start) * np.asarray(segment.velocity)
        angle += (time - segment.start) * segment.spin
        frames.append({"time": time, "translation": move.tolist(), "angle": angle})
    return frames


def _convert_release(
    config: Config, poses: list[BodyPose], families: list[str], condition: source_schema.Release,
    key_path: KeyPath, active: ActiveConditions, report: Report,
) -> None:  # fmt: skip
    """Convert a release by layers, from the farthest from a plane to the nearest."""
    value, body = _value(condition), poses[0]
    if np.count_nonzero(condition.normal) != 1:
        report.dropped(
            key_path, value, "theirs takes hold of nothing unless `normal` is along one axis"
        )
        return
    axis = int(np.argmax(np.abs(condition.normal)))
    if families[0] in ("", "solid"):
        reason = (
            "only what flows, sand and snow are let go by layers here: a solid's would come apart"
        )
        report.dropped(key_path, value, reason)
        return
    if axis != 2:
        report.dropped(
            key_path, value, "layers are let go from below or from above here, along z alone"
        )
        return
    if condition.start_time > 0:
        report.dropped(key_path, value, "a body is frozen from the start on here")
        return
    layers = condition.num_layers if config.is_versagauss else 50  # PhysGaussian sets it so
    center, half = (condition.point, 0.5) if config.is_versagauss else ((1.0, 1.0, 1.0), 1.0)
    across = body.inside(lambda x: (np.abs(x[:, :2] - np.asarray(center)[:2]) < half).all(axis=1))
    distance = abs(condition.start_position - condition.end_position)
    offsets = np.array([body.low[2], body.high[2]]) - condition.end_position
    is_one_sided = offsets[0] >= -1e-6 or offsets[1] <= 1e-6
    if across < 1.0 or not is_one_sided or np.abs(offsets).max() > distance * (1 + 1e-6):
        reason = "it does not hold all of the body, or lets it go from both sides"
        report.dropped(key_path, value, reason)
        return
    last_time, first_time = sorted(
        condition.end_time / layers * max(1, math.ceil(layers * (1 - d / distance) - 1e-6))
        for d in abs(offsets)
    )[::-1]
    if not last_time > first_time:
        report.dropped(key_path, value, "all of the body is in one layer of theirs")
        return
    active.object_keys[0] = {
        "release_time": first_time,
        "release_end_time": last_time,
        "release_order": "top-down" if offsets[1] > -offsets[0] else "bottom-up",
    }
    if not config.is_versagauss and condition.num_layers != 50:
        report.dropped(
            (*key_path, "num_layers"), condition.num_layers, "PhysGaussian makes 50, whatever it is"
        )
    report.approximated(
        key_path, value, "the layers are a cell high, at an even pace between the same times"
    )


def _convert_impulse(
    config: Config, poses: list[BodyPose], families: list[str], condition: source_schema.Impulse,
    key_path: KeyPath, active: ActiveConditions, report: Report,
) -> None:  # fmt: skip
    """Convert an equal impulse on every particle in a box; the total follows from their number."""
    value = _value(condition)
    impulse = config.run.substep_dt * condition.num_dt * np.asarray(condition.force)
    numbers = ", ".join(f"{c:g}" for c in impulse)
    message = f"theirs gives each particle ({numbers}) N s, whatever its mass"
    region = in_box(condition.point, condition.size)
    rows = [k for k, family in enumerate(families) if family]
    counts = {k: _particle_count(config, k, poses[k], region, active.ends) for k in rows}
    if any(count is None for count in counts.values()):
        reason = (
            f"{message}: how many there are is not known (no file, or it is filled or thinned out)"
        )
        report.dropped(key_path, value, f"{reason}; [[load]] impulse is that of all together")
        return
    if config.is_versagauss and condition.start_time > 0:
        report.dropped(
            key_path, value, f"{message} that is in the box then; a load keeps those of the start"
        )
        return
    if config.is_versagauss and condition.end_time - condition.start_time > condition.interval:
        report.dropped(
            key_path, value, f"{message} every {condition.interval:g} s; a load is given once"
        )
        return
    if not any(counts.values()) or condition.start_time >= config.end:
        report.dropped(key_path, value, "no particle gets it")
        return
    if not any(condition.force):
        report.dropped(key_path, value, "it pushes nothing")
        return
    for k, count in counts.items():
        if count:
            load: Table = {"object": poses[k].name, "impulse": (count * impulse).tolist()}
            if poses[k].inside(region) < 1.0:
                load["region"] = [
                    np.subtract(condition.point, condition.size),
                    np.add(condition.point, condition.size),
                ]
            active.loads.append(
                load | ({"start_time": condition.start_time} if condition.start_time else {})
            )
    report.approximated(
        key_path, value, f"{message}; here all get the same together, shared by rest volume"
    )


def _particle_count(
    config: Config, k: int, pose: BodyPose, region: Any, ends: np.ndarray
) -> int | None:
    """Return the number of their particles of a body in a region of the domain, None if unknown."""
    stand = config.bodies[k].stand
    is_thinned = config.is_versagauss and stand.scale < 0.5
    if pose.x is None or stand.particle_filling is not None or is_thinned:
        return None
    x = pose.x
    return int(np.count_nonzero(region(x) & ((x >= ends[0]) & (x <= ends[1])).all(axis=1)))
