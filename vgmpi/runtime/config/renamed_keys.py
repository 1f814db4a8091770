"""Old words of every user file, each with the word that replaces it; old files are still read."""

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

RENDER = RenameTable([Rename("picture.colour", "color")])

FIT = RenameTable()

LAYOUT = RenameTable()
