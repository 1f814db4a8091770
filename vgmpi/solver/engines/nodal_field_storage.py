"""Nodal fields of a scene: sums and values on this rank, and contributions of particles."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial, reduce
from typing import NamedTuple

import numpy as np

from vgmpi.features.field_request import FieldRequest
from vgmpi.kernels import reproducible_sums
from vgmpi.kernels.grid.node_stages import NoStage
from vgmpi.kernels.kernel_arguments import NodeBlocks, Sums
from vgmpi.kernels.nodal_fields import (
    body_fields,
    momentum,
    stress_impulse,
    surface_distance,
    velocity_gradient,
)
from vgmpi.kernels.simd.static_dispatch import Both
from vgmpi.kernels.transfer import liquid_volume
from vgmpi.parallel.exchange_topology import (
    GRADIENTS,
    NEAR_BODIES,
    NEAR_CONTACT,
    NEAR_SURFACES,
    ExchangeTopology,
)
from vgmpi.planning.phases_and_groups import GroupPlan
from vgmpi.planning.plan import Plan
from vgmpi.runtime.aligned_arrays import aligned_zeros, with_capacity


class FieldContribution(NamedTuple):
    """Contribution of selected segments of a group to a nodal field."""

    layer: str  # name of the nodal field
    kind: tuple  # kind of contribution, see kernels/nodal_fields
    chosen: np.ndarray  # (segments,) bool, segments that contribute


class NodalField:
    """Sums and values of one nodal field at the nodes of this rank."""

    def __init__(self, name: str, sum_bounds, plan: Plan):
        """Create the field without nodes.

        Args:
            name: Name of the field.
            sum_bounds: Function of the speed [m/s] that returns the largest sums, shape
                (phases, 4); see kernels/reproducible_sums.py.
            plan: Plan of the run.
        """
        self.name, self.sum_bounds, self.real = name, sum_bounds, plan.real
        self.sums = aligned_zeros(
            (0, reproducible_sums.accumulator_words(plan.real), reproducible_sums.BLOCK), np.float64
        )
        self.nodes = aligned_zeros((0, reproducible_sums.BLOCK), plan.real)
        self.has_terms = np.zeros(0, np.uint8)
        self.speed = 0.0  # [m/s] speed that the quanta are for; 0: the sums are not reset
        self.current_bounds = np.zeros(0)  # `sum_bounds` at that speed
        self.bias = np.zeros((len(plan.phases), reproducible_sums.accumulator_words(plan.real), 16))
        self.tables = Sums(self.sums, self.bias, self.has_terms, self.nodes)

    @staticmethod
    def grow_nodes(nodes, count: int):
        """Return an array of node blocks with room for `count` of them."""
        return with_capacity(nodes, count)

    def set_topology(self, requested: np.ndarray, phase_of_row: np.ndarray) -> None:
        """Allocate node blocks, and accumulator copies of some behind them.

        Args:
            requested: Blocks that have the field, shape (n,).
            phase_of_row: Velocity field of each row of sums: blocks, then copies.
        """
        row_count = len(phase_of_row) if requested.any() else 0
        self.has_terms, self.phase = requested.astype(np.uint8), phase_of_row[:row_count]
        self.sums = with_capacity(self.sums, row_count)
        self.nodes = with_capacity(self.nodes, len(requested) if row_count else 0)
        self.nodes[:] = 0
        self.speed, self.current_bounds = 0.0, np.zeros(0)

    def begin(self, speed: float) -> None:
        """Choose the quanta of a step, and reset the sums if their bias changes.

        Args:
            speed: Power of 8 [m/s] that is not below the bound of `ParticleMaxima`.
        """
        if speed == self.speed:
            return
        self.speed, bounds = speed, self.sum_bounds(speed)
        if not np.array_equal(bounds, self.current_bounds):
            self.current_bounds, self.bias = (
                bounds,
                reproducible_sums.accumulator_biases(bounds, self.real),
            )
            reproducible_sums.reset(self.sums, self.bias, np.arange(len(self.phase)), self.phase)
            self.tables = Sums(self.sums, self.bias, self.has_terms, self.nodes)


def field_requests(plan: Plan) -> list[FieldRequest]:
    """Return the requests for all nodal fields besides momentum, offsets and impulses."""
    requests = []
    if plan.has_surface_friction:
        requests.append(
            FieldRequest(
                "shear",
                partial(momentum.accumulator_range, plan),
                lambda group: (
                    velocity_gradient.surface_kind(plan, group)
                    if group.surface and not group.carrier
                    else None
                ),
                NEAR_CONTACT,
            )
        )
    requests += [_field_near_surfaces(plan, name) for name in fields_near_colliders(plan)]
    for feature in plan.features:
        requests += feature.field_requests(plan)
    return requests


def _field_near_surfaces(plan: Plan, name: str) -> FieldRequest:
    """Return the request for a velocity gradient or the mean pressure near surfaces."""
    module = body_fields if name == "mean pressure" else momentum

    def kind(group: GroupPlan) -> tuple | None:
        """Return the contribution of a group, if any."""
        if name not in near_colliders_of_group(plan, group):
            return None
        if name == "mean pressure":
            return body_fields.mean_pressure_kind(plan)
        return velocity_gradient.kind(plan, group, GRADIENTS.index(name))

    ranges = partial(module.accumulator_range, plan)
    return FieldRequest(name, ranges, kind, NEAR_SURFACES, is_for_couplings=True)


class FieldRequests:
    """Requested nodal fields of a plan by what is done with them."""

    def __init__(self, plan: Plan):
        """Sort the requests of a plan."""
        self.plan, self.all = plan, field_requests(plan)
        self.timeless = frozenset(r.name for r in self.all if r.is_timeless)
        self.of_couplings = frozenset(r.name for r in self.all if r.is_for_couplings)
        self.carried = {r.name: r.carried for r in self.all if r.carried is not None}

    def carried_by(self, group: GroupPlan) -> list[tuple[str, int]]:
        """Return the fields whose values a group takes back, each with its first channel."""
        return [
            (request.name, request.carried.channel(group))
            for request in self.all
            if request.carried is not None and request.kind(group) is not None
        ]

    def contributions(
        self, group: GroupPlan, contributes: dict, is_timeless: bool
    ) -> list[FieldContribution]:
        """Return the contributions of a group to the fields of one sort of steps.

        Args:
            group: The group.
            contributes: Field name -> segments that contribute, (segments,) bool.
            is_timeless: Whether the fields are those of steps of no time.
        """
        return [
            FieldContribution(request.name, kind, contributes[request.name])
            for request in self.all
            if request.is_timeless == is_timeless and (kind := request.kind(group)) is not None
        ]


class NodalFields(Mapping[str, NodalField]):
    """Nodal fields of a scene by name, in the order in which grid kernels report them.

    Volumes and offsets have no nodes where nothing may touch.

    Attributes:
        words: Doubles per sum.
        requests: Requested fields of the plan.
        separates_stress: Whether stress impulses are summed separately.
        by_name: The fields.
        numbers: Number of each field.
        gathered_nodes: Auxiliary nodal values that particles gather, shape (node blocks, 256).
        stage: Kind of the stages of features, see `stage_at`.
    """

    def __init__(self, plan: Plan, field_class=NodalField):
        """Create the fields without nodes.

        Args:
            plan: Plan of the run.
            field_class: Class of the fields.
        """
        self.words = reproducible_sums.accumulator_words(plan.real)
        self.requests = FieldRequests(plan)
        self.separates_stress = any(group.separates_stress for group in plan.groups)
        ranges: dict[str, Callable] = {
            "momentum": partial(momentum.accumulator_range, plan),
            "offsets": lambda _: surface_distance.accumulator_range(plan),
        }
        if self.separates_stress:
            ranges["impulses"] = partial(stress_impulse.accumulator_range, plan)
        ranges |= {request.name: request.accumulator_range for request in self.requests.all}
        self._grow_nodes = field_class.grow_nodes
        self.by_name = {name: field_class(name, bounds, plan) for name, bounds in ranges.items()}
        self.numbers = {name: k for k, name in enumerate(self.by_name)}
        self.gathered_nodes = {
            name: aligned_zeros((0, reproducible_sums.BLOCK), plan.real)
            for feature in plan.features for name in feature.gathered
        }  # fmt: skip
        self.stage: tuple = NoStage()

    def __getitem__(self, name: str) -> NodalField:
        return self.by_name[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.by_name)

    def __len__(self) -> int:
        return len(self.by_name)

    def set_topology(self, tables: ExchangeTopology, phase_of_row: np.ndarray) -> None:
        """Allocate the nodes after a sort.

        Args:
            tables: Exchange topology of this rank.
            phase_of_row: Phase of each node block and of each copy for threads.
        """
        for name, field in self.items():
            field.set_topology(tables.has_terms[name], phase_of_row)
        for name, nodes in self.gathered_nodes.items():
            self.gathered_nodes[name] = self._grow_nodes(nodes, len(tables.phase))
        self.stage = self.stage_at(self.gathered_nodes)

    def stage_at(self, nodes: dict) -> tuple:
        """Return the kernels/grid/node_stages.py kind of all features.

        Args:
            nodes: Auxiliary nodal values by name.
        """
        stages = (feature.node_stage(nodes) for feature in self.requests.plan.features)
        kinds = [kind for kind in stages if kind is not None]
        return reduce(Both, kinds) if kinds else NoStage()

    def begin(self, speed: float) -> None:
        """Choose the quanta of a step.

        Args:
            speed: Bound of `ParticleMaxima` [m/s].
        """
        rounded_speed = reproducible_sums.quantize_speed(speed)
        for field in self.values():
            field.begin(rounded_speed)

    def finalize_for_couplings(self, blocks: NodeBlocks, overflow: np.ndarray) -> None:
        """Convert the sums that only couplings read to numbers.

        Args:
            blocks: Node blocks.
            overflow: Node block in which a sum left its range, by field (in/out).
        """
        for number, (name, field) in enumerate(self.items()):
            if name in self.requests.of_couplings:
                reproducible_sums.finalize_field(blocks, field.tables, overflow, number)


def contributions(
    requests: FieldRequests, group: GroupPlan, contributes: dict, split
) -> list[FieldContribution]:
    """Return the contributions of a group's segments to each nodal field.

    Args:
        requests: Requested fields of the run.
        group: Plan of the group.
        contributes: Field name -> segments that contribute, (segments,) bool.
        split: Segments whose stress impulse is summed separately, shape (segments,) bool.
    """
    if group.carrier:  # its particles are not on the grid
        return []
    plan = requests.plan
    full, inert = momentum.contribution_kinds(plan, group)
    result = [
        FieldContribution("momentum", inert, split | True)  # stress does not move prescribed bodies
        if group.driven
        else FieldContribution("momentum", full, ~split),
        FieldContribution("offsets", surface_distance.kind(plan, group), contributes["offsets"]),
    ]
    if group.volume.by_cells:
        result.append(FieldContribution("momentum", liquid_volume.cell_pressure_kind(plan), ~split))
    if group.separates_stress:
        result.append(FieldContribution("momentum", inert, split))
        result.append(FieldContribution("impulses", stress_impulse.kind(plan, group), split))
    result += requests.contributions(group, contributes, is_timeless=False)
    return [contribution for contribution in result if contribution.chosen.any()]


def fields_near_colliders(plan: Plan) -> tuple[str, ...]:
    """Return the names of the nodal fields that are summed near surfaces alone."""
    names = frozenset().union(*(feature.nodal_fields for feature in plan.features))
    return tuple(name for name in NEAR_BODIES if name in names)


def near_colliders_of_group(plan: Plan, group: GroupPlan) -> tuple[str, ...]:
    """Return those of these fields to which a group contributes."""
    is_read = any(feature.contributes(group.phase) for feature in plan.features)
    if group.is_carried or not is_read:
        return ()
    return fields_near_colliders(plan)


def timeless_contributions(
    requests: FieldRequests, group: GroupPlan, contributes: dict, split
) -> list[FieldContribution]:
    """Return the contributions of a group's segments in a step of no time.

    Args:
        requests, group, contributes, split: See `contributions`.
    """
    inert = momentum.contribution_kinds(requests.plan, group)[1]
    result = [FieldContribution("momentum", inert, split | True)]
    return result + requests.contributions(group, contributes, is_timeless=True)
