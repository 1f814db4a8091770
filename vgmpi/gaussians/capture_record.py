"""Facts about a capture that its reader learned of the file, told by inspect, check and runs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class CaptureRecord:
    """Facts about the file that a cloud was read from.

    Attributes:
        encoding: Format and version, such as ".spz, version 4".
        frame: Directions of x, y and z of the file, such as "RDF" (right, down, forward); empty
            if the file does not say. A reader returns the numbers as they are, and the registry
            turns the cloud to RDF.
        frame_source: Why this frame was taken, as a clause; empty if nothing was to be decided.
        render_model_source: Why the Gaussians count as antialiased or not, as a clause; empty if
            the file does not say.
        has_filter_3d: Whether sizes and opacities contain the 3D filter of the file.
        comments: Comments of the file that a user may want to see, such as its vertical axis.
        doubts: Doubts about the values, each one clause that names the columns.
        omissions: What the file holds and the reader left out, each one clause.
    """

    encoding: str
    frame: str = ""
    frame_source: str = ""
    render_model_source: str = ""
    has_filter_3d: bool = False
    comments: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    omissions: tuple[str, ...] = ()
