"""BSDF parameters: read from the scene, checked when the scene is loaded.

A parameter is a number, an RGB colour, a spectrum or a texture; all four arrive as a
Mitsuba texture. Numbers and colours outside the legal range are errors. A texture's
values are known only at the hit, so `value` and `value_1` clamp those instead.

Mitsuba makes the objects of a scene on several threads, and a constructor in Python that
waits for one of them waits for ever. So constructors take numbers from the properties only;
what arrives as an object is looked at by `settle`, before its first use.
"""

import math
import threading

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

# Mitsuba's constant textures, by the names of their classes. They know their maximum.
CONSTANT = (
    *PLAIN, "BlackBodySpectrum", "D65Spectrum", "IrregularSpectrum", "RawConstantTexture", "RegularSpectrum"
)  # fmt: skip

# Scalar variants render on several threads, and each finds what is not settled yet.
settling = threading.RLock()


def is_recorded() -> bool:
    """Whether a loop, a call or a frozen function is being recorded."""
    return dr.is_jit_v(mi.Float) and (dr.flag(dr.JitFlag.SymbolicScope) or dr.flag(dr.JitFlag.FreezingScope))


def unrecorded(look) -> None:
    """Call `look`, which reads arrays, also while something is recorded.

    What is recorded cannot be read, but each thread records for itself: then another one looks.
    """
    if not is_recorded():
        look()
        return
    errors = []

    def elsewhere():
        try:
            look()
            # Kernels of this thread may run before those of the other have.
            dr.sync_thread()
        except Exception as error:
            errors.append(error)

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    if errors:
        raise errors[0]


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
    """One texture-valued BSDF parameter with its legal range [0, `upper`]. Making one evaluates nothing."""

    def __init__(self, props, name: str, default: float, upper: float = math.inf, largest: float = LARGEST):
        self.name = name
        self.largest = min(upper, largest)
        numbers = self._check(props, name, upper)
        self.known = self._known(props, default, numbers)
        """The channels, until the value is changed; None where they are not known from the properties."""
        # Only a colour up to 1 is a reflectance, with the spectrum that native BSDFs would give it.
        get = props.get_texture if max(numbers, default=1) <= 1 else props.get_unbounded_texture
        self.texture = get(name, default)
        self.varies = self.texture.is_spatially_varying() or self.texture.class_name() not in CONSTANT
        self._three_channels = self.varies and _has_three_channels(self.texture)
        self.plugin, self.upper = props.plugin_name(), upper
        # They stay those of the texture, also after an update.
        params = mi.traverse(self.texture)
        self.arrays = [params[key] for key in params.keys() if dr.is_jit_v(params[key])]  # noqa: SIM118
        # Of a colour in other variants than RGB: what it becomes is 0 where it is, and at most its largest channel.
        given = self.known or numbers
        self._remember(max(given) if given else None)
        self.unseen = not (self.varies or given)
        """Whether this is a constant at whose value nobody has looked yet: a spectrum, or a texture's object."""

    def settle(self) -> None:
        """Look at a value that the constructor could not look at. ValueError outside of the legal range."""
        if self.unseen:
            unrecorded(self.changed)

    def changed(self) -> None:
        """Look at the value: when it is first used, and after a change through `mi.traverse`."""
        # Neither a frozen function nor one that is differentiated can look at numbers.
        blind = self.varies or self._grad_enabled() or dr.flag(dr.JitFlag.FreezingScope)
        self.known = None
        self._remember(None if blind else self.texture.max())
        if not blind:
            self._check_constant()
        self.unseen = False

    def _remember(self, largest: float | None) -> None:
        """What follows from the value, whose largest channel this is; None where that is not known."""
        self._differentiated = self._grad_enabled()
        self._recorded = dr.flag(dr.JitFlag.FreezingScope)
        self._watch = None if self.varies or not dr.is_jit_v(mi.Float) else Watch(self.arrays)
        self._seen = self._values() if self._watch is None else None
        self._constant = None
        self._zero = largest == 0
        # Where a derivative needs what a picture does not: 0, and for mirrors 1.
        self._at_edge = self.varies or largest in (0, self.upper)

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
        elif props.type(name) == mi.Properties.Type.Spectrum and given.is_uniform():
            given = float(given.values[0])
            numbers = [given]
        elif props.type(name) == mi.Properties.Type.Spectrum and mi.is_spectral:
            # As `_check_constant` would refuse them.
            given = [float(x) for x in given.values]
            if not all(0 <= x <= self.largest for x in given):
                raise ValueError(_message(props.plugin_name(), name, upper, given))
            return []
        else:
            return []
        if not all(0 <= x <= upper and x < math.inf for x in numbers):
            raise ValueError(_message(props.plugin_name(), name, upper, given))
        if max(numbers) > self.largest:
            clamped = [min(x, self.largest) for x in numbers]
            props[name] = clamped[0] if isinstance(given, int | float) else mi.ScalarColor3f(clamped)
        return numbers

    def _known(self, props, default: float, numbers: list[float]) -> tuple[float, ...] | None:
        """The channels of a number, or of a colour in RGB, as the texture will hold them."""
        if (self.name in props and not numbers) or (len(numbers) > 1 and not mi.is_rgb):
            return None
        return tuple(mi.ScalarColor1f(min(x, self.largest))[0] for x in numbers or [default])

    def _check_constant(self) -> None:
        """Constants that arrive as a spectrum or an object, or through an update."""
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


def numbers(value) -> list[float]:
    """All numbers in an array, colour or matrix. As a whole, `numpy.array(value)` would launch a kernel for each."""
    if not dr.is_array_v(value):
        return [float(value)]
    if dr.depth_v(value) > 1:
        return [number for part in value for number in numbers(part)]
    return dr.detach(value).numpy().tolist() if dr.is_jit_v(value) else [float(number) for number in value]


def mean(value):
    """Mean over the channels of a colour or spectrum. On its way, `dr.mean` overflows where there are many lanes."""
    return dr.sum(value) / len(value)


def _message(plugin, name, upper, given) -> str:
    wanted = "finite and >= 0" if upper == math.inf else f"in [0, {upper:g}]"
    return f"{plugin}: '{name}' must be {wanted}, got {given}"


def _has_three_channels(texture) -> bool:
    """Whether a texture is a bitmap of three channels, of which `eval_1` would give the luminance, not the mean."""
    params = mi.traverse(texture)
    return "data" in params and dr.shape(params["data"])[-1] == 3
