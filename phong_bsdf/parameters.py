"""BSDF parameters: read from the scene, checked when the scene is loaded.

A parameter is a number, an RGB colour, a spectrum or a texture; all four arrive as a
Mitsuba texture. Numbers and colours outside the legal range are errors. A texture's
values are known only at the hit, so `value` and `value_1` clamp those instead.
"""

import math

import drjit as dr
import mitsuba as mi

# Beyond, a finite number counts as this, so that no sum or product with it overflows: three
# channels can still be added, and a sample's weight is at most nine times it.
LARGEST = 1e37

# Integrators drop what has the weight 0, and its derivative with it. So a 0 that is differentiated
# counts as this, which no float32 picture shows.
FAINT = 1e-15

# An exponent beyond counts as this: its highlight is smaller than what float32 directions resolve.
LARGEST_EXPONENT = 1e15

# Constant textures whose value is the array that they hold, in variants that render RGB.
PLAIN = ("UniformSpectrum", "SRGBReflectanceSpectrum")


class Watch:
    """Notices that some of the arrays of Mitsuba's objects, through `mi.traverse`, hold something else than before."""

    def __init__(self, arrays):
        self._arrays = arrays
        self._seen = self._numbers()
        # While they are kept, no other array gets their number.
        self._kept = [dr.detach(array) for array in arrays]

    def changed(self) -> bool:
        """Whether any was changed since."""
        return self._numbers() != self._seen

    def _numbers(self):
        return [channel.index for array in self._arrays for channel in channels(array)]


class Parameter:
    """One texture-valued BSDF parameter with its legal range [0, `upper`]."""

    def __init__(self, props, name: str, default: float, upper: float = math.inf, largest: float = LARGEST):
        self.name = name
        self.largest = min(upper, largest)
        numbers = self._check(props, name, upper)
        # Only a colour up to 1 is a reflectance, with the spectrum that native BSDFs would give it.
        get = props.get_texture if max(numbers, default=1) <= 1 else props.get_unbounded_texture
        self.texture = get(name, default)
        self.varies = self.texture.is_spatially_varying() or not _has_maximum(self.texture)
        self._three_channels = self.varies and _has_three_channels(self.texture)
        self.plugin, self.upper = props.plugin_name(), upper
        # They stay those of the texture, also after an update.
        params = mi.traverse(self.texture)
        self.arrays = [params[key] for key in params.keys() if dr.is_jit_v(params[key])]  # noqa: SIM118
        self.changed()

    def changed(self) -> None:
        """Look at the value: when the scene is loaded, and after a change through `mi.traverse`."""
        self._differentiated = self._grad_enabled()
        # Neither a frozen function nor one that is differentiated can look at numbers.
        blind = self.varies or self._differentiated or dr.flag(dr.JitFlag.FreezingScope)
        self._recorded = dr.flag(dr.JitFlag.FreezingScope)
        self._watch = None if self.varies or not dr.is_jit_v(mi.Float) else Watch(self.arrays)
        self._seen = self._values() if self._watch is None else None
        self._constant = None
        largest = None if blind else self.texture.max()
        self._zero = largest == 0
        # Where a derivative needs what a picture does not: 0, and for mirrors 1.
        self._at_edge = self.varies or largest in (0, self.upper)
        if not blind:
            self._check_constant()

    def changed_by(self, keys) -> None:
        """Look again after an update of `keys`, which may name a texture by its id instead of the parameter."""
        # A frozen function must not take another shape than what it recorded.
        if self.name in keys or not dr.flag(dr.JitFlag.FreezingScope):
            self.changed()

    @property
    def left_out(self) -> bool:
        """Whether the parameter is the constant 0, and not being differentiated: what it scales is left out."""
        if self._zero and self._is_outdated():
            self._zero = False
        return self._zero and not self.differentiated

    def refresh(self) -> bool:
        """Look again if the value was changed behind this BSDF's back; whether it was.

        Mitsuba tells one BSDF only of a change of a texture that several share.
        """
        outdated = self._is_outdated()
        if outdated:
            self.changed()
        return outdated

    def _is_outdated(self) -> bool:
        if self.varies or dr.flag(dr.JitFlag.FreezingScope):
            return False
        return self._values() != self._seen if self._watch is None else self._watch.changed()

    def _values(self) -> tuple:
        """In scalar variants: the constant."""
        params = mi.traverse(self.texture)
        return () if self.varies else tuple(str(params[key]) for key in params.keys())  # noqa: SIM118

    @property
    def differentiated(self) -> bool:
        """Whether derivatives with respect to the parameter are asked for, since `mi.traverse` last changed it.

        It stays true: integrators that work in two passes differentiate in one of them only, and
        both must sample the same way.
        """
        if self._at_edge and not self._differentiated:
            self._differentiated = self._grad_enabled()
        return self._differentiated

    def _grad_enabled(self) -> bool:
        return any(dr.grad_enabled(array) for array in self.arrays)

    def constant(self) -> tuple[float, ...] | None:
        """The value as numbers, one for each channel; None where it varies, is differentiated, or changes unseen."""
        # A frozen function that changes the value does so without a call when it is replayed.
        self.refresh()
        if self.varies or self.differentiated or self._recorded:
            return None
        if self._constant is None:
            # Most constants are the array that holds them; to evaluate a thousand would launch a kernel for each.
            plain = self.texture.class_name() in PLAIN and len(self.arrays) == 1 and not mi.is_spectral
            value = self.arrays[0] if plain else self.texture.eval(dr.zeros(mi.SurfaceInteraction3f))
            self._constant = tuple(channel[0] for channel in channels(value))
        return self._constant

    def value(self, si, active):
        """The value at `si`, a spectrum; textures clamped to the legal range."""
        value = self._clamp(self.texture.eval(si, active))
        # It may be 0: what is differentiated is not looked at.
        return value + FAINT if self.differentiated else value

    def mean(self, si, active):
        """The mean of `value` over the channels, for probabilities: no sum or product with it overflows."""
        value = mean(self.value(si, active))
        # A constant that is differentiated is not looked at.
        return dr.minimum(value, LARGEST) if self.differentiated else value

    def value_1(self, si, active):
        """The value at `si` as one number: the mean over the channels; textures clamped to the legal range."""
        if self._three_channels:
            return self._clamp(mean(self.texture.eval_3(si, active)))
        return self._clamp(self.texture.eval_1(si, active))

    def _clamp(self, value):
        if not self.varies:
            return value
        # fmax and fmin also turn a texture's NaN into a number.
        clamped = dr.fmin(dr.fmax(value, 0), self.largest)
        if not self.differentiated:
            return clamped
        # At the ends of the range they have no derivative. What is interpolated exceeds 1 by a rounding or two.
        inside = (value >= 0) & (value <= self.largest * (1 + 1e-6))
        return dr.replace_grad(clamped, dr.select(inside, value, clamped))

    def _check(self, props, name: str, upper: float) -> list[float]:
        """The number or colour that was given, if it was."""
        if name not in props:
            return []
        given = props[name]
        if isinstance(given, bool | str):
            numbers = [math.nan]
        elif isinstance(given, int | float):
            numbers = [float(given)]
        elif props.type(name) == mi.Properties.Type.Color:
            numbers = [float(c) for c in given]
        else:
            return []
        if not all(0 <= x <= upper and x < math.inf for x in numbers):
            raise ValueError(_message(props.plugin_name(), name, upper, given))
        if max(numbers) > self.largest:
            clamped = [min(x, self.largest) for x in numbers]
            props[name] = clamped[0] if isinstance(given, int | float) else mi.ScalarColor3f(clamped)
        return numbers

    def _check_constant(self) -> None:
        """Constants that arrive as a spectrum, or through an update."""
        params = mi.traverse(self.texture)
        if "value" in params and mi.is_spectral and self.texture.class_name() != "UniformSpectrum":
            return  # Coefficients of a model of spectra, made from a colour that was checked.
        for key in {"value", "values"} & set(params.keys()):
            numbers = [float(x) for x in dr.ravel(params[key])] if dr.is_array_v(params[key]) else [params[key]]
            if not all(0 <= x <= self.largest for x in numbers):
                given = numbers[0] if len(numbers) == 1 else numbers
                raise ValueError(_message(self.plugin, self.name, self.upper, given))


def channels(array) -> list:
    """The one-dimensional arrays that make up a number, colour, spectrum or tensor."""
    if dr.is_tensor_v(array):
        return [array.array]
    return [array] if dr.depth_v(array) == 1 else list(array)


def mean(value):
    """Mean over the channels of a colour or spectrum. On its way, `dr.mean` overflows where there are many lanes."""
    return dr.sum(value) / len(value)


def _message(plugin, name, upper, given) -> str:
    wanted = "finite and >= 0" if upper == math.inf else f"in [0, {upper:g}]"
    return f"{plugin}: '{name}' must be {wanted}, got {given}"


def _has_maximum(texture) -> bool:
    """Whether a texture is one of Mitsuba's constants, which know their maximum."""
    try:
        texture.max()
    except RuntimeError:
        return False
    return True


def _has_three_channels(texture) -> bool:
    """Whether a texture is a bitmap of three channels, of which `eval_1` would give the luminance, not the mean."""
    params = mi.traverse(texture)
    return "data" in params and dr.shape(params["data"])[-1] == 3
