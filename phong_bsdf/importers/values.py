"""Numbers, colours and spectra of Mitsuba 0.x, rewritten as Mitsuba 3 reads them."""

import math
import re

import numpy as np

from ..pictures import images
from .records import Journal
from .xmlfile import Node

# Range of the wavelength bins of Mitsuba 0.x, in nm.
FIRST_WAVELENGTH, LAST_WAVELENGTH = 360.0, 830.0
WAVELENGTH_STEP = 10

# SI, exact since 2019.
PLANCK, LIGHT_SPEED, BOLTZMANN = 6.62607015e-34, 299792458.0, 1.380649e-23


def numbers(text: str, node: Node) -> list[float]:
    """The finite numbers in a list that commas, semicolons or spaces separate."""
    if "$" in text:
        raise node.error(f"'{text[:60]}' is needed for the conversion: write its value in place of the parameter")
    try:
        found = [float(part) for part in re.split(r"[\s,;]+", text.strip()) if part]
    except ValueError:
        raise node.error(f"'{text[:60]}' should be numbers") from None
    if not found or not all(math.isfinite(x) for x in found):
        raise node.error(f"'{text[:60]}' should be finite numbers")
    return found


def number(node: Node) -> float:
    """The one number of a property."""
    found = numbers(node.get("value", ""), node)
    if len(found) != 1:
        raise node.error(f"'{node.get('value')}' should be one number")
    return found[0]


def color(node: Node) -> list[float] | None:
    """The linear RGB or grey value of a constant, None where it is no plain constant."""
    if node.tag in ("float", "integer", "rgb") or (node.tag == "spectrum" and node.get("value") and not node.type):
        text = node.get("value", "")
        if ":" in text or "$" in text:
            return None
        found = numbers(text, node)
        return found if len(found) in (1, 3) else None
    return None


def to_text(values) -> str:
    """Numbers as the XML holds them, to seven digits."""
    return ", ".join(f"{x:.7g}" for x in values)


def set_color(node: Node, values: list[float]) -> None:
    """Make a constant hold another grey or RGB value."""
    if len(values) == 3:
        node.tag = "rgb"
    node.set("value", to_text(values))


def refraction(reflectance: float) -> float:
    """The index of refraction, without absorption, of a surface of this reflectance at normal incidence."""
    root = math.sqrt(min(max(reflectance, 0.0), 0.999))
    return (1 + root) / (1 - root)


def rewrite_colors(context) -> None:
    """All `<srgb>`, `<rgb>`, `<spectrum>` and `<blackbody>` of a scene."""
    journal = context.journal
    for node in context.root.all():
        if node.tag in ("srgb", "rgb"):
            _rewrite_rgb(node, journal)
        elif node.tag == "spectrum" and not node.type:
            _rewrite_spectrum(node, journal)
        elif node.tag == "blackbody":
            _rewrite_blackbody(node, journal)


def _rewrite_rgb(node: Node, journal: Journal) -> None:
    text, encoded = node.get("value", "").strip(), node.tag == "srgb"
    if node.attrib.pop("intent", None):
        journal.change(node.place, f"<{node.tag}> intent", "Mitsuba 3 knows from the plugin whether it is a light")
    if "$" in text and not encoded:
        return
    rgb = _hex(text, node) if text.startswith("#") else numbers(text, node)
    if len(rgb) not in (1, 3):
        raise node.error(f"<{node.tag}> needs 1 or 3 numbers, got {len(rgb)}")
    if encoded:
        rgb = images.from_srgb(np.array(rgb)).tolist()
    new = to_text(rgb)
    if encoded or text.startswith("#"):
        what = f'<{node.tag} value="{text}"> is now <rgb value="{new}">'
        journal.change(node.place, what, "sRGB made linear" if encoded else "hexadecimal digits over 255")
    if encoded or text.startswith("#") or ";" in text:
        node.set("value", new)
    node.tag = "rgb"


def _rewrite_spectrum(node: Node, journal: Journal) -> None:
    text = node.get("value", "").strip()
    node.attrib.pop("intent", None)
    if not text or "$" in text:
        return
    if ":" in text:
        pairs = [pair for pair in re.split(r"[\s,;]+", re.sub(r"\s*:\s*", ":", text)) if pair]
        flat = [numbers(part, node) for pair in pairs for part in pair.split(":")]
        if len(flat) != 2 * len(pairs):
            raise node.error(f"'{text[:60]}' should be wavelength:value pairs")
        node.set("value", ", ".join(pairs))
        return
    values = numbers(text, node)
    if len(values) == 1:
        return
    if len(values) == 3:
        node.tag = "rgb"
        node.set("value", to_text(values))
        journal.change(node.place, f'<spectrum value="{text}"> is now <rgb>', "three values are RGB")
        return
    width = (LAST_WAVELENGTH - FIRST_WAVELENGTH) / len(values)
    pairs = [f"{FIRST_WAVELENGTH + (i + 0.5) * width:.6g}:{v:.7g}" for i, v in enumerate(values)]
    node.set("value", ", ".join(pairs))
    journal.change(node.place, f"<spectrum> of {len(values)} values", "now wavelength:value pairs from 360 to 830 nm")


def _rewrite_blackbody(node: Node, journal: Journal) -> None:
    """Planck's law at wavelengths: Mitsuba 3's own `blackbody` has no scale, and works in spectral variants only."""
    text = node.attrib.pop("temperature", node.attrib.pop("value", "")).strip()
    kelvin = numbers(text.rstrip("kK"), node)[0]
    scale = numbers(node.attrib.pop("scale", node.attrib.pop("multiplier", "1")), node)[0]
    if kelvin <= 0:
        raise node.error(f"a temperature must be above 0, got '{text}'")
    node.tag = "spectrum"
    steps = range(int(FIRST_WAVELENGTH), int(LAST_WAVELENGTH) + 1, WAVELENGTH_STEP)
    node.set("value", ", ".join(f"{nm}:{scale * planck(nm, kelvin):.7g}" for nm in steps))
    journal.change(node.place, f"<blackbody> of {text}", "now its values at wavelengths, with its scale")


def planck(nm: float, kelvin: float) -> float:
    """Radiance of a black body in W / (m^2 sr nm) at a wavelength in nm, as Mitsuba 0.6 and 3 count it."""
    metres = nm * 1e-9
    exponent = PLANCK * LIGHT_SPEED / (metres * BOLTZMANN * kelvin)
    # Beyond, exp overflows, and the radiance is 0 for all purposes.
    return 2 * PLANCK * LIGHT_SPEED**2 / metres**5 / math.expm1(exponent) * 1e-9 if exponent < 700 else 0.0


def _hex(text: str, node: Node) -> list[float]:
    if not re.fullmatch(r"#[0-9a-fA-F]{6}", text):
        raise node.error(f"'{text[:20]}' should be # and six hexadecimal digits")
    return [int(text[i : i + 2], 16) / 255 for i in (1, 3, 5)]
