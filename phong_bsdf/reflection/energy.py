"""The energy rule of Mitsuba 0.6: diffuse and specular reflectance together must not exceed 1.

Where the largest channel of their sum does, both are scaled by 0.99 over it. What
counts of a texture is its maximum in each channel.
"""

import itertools

import drjit as dr
import mitsuba as mi

# What is left of all light where a surface would reflect more of it.
CONSERVED = 0.99

# Scalar variants look at a texture at this many points a side, all others at each texel.
SCALAR_POINTS = 64


def scale(diffuse, specular) -> float:
    """What to multiply both `Parameter`s with; 1 where the rule is kept.

    In spectral variants the rule is checked at 16 visible wavelengths. A mesh attribute, which only the mesh
    knows, counts as 0.
    """
    first, second = _maxima(diffuse), _maxima(specular)
    channels = max(len(first), len(second))
    first, second = (m * channels if len(m) == 1 else m for m in (first, second))
    return factor(max(a + b for a, b in zip(first, second, strict=True)))


def factor(largest: float) -> float:
    """What to multiply both reflectances with where the largest channel of their sum is this."""
    # 0.4 and 0.6 in float32 are 1 and a rounding.
    return CONSERVED / largest if largest > 1 + 1e-6 else 1.0


def _maxima(parameter) -> list[float]:
    """Largest value in each channel, or at each of 16 wavelengths; one for all of them where they are alike."""
    if parameter.known:
        return list(parameter.known)
    if parameter.texture.class_name() == "MeshAttribute":
        return [0.0]
    params = mi.traverse(parameter.texture)
    # Images of 8 bits are kept as they are in the file, encoded: those are looked up.
    if "data" in params and not mi.is_spectral and dr.is_float_v(params["data"]):
        return [float(x) for x in dr.ravel(dr.max(mi.TensorXf(params["data"]), axis=(0, 1)))]
    wavelengths = [400.0 + 20 * i for i in range(16)] if mi.is_spectral else [0.0] * 4
    found = []
    for i in range(0, len(wavelengths), 4):
        values = [_channels(parameter.value(si, True)) for si in _lookups(parameter, wavelengths[i : i + 4])]
        found += [max(channel) for channel in zip(*values, strict=True)]
    return found


def _lookups(parameter, wavelengths):
    """Interactions that see the whole texture."""
    si = dr.zeros(mi.SurfaceInteraction3f)
    if mi.is_spectral:
        si.wavelengths = type(si.wavelengths)(wavelengths)
    if not parameter.varies:
        yield si
    elif dr.is_jit_v(mi.Float):
        width, height = (max(int(side), SCALAR_POINTS) for side in parameter.texture.resolution())
        index = dr.arange(mi.UInt32, width * height)
        si.uv = mi.Point2f((index % width + 0.5) / width, (index // width + 0.5) / height)
        yield si
    else:
        centres = [(i + 0.5) / SCALAR_POINTS for i in range(SCALAR_POINTS)]
        for uv in itertools.product(centres, centres):
            si.uv = mi.Point2f(*uv)
            yield si


def _channels(spectrum) -> list[float]:
    return [float(dr.max(channel)[0] if dr.is_jit_v(channel) else channel) for channel in spectrum]
