"""Old words of every user file, each with the word that replaces it; old files are still read."""

from collections.abc import Container

from .renames import Rename, RenameTable

SCENE = RenameTable(
    [
        Rename("source", "inlet"),
        Rename("sink", "outlet"),
        # domain
        Rename("domain.gravity_ramp", "gravity_ramp_time"),
        Rename("domain.boundary.floor", "bottom"),
        Rename("domain.boundary.roof", "top"),
        Rename("domain.boundary.*.until", "removal_time"),
        # appearance
        Rename("appearance.colour_transfer", "color_transfer"),
        Rename("appearance.colour_time", "color_relaxation_time"),
        Rename("appearance.colour_degree", "color_sh_degree"),
        Rename("appearance.colour_bodies", "color_objects"),
        Rename("appearance.shade", "baked_shading"),
        # accuracy
        Rename("accuracy.transfer", values={"restored": "apic-corrected"}),
        Rename("accuracy.gradient", values={"moments": "mls", "splines": "bspline"}),
        Rename("accuracy.volume", "volume_correction", {"followed": "none", "kept": "density"}),
        Rename("accuracy.damping", "flip_decay_time"),
        Rename("accuracy.flip", "flip_ratio"),
        # output
        Rename("output.checkpoint", "checkpoint_interval"),
        Rename("output.checkpoint_steps", "checkpoint_interval_steps"),
        # materials
        Rename("material.*.bulk_modulus", "tait_coefficient"),
        Rename("material.*.gamma", "tait_exponent"),
        Rename("material.*.depth", "max_depth"),
        Rename("material.*.compression", "max_compression"),
        Rename("material.*.index", "flow_index"),
        Rename("material.*.consistency", "consistency_index"),
        Rename("material.*.residual_stress", "residual_yield_stress"),
        Rename("material.*.match", "friction_angle_test"),
        Rename("material.*.hardening_limit", "max_hardening_factor"),
        Rename("material.*.hardening", "hardening_modulus", where={"kind": "metal"}),
        Rename("material.*.hardening", "hardening_coefficient", where={"kind": "snow"}),
        Rename("material.*.preset", values={"wood": "balsa"}),
        # couplings
        Rename(
            "coupling.kind",
            values={"drag-paper": "drag-versagauss", "mixing-paper": "mixing-versagauss"},
        ),
        Rename("coupling.permeability", "hydraulic_conductivity"),
        Rename("coupling.diffusion", "diffusivity"),
        Rename("coupling.slip_time", "slip_relaxation_time"),
        # objects
        Rename("object.**.colour", "color"),
        Rename("object.compressed", "initial_pressure", {"no": "zero"}),
        Rename("object.spin", "angular_velocity"),
        Rename("object.mode", "velocity_mode"),
        Rename("object.velocity_mode.wave", "wave_vector"),
        Rename("object.velocity_mode.phase", "phase_angle"),
        Rename("object.fraction", "volume_fraction"),
        Rename("object.fraction_profile", "volume_fraction_profile"),
        Rename("object.volume_fraction_profile.at", "positions"),
        Rename("object.volume_fraction_profile.share", "values"),
        Rename("object.deforms", "track_deformation"),
        Rename("object.passive", "passive_gaussians"),
        Rename("object.fill", values={"shown": "visible"}),
        Rename("object.prune", values={"paper": "versagauss"}),
        Rename("object.frozen_until", "release_time"),
        Rename(
            "object.release",
            "release_order",
            {"from below": "bottom-up", "from above": "top-down"},
        ),
        Rename("object.released_by", "release_end_time"),
        Rename("object.select.outliers", "outlier_sigma"),
        Rename("object.motion.pace", "interpolation", {"smooth": "cubic"}),
        Rename("object.motion.about", "pivot"),
        Rename("object.motion.until", "end_time"),
        Rename("object.motion.spin", "angular_velocity"),
        Rename("object.motion.keyframes.move", "translation"),
        # shapes of objects, loads and outlets
        Rename("object.shape.**.ends", "endpoints"),
        Rename("object.shape.**.torus.radius", "major_radius"),
        Rename("object.shape.**.torus.tube", "minor_radius"),
        Rename("object.shape.**.blend", "blend_radius"),
        Rename("load.region.**.ends", "endpoints"),
        Rename("load.region.**.torus.radius", "major_radius"),
        Rename("load.region.**.torus.tube", "minor_radius"),
        Rename("load.region.**.blend", "blend_radius"),
        Rename("load.**.colour", "color"),
        Rename("outlet.shape.**.ends", "endpoints"),
        Rename("outlet.shape.**.torus.radius", "major_radius"),
        Rename("outlet.shape.**.torus.tube", "minor_radius"),
        Rename("outlet.shape.**.blend", "blend_radius"),
        Rename("outlet.**.colour", "color"),
        # loads
        Rename("load.velocity", "delta_velocity"),
        Rename("load.spin", "delta_angular_velocity"),
        Rename("load.ramp", "ramp_time"),
        Rename("load.after", "start_time"),
        Rename("load.until", "end_time"),
        # inlets
        Rename("inlet.velocity", "speed"),
        Rename("inlet.rate", "mass_flow_rate"),
        Rename("inlet.flow", "volume_flow_rate"),
        Rename("inlet.start", "start_time"),
        Rename("inlet.end", "end_time"),
        Rename("inlet.colour", "color"),
        # probes
        Rename("probe.rate", "sampling_rate"),
        Rename("probe.every", "sampling_interval"),
        Rename("probe.level", "surface_height"),
        Rename("probe.wall", values={"floor": "bottom", "roof": "top"}),
    ]
)

RENDER = RenameTable(
    [
        # cameras
        Rename("camera.turns", "revolutions"),
        Rename("camera.angle", "azimuth"),
        Rename("camera.keys", "keyframes"),
        Rename("camera.keyframes.part", "progress"),
        # images
        Rename("picture.tone", "tone_mapping"),
        Rename("picture.edges", "edge_samples"),
        Rename("picture.samples", "blur_samples"),
        Rename("picture.floor.colour", "color"),
        Rename("picture.floor.tiles", "tile_size"),
        Rename("picture.floor.squares", "checker_size"),
        Rename("picture.floor.other", "checker_color"),
        # liquids
        Rename("liquid.index", "refractive_index"),
        Rename("liquid.clear", "absorption_length"),
        Rename("liquid.scatter", "scattering_coefficient"),
        Rename("liquid.fine", "cells_per_spacing"),
        Rename("liquid.walls", "clip_at_walls"),
        Rename("liquid.surroundings", "environment"),
        # appearance
        Rename("look.children", "grains_per_particle"),
        Rename("look.grain", "brightness_jitter"),
        Rename("look.harmonics", "rotate_sh", {"rotate": True, "fixed": False}),
        Rename("look.normalise", "covariance_normalization", {"deformation": "none"}),
        Rename("look.colour_transfer", "color_transfer"),
        Rename("look.colour_time", "color_relaxation_time"),
        Rename("look.colour_degree", "color_sh_degree"),
        Rename("look.colour_bodies", "color_objects"),
    ]
)

FIT = RenameTable(
    [
        Rename("parameter.start", "initial"),
        Rename("parameter.logarithmic", "scale", {True: "log", False: "linear"}),
        # targets
        Rename("target.frames", "run"),
        Rename("target.boxes", "density_bins"),
        Rename("target.hold_out", "holdout_every"),
        Rename("target.time_unit", "time_scale"),
        Rename("target.time_zero", "time_offset"),
        Rename("target.value_unit", "value_scale"),
        Rename("target.where", "filter"),
        Rename("target.camera_shift", "max_camera_shift"),
        # video models
        Rename("sds.guidance", "guidance_scale"),
        Rename("sds.draws", "noise_samples"),
        Rename("sds.times", "noise_levels"),
        Rename("sds.motion", "motion_bucket_id"),
        # methods
        Rename("method.kind", "algorithm"),
        Rename("method.runs", "max_runs"),
        Rename("method.scan", "scan_points"),
        Rename("method.step", "fd_step"),
        Rename("method.grid", "discretization_check"),
    ]
)

# attributes of checkpoints
CHECKPOINT = RenameTable(
    [
        Rename("tables", "log_checksums"),
        Rename("history", "resume_history"),
        Rename("gaussians", "gaussians_crc"),
        Rename("plan", "plan_report"),
    ]
)

# entries of `objects` in gaussians.h5
OBJECT_ENTRIES = RenameTable(
    [
        Rename("moves", "is_moving"),
        Rename("deforms", "tracks_deformation"),
        Rename("colour_set", "color_group"),
        Rename("first", "first_row"),
        Rename("count", "row_count"),
    ]
)

# datasets of frames, and columns of ledger.csv and probe_NAME.csv: old names by new ones
DATASETS = {"color_sh": "colour", "gaussians_crc": "gaussians"}
COLUMNS = {
    "particles": "count",
    "particles_in": "count_in",
    "particles_out": "count_out",
    "angular_momentum_x": "angular_x",
    "angular_momentum_y": "angular_y",
    "angular_momentum_z": "angular_z",
    "kinetic_energy": "kinetic",
    "elastic_energy": "elastic",
    "potential_energy": "potential",
    "angular_impulse_x": "swing_x",
    "angular_impulse_y": "swing_y",
    "angular_impulse_z": "swing_z",
    "cumulative_work": "all_work",
    "surface_height": "level",
}

LAYOUT = RenameTable(
    [
        Rename("masks.by", "method"),
        Rename("depth.by", "method"),
        Rename("materials.by", "method"),
        Rename("bodies.by", "method", {"form": "mask"}),
        Rename("object.clicks", "point_prompts"),
        Rename("object.form", "reconstruction"),
        Rename("object.views", "multi_view"),
    ]
)


def dataset_name(name: str, file: Container[str]) -> str:
    """Return the name that a dataset has in a file: the old one where the new one is absent."""
    old = DATASETS.get(name, name)
    return old if name not in file and old in file else name


def column_name(name: str, columns: Container[str]) -> str:
    """Return the name of a column among others: its new or old one where `name` is absent."""
    new_names = [new for new, old in COLUMNS.items() if old == name]
    names = (name, *new_names, COLUMNS.get(name, name))
    return next((column for column in names if column in columns), name)
