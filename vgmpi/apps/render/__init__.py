"""Commands of the renderer: postprocess/ of a checkout, which an installed package holds here."""

from pathlib import Path

_CHECKOUT = Path(__file__).resolve().parents[3] / "postprocess"
if _CHECKOUT.is_dir():
    __path__.append(str(_CHECKOUT))
