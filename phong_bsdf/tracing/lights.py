"""The delta lights of a scene as arrays: a position or a direction each, and an intensity.

A light is read through its own `sample_direction`, so that every delta emitter of
Mitsuba is served, but from a point where nothing can overflow or cancel: the falloff
1/r^2 that Mitsuba applies is never undone at the distance of the surface.
"""

import math
import operator

import drjit as dr
import mitsuba as mi

from ..reflection.parameters import Watch, channels, is_recorded, numbers
from .needs import LIGHTS, UnsupportedScene, is_delta

# So many lights at most stand in the kernel one by one; more are a loop. A loop in the loop over the
# mirrors costs as much as three lights, but its compile time does not grow with their number.
FEW = 4

# What `mi.traverse` calls the intensity of Mitsuba's delta emitters.
INTENSITIES = ("intensity.value", "irradiance.value")

# Emitters whose intensity is the same in all directions.
UNIFORM = (LIGHTS["point"], LIGHTS["directional"])


class Dark:
    """Which lights of the scene that was rendered last send nothing."""

    def __init__(self):
        self.emitters, self.watch, self.dark = [], None, set()

    def among(self, emitters) -> set[int]:
        """The numbers of those of the `emitters` whose intensity is the constant 0."""
        # What `mi.traverse` shows of a spectrum is no intensity.
        if not dr.is_jit_v(mi.Float) or mi.is_spectral or dr.flag(dr.JitFlag.FreezingScope):
            return set()
        same = len(emitters) == len(self.emitters) and all(map(operator.is_, emitters, self.emitters))
        if not same or (self.watch and self.watch.changed()):
            constants = {}
            for i, emitter in enumerate(emitters):
                params = mi.traverse(emitter)
                constants[i] = [params[key] for key in INTENSITIES if key in params]
            self.emitters, self.watch = emitters, Watch([array for arrays in constants.values() for array in arrays])
            self.dark = {i for i, arrays in constants.items() if arrays and not any(map(_shines, arrays))}
        return self.dark


class Finite:
    """Refuses lights and backgrounds that are not finite: what they light would be black, without a word."""

    def __init__(self):
        self.emitters, self.watch = [], None

    def check(self, emitters) -> None:
        """Raises `UnsupportedScene` for a NaN or infinity among what `emitters` are made of, images aside.

        Transforms are looked at once; positions and intensities also after each change.
        """
        # A function that is recorded cannot look.
        if is_recorded():
            return
        same = len(emitters) == len(self.emitters) and all(map(operator.is_, emitters, self.emitters))
        if same and self.watch and not self.watch.changed():
            return
        watched = []
        for emitter in emitters:
            params = mi.traverse(emitter)
            for key in params.keys():  # noqa: SIM118
                value = params[key]
                if dr.is_tensor_v(value) or (same and not dr.is_array_v(value)):
                    continue
                _check_finite(emitter, key, value)
                watched += [value] * dr.is_jit_v(value)
        self.emitters = emitters
        # Scalar variants hold numbers, which cannot be watched.
        self.watch = Watch([value for value in watched if dr.is_array_v(value)]) if dr.is_jit_v(mi.Float) else None


class Lights:
    """The delta lights of `scene` that send anything; `sample(i, ...)` serves the `i`-th."""

    def __init__(self, scene, dark=None, keep=frozenset()):
        emitters = scene.emitters()
        dark = set() if dark is None else dark.among(emitters)
        numbers = [i for i, emitter in enumerate(emitters) if i not in dark and is_delta(emitter)]
        self.dark, self.background = len(dark), next((i for i, e in enumerate(emitters) if not is_delta(e)), None)
        emitters = [emitters[i] for i in numbers]
        self.count = len(emitters)
        self.few = not dr.is_jit_v(mi.Float) or (self.count <= FEW and "lights" not in keep)
        self.uniform = True
        if self.count == 0:
            return
        self.any_positional = any(_positional(e) for e in emitters)
        self.any_directional = not all(_positional(e) for e in emitters)
        # Wavelengths differ from ray to ray: a spectral intensity cannot be tabulated.
        self.alike = not mi.is_spectral and all(e.class_name() in UNIFORM for e in emitters)
        self.uniform = self.alike and "light calls" not in keep

        if self.few:
            self.table = [self._read(e, _positional(e)) for e in emitters]
            self.limit = self.count
            return
        pointers, self.skip = scene.emitters_dr(), None
        if dr.flag(dr.JitFlag.FreezingScope):
            # A frozen function loses the width of a gather: loop over all, and skip the background, the only one that
            # is no light.
            self.skip = self.background
        else:
            pointers = dr.gather(type(pointers), pointers, mi.UInt32(numbers))
        # End of a loop over them; not a literal, so that their number is not part of the kernel.
        self.limit = dr.opaque(mi.UInt32, dr.width(pointers))
        self.table = self._read(pointers, mi.has_flag(pointers.flags(), mi.EmitterFlags.DeltaPosition))
        dr.eval(self.table)

    def _read(self, emitter, positional):
        """(emitter, is it at a position?, the position or the direction toward it, intensity or None)."""
        it = dr.zeros(mi.Interaction3f, 1 if self.few else dr.width(emitter))
        ds, _ = emitter.sample_direction(it, mi.Point2f(0))
        at = dr.select(positional, ds.p, mi.Point3f(ds.d))
        return emitter, positional, at, self._intensity(emitter, at, mi.Vector3f(0, 0, 1)) if self.uniform else None

    def _intensity(self, emitter, at, direction, it=None, active=True):
        """Intensity (for directional lights irradiance) sent against `direction`."""
        it = dr.zeros(mi.Interaction3f) if it is None else it
        # Far enough from the light for the difference of the positions to keep its digits, for a uniform light
        # one of them; no further, or a faint light would be lost in 1/r^2.
        reach = dr.maximum(dr.max(dr.abs(at)) * (2**-20 if self.alike else 2**-6), 1)
        it.p = at - direction * reach
        ds, weight = emitter.sample_direction(it, mi.Point2f(0), active)
        distance = dr.select(mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition), ds.dist, 1)
        return mi.unpolarized_spectrum(weight) * dr.square(distance)

    def sample(self, i, si, active):
        """Light `i` seen from `si`: (direction toward it, distance, intensity, lanes that have it).

        The direction is a unit vector in world space; the distance is infinite for directional
        lights. The intensity is the emitter's own: no falloff.
        """
        emitter, positional, at, intensity = self._entry(i)
        if not self.few and self.skip is not None:
            active = active & (i != self.skip)
        direction, distance = mi.Vector3f(at), mi.Float(dr.inf)
        if positional is True or (positional is not False and self.any_positional):
            toward = at - si.p
            length = dr.norm(toward)
            active = active & ((length > 0) | (positional == False))  # noqa: E712
            unit = toward / dr.select(length > 0, length, 1)
            mixed = positional is not True and self.any_directional
            direction = dr.select(positional, unit, direction) if mixed else unit
            distance = dr.select(positional, length, dr.inf) if mixed else length
        if intensity is None:
            it = dr.zeros(mi.Interaction3f)
            it.time, it.wavelengths = si.time, si.wavelengths
            # Where it is the same in all directions: of the direction that a table would read.
            seen = mi.Vector3f(0, 0, 1) if self.alike else direction
            intensity = self._intensity(emitter, at, seen, it, active)
        return direction, distance, intensity, active

    def _entry(self, i):
        if self.few:
            return self.table[i]
        emitter, positional, at, intensity = self.table
        return (
            dr.gather(type(emitter), emitter, i),
            dr.gather(mi.Bool, positional, i),
            dr.gather(mi.Point3f, at, i),
            None if intensity is None else dr.gather(type(intensity), intensity, i),
        )


def _positional(emitter) -> bool:
    return mi.has_flag(emitter.flags(), mi.EmitterFlags.DeltaPosition)


def _check_finite(emitter, key: str, value) -> None:
    # Any name is a swizzle of an array.
    array = value if dr.is_array_v(value) or isinstance(value, float) else value.matrix
    # The coefficients of a spectrum that is black, or white, can be infinite.
    is_bad = math.isnan if mi.is_spectral and key.endswith(".value") else lambda number: not math.isfinite(number)
    bad = [number for number in numbers(array) if is_bad(number)]
    if bad:
        name, parameter = emitter.id() or emitter.class_name(), key.split(".")[0]
        raise UnsupportedScene(f"whitted: '{parameter}' of the light '{name}' must be finite, got {bad[0]:g}")


def _shines(intensity) -> bool:
    return any(value != 0 for channel in channels(intensity) for value in channel)
