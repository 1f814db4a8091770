"""Lines of --plan on free rigid bodies, and warnings of what they cannot do well."""

from vgmpi.planning.plan import Plan
from vgmpi.planning.rigid_bodies import MIN_THICKNESS_CELLS, RigidBodySummary, is_thin
from vgmpi.runtime.config.toml_source import escape_control_characters
from vgmpi.scene.scene import Scene

MAX_LINES = 8  # bodies that have a line each; more have one together
MIN_DENSITY_RATIO = 0.01  # [-] to what a body meets, below which none was tested


def rigid_body_lines(scene: Scene, plan: Plan) -> list[str]:
    """Return the lines of --plan on the free rigid bodies of a scene.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    density = {obj.name: obj.free_body.density for obj in scene.object if obj.free_body}
    if not density:
        return []
    if plan.rigid is None:
        return [f"  rigid       {_listing(list(density))}: free bodies without particles"]
    bodies = plan.rigid.bodies
    liquids = {group.material: group.density for group in plan.groups if group.is_liquid}
    if len(bodies) > MAX_LINES:
        lines = [_summary_line(bodies, plan.dx)]
    else:
        lines = [_body_line(body, density[body.name], liquids, plan.dx) for body in bodies]
    return lines


def _listing(names: list[str]) -> str:
    """Return names with commas between them; the first ones of many."""
    more = f" and {len(names) - MAX_LINES} more" if len(names) > MAX_LINES else ""
    return ", ".join(map(escape_control_characters, names[:MAX_LINES])) + more


def _body_line(body: RigidBodySummary, density: float, liquids: dict[str, float], dx: float) -> str:
    """Return the line on one body.

    Args:
        body: The body.
        density: Its density [kg/m3].
        liquids: Density of each liquid of the scene [kg/m3].
        dx: Cell size [m].
    """
    ratios = "".join(
        f", {density / other:.3g} times the density of {escape_control_characters(name)}"
        for name, other in liquids.items()
    )
    return (
        f"  rigid       {escape_control_characters(body.name)}: {body.mass:.4g} kg{ratios},"
        f" {body.thickness / dx:.1f} cells thick, {body.points:,} surface points,"
        f" {body.bytes / 2**20:.2g} MiB of distances per rank"
    )


def _summary_line(bodies: tuple[RigidBodySummary, ...], dx: float) -> str:
    """Return the line on many bodies."""
    masses, cells = (sorted(values) for values in (
        [body.mass for body in bodies], [body.thickness / dx for body in bodies]
    ))  # fmt: skip
    return (
        f"  rigid       {len(bodies):,} bodies of {masses[0]:.4g} to {masses[-1]:.4g} kg,"
        f" {cells[0]:.1f} to {cells[-1]:.1f} cells thick,"
        f" {sum(body.points for body in bodies):,} surface points,"
        f" {sum(body.bytes for body in bodies) / 2**20:.2g} MiB of distances per rank"
    )


def rigid_body_warnings(scene: Scene, plan: Plan) -> list[str]:
    """Return a line on bodies that are thin, light, or overlap something at the start.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    density = {obj.name: obj.free_body.density for obj in scene.object if obj.free_body}
    if not density or plan.rigid is None:
        return []
    lines = []
    thin = [body.name for body in plan.rigid.bodies if is_thin(body.thickness, plan.dx)]
    if thin:
        lines.append(
            f"{_listing(thin)}: rigid and thinner than {MIN_THICKNESS_CELLS:g} cells:"
            " what flows may pass through"
        )
    heaviest = max(group.density for group in plan.groups)
    light = [name for name, value in density.items() if value < MIN_DENSITY_RATIO * heaviest]
    if light:
        lines.append(
            f"{_listing(light)}: rigid and lighter than {MIN_DENSITY_RATIO:g} of the"
            f" heaviest that it may meet, {heaviest:g} kg/m3: not tested"
        )
    joined = {frozenset(joint.between) for joint in plan.joints if joint.kind != "spring"}
    overlaps = [o for o in plan.rigid.overlaps if frozenset((o.name, o.other)) not in joined]
    for pair in overlaps[:MAX_LINES]:
        names = map(escape_control_characters, (pair.name, pair.other))
        lines.append(
            f"{' and '.join(names)} overlap at the start by"
            f" {pair.depth / plan.dx:.2g} cells ({pair.depth:.3g} m):"
            " they are pushed apart slowly"
        )
    if len(overlaps) > MAX_LINES:
        lines.append(f"{len(overlaps) - MAX_LINES} more pairs overlap less")
    return lines
