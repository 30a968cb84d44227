"""Camera samples at fixed positions: pixel centres, or a regular grid in each pixel."""

import math
from typing import NamedTuple

import drjit as dr
import mitsuba as mi

# So many samples at most are rendered at once: some seconds' worth, between which Ctrl-C is heard.
LANES = 2**26

# Consecutive numbers are far apart when multiplied by this, modulo 2^32: the golden ratio.
STRIDE = 0x9E3779B9

# All cells of the grid.
WHOLE = (1, (0, 0))


def grid(spp: int) -> int | None:
    """n, where `spp` samples are the centres of an n x n grid; None where a sampler chooses them."""
    n = math.isqrt(spp)
    return n if n * n == spp else None


def draws(sensor) -> bool:
    """Whether a camera needs random numbers beside the position in a pixel: for wavelengths, time or lens."""
    return mi.is_spectral or sensor.shutter_open_time() > 0 or sensor.needs_aperture_sample()


def samples_taken(sampler, spp: int) -> int:
    """Samples per pixel that a sampler takes when asked for `spp`: they round as they need. It keeps that number."""
    before = mi.log_level()
    mi.set_log_level(mi.LogLevel.Error)
    try:
        sampler.set_sample_count(spp)
    finally:
        mi.set_log_level(before)
    return int(sampler.sample_count())


class Part(NamedTuple):
    """Samples that are rendered at once: `sets` sets of `spp` samples in each of `pixels` pixels, pixel by pixel."""

    first: int
    """Number of the first pixel."""
    pixels: int
    spp: int
    number: int
    """Of the first set."""
    sets: int

    @property
    def lanes(self) -> int:
        """Number of samples."""
        return self.pixels * self.sets * self.spp

    def index(self, lane):
        """(pixel, set), both counted from the first one, of samples in the order of `lane`."""
        of_all = lane // self.spp
        pixel = of_all // self.sets
        return pixel, of_all - pixel * self.sets


class CameraSamples:
    """The samples of one rendering, numbered pixel by pixel.

    `spp` = 1 is the centre of each pixel, `spp` = n^2 the centres of an n x n grid; any other number
    is left to the film's sampler, as are wavelengths, lens and shutter where the camera has them.
    `part` = (k, (column, row)): the n x n samples are every k-th in both directions of a grid of k n x k n,
    from that column and row on. Such parts of a grid share no sample, and together they are the grid.
    `most`: more samples of a pixel come in sets of so many at most, for sums of few values each. A grid stays the same
    then, and each set is a rendering of its own to a sampler.
    """

    def __init__(self, sensor, seed: int, spp: int, part=WHOLE, most: int | None = None):
        self.sensor = sensor
        self.film = sensor.film()
        self.jit = dr.is_jit_v(mi.Float)
        self.moves = sensor.shutter_open_time() > 0
        self.has_lens = sensor.needs_aperture_sample()

        spp = spp or sensor.sampler().sample_count()
        self.grid = grid(spp)
        self.step, shift = part
        # No literals where there are several parts, which share a kernel.
        self.shift = dr.opaque(mi.Point2u, shift) if self.jit and part != WHOLE else mi.Point2u(shift)
        self.sets = -(-spp // most) if most else 1
        self.set_spp = wanted = -(-spp // self.sets)
        self.sampler = None
        if self.grid is None:
            self.sampler = sensor.sampler().clone()
            self.sampler.set_sample_count(wanted)
            # Samplers round the number as they need.
            self.set_spp = self.sampler.sample_count()
            while most and self.set_spp > most and wanted > 1:
                wanted //= 2
                self.sampler.set_sample_count(wanted)
                self.set_spp = self.sampler.sample_count()
                self.sets = -(-spp // self.set_spp)
        elif draws(sensor):
            self.sampler = mi.load_dict({"type": "independent", "sample_count": wanted})
        # The last set may be shorter.
        self.spp = spp if self.set_spp == wanted else self.sets * self.set_spp

        self.border = self.film.rfilter().border_size() if self.film.sample_border() else 0
        width, height = (int(side) + 2 * self.border for side in self.film.crop_size())
        self.width, self.pixels, self.count = width, width * height, width * height * self.spp
        self.seed = seed
        self.offset, self.size = mi.Vector2f(self.film.crop_offset()), mi.Vector2f(self.film.crop_size())
        if self.jit and dr.any(self.film.crop_size() != self.film.size()):
            # Pictures in bands are windows one after the other: no literals, or each would be another kernel.
            dr.make_opaque(self.offset, self.size)
        if self.sampler is not None and self.jit:
            self.sampler.set_samples_per_wavefront(self.set_spp)

    def all(self):
        """The rays of all samples, as `rays` has them."""
        if self.count > 2**32:
            raise ValueError(
                f"whitted: {self.pixels} pixels of {self.spp} samples are more than 2^32, too many for a derivative; "
                "use fewer samples per pixel"
            )
        return self.part_rays(Part(0, self.pixels, self.spp, 0, 1))

    def passes(self, most: int | None = None) -> list[Part]:
        """What is rendered at once: all if the samples are few enough, and `most` sets at most."""
        pixels = min(max(LANES // self.set_spp, 1), self.pixels)
        sets = min(max(LANES // (self.set_spp * pixels), 1), self.sets, most or self.sets)
        return [
            Part(first, min(pixels, self.pixels - first), self.set_spp, number, min(sets, self.sets - number))
            for number in range(0, self.sets, sets)
            for first in range(0, self.pixels, pixels)
        ]

    def part_rays(self, part: Part):
        """In JIT variants: the samples of a part, as `rays` has them."""
        if self.sampler is not None:
            other = part.first + part.number * self.pixels
            self.sampler.seed(mi.UInt32(self.seed) + (other * STRIDE) % 2**32, part.lanes)
        lane = dr.arange(mi.UInt32, part.lanes)
        if self.sets > 1:
            pixel, _ = part.index(lane)
            sample = lane - pixel * (part.sets * part.spp) + dr.opaque(mi.UInt32, part.number * part.spp)
            return self._rays(dr.opaque(mi.UInt32, part.first) + pixel, sample)
        pixel = lane // part.spp
        # Not a literal where there are several passes, which share a kernel.
        first = part.first if part.pixels == self.pixels else dr.opaque(mi.UInt32, part.first)
        return self._rays(first + pixel, lane - pixel * part.spp)

    def counts(self, part: Part):
        """Which samples of a part there are: the last set may be shorter than the others."""
        if (part.number + part.sets) * part.spp <= self.spp:
            return True
        pixel, _ = part.index(lane := dr.arange(mi.UInt32, part.lanes))
        return lane - pixel * (part.sets * part.spp) < self.spp - part.number * part.spp

    def rays(self, index):
        """(rays, weights, positions on the film in pixels) of the sample number `index`, in scalar variants."""
        pixel = index // self.spp
        return self._rays(pixel, index - pixel * self.spp)

    def _rays(self, pixel, sample):
        if self.sampler is not None and not self.jit:
            # A sampler knows the samples of one pixel; some never return when asked for more.
            if sample % self.set_spp == 0:
                number = sample // self.set_spp * self.pixels + pixel
                self.sampler.seed((self.seed * self.count + number) % 2**32, 1)
            else:
                self.sampler.advance()
        y = pixel // self.width
        corner = mi.Point2f(pixel - y * self.width, y) + (self.offset - self.border)
        if self.grid is None:
            inside = self.sampler.next_2d()
        else:
            row = sample // self.grid
            cell = mi.Point2u(sample - row * self.grid, row) * self.step + self.shift
            inside = (mi.Point2f(cell) + 0.5) / (self.grid * self.step)
        position = corner + inside

        time = self.sensor.shutter_open()
        if self.moves:
            time += self.sampler.next_1d() * self.sensor.shutter_open_time()
        wavelength = self.sampler.next_1d() if mi.is_spectral else 0
        lens = self.sampler.next_2d() if self.has_lens else mi.Point2f(0.5)
        # The camera may be what is differentiated.
        with dr.resume_grad():
            ray, weight = self.sensor.sample_ray_differential(
                time=time, sample1=wavelength, sample2=(position - self.offset) / self.size, sample3=lens
            )
        # The box filter needs to know the pixel only, and no rounding may miss it.
        return ray, weight, corner + 0.5 if self.film.rfilter().is_box_filter() else position
