"""Render model of an exported file, which has one for all its Gaussians."""

import numpy as np

from vgmpi.gaussians.capture_conventions import RenderModel


def is_capture(run, objects: list[dict]) -> np.ndarray:
    """Return whether each object's Gaussians come from a file, (objects,).

    Such Gaussians hold the light of a photograph.
    """
    try:
        files = {o.get("name"): o.get("gaussians") for o in run.scene.get("object", ())}
    except (AttributeError, TypeError):
        files = {}
    return np.array([bool(files.get(entry.get("name"))) for entry in objects] or [False])


def file_render_model(run, scenery: bool = True) -> tuple[RenderModel, str]:
    """Return the render model of most Gaussians of captures, and text on objects that differ.

    The Gaussians of shapes and meshes are as wide as a particle and look nearly the same by any.

    Args:
        run: Files of the run.
        scenery: Whether scenery belongs to the file.
    """
    objects = run.objects
    models: list[RenderModel] = [entry.get("render_model", "classic") for entry in objects]
    if all(model == "classic" for model in models):
        return "classic", ""
    gaussians = run.gaussians
    count = np.zeros(len(objects), dtype=np.int64)
    for part in (
        gaussians,
        getattr(gaussians, "scenery", None) if scenery else None,
        gaussians.passive,
    ):
        if part is not None:
            is_drawn = np.asarray(part.opacity) > 0
            count += np.bincount(np.asarray(part.object)[is_drawn], minlength=len(objects))
    votes = dict.fromkeys(models, 0)
    for model, n, captured in zip(models, count, is_capture(run, objects)):
        votes[model] += int(n) if captured else 0
    chosen = max(votes, key=lambda model: votes[model])
    differing = [
        f"{entry.get('name')} ({n:,} Gaussians, {model})"
        for entry, model, n in zip(objects, models, count)
        if model != chosen and n
    ]
    if not differing:
        return chosen, ""
    text = f"a file has one render model: written is {chosen}, that of most Gaussians of captures"
    return chosen, f"{text}; drawn otherwise: {', '.join(differing)}"
