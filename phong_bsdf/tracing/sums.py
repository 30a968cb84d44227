"""Many samples of a pixel, added up exactly enough: in float32 as far as that bears it, then in double precision."""

import drjit as dr
import mitsuba as mi
import numpy as np

from . import films

# Tiles of a block lie this far from its corner at most, in pixels: where a sample lies in its pixel stays exact enough.
TILES_SIDE = 2048

# More samples have no place in one kernel.
MOST_LANES = 2**32


def most_summed(film, integrator) -> int:
    """How many samples of a pixel may be added up in one block, which is float32.

    With the box filter each of k additions loses up to 2^-25 of the sum, all of the same sign where all samples are
    equal: 128 lose 1.9e-6 at worst. Dr.Jit adds up the 8 or 16 neighbours in a vector first, but not where a sample
    has 2, 4, 8, ... values (RGB and its weight). The weights of other filters differ, and the losses with them: 256 and
    64 lose 2e-6 and 3e-6 in the worst pixel of 4096, and means of several lose less.
    """
    values = film.base_channels_count() + 1
    powers = {n & (n - 1) == 0 for n in (values, values + len(integrator.aov_names()))}
    neighbours_first = dr.is_jit_v(mi.Float) and True not in powers
    if film.rfilter().is_box_filter():
        return 1024 if neighbours_first else 128
    return 256 if neighbours_first else 64


class Sets:
    """Samples of a pixel by the sets that they come in: each set is added up in a tile of its own of a block, and the
    tiles in double precision."""

    def __init__(self, film):
        self.film = film
        self.width, self.height = (int(side) for side in film.crop_size())
        # Samples near the edge of one tile reach beyond it.
        self.border = 0 if film.rfilter().is_box_filter() else int(film.rfilter().border_size())
        self.across, self.down = (side + 2 * self.border for side in (self.width, self.height))
        # As many tiles as a block may have.
        self.columns, self.rows = (max(TILES_SIDE // side, 1) for side in (self.across, self.down))
        self.total = None

    @property
    def most(self) -> int:
        """How many sets a block may have."""
        return self.columns * self.rows

    def block(self, sets):
        """A block for so many sets."""
        columns = min(sets, self.columns)
        return self.film.create_block(mi.ScalarVector2u(columns * self.across, -(-sets // columns) * self.down))

    def position(self, position, number, sets):
        """Where samples of the sets `number`, of so many in a block, lie there; `position`: on the film."""
        columns = min(sets, self.columns)
        row = number // columns
        tile = mi.Vector2f(number - row * columns, row) * mi.Vector2f(self.across, self.down)
        return position - mi.Vector2f(self.film.crop_offset()) + (tile + self.border)

    def add(self, block, sets):
        """Adds up the sets of a block."""
        columns, channels, double = min(sets, self.columns), block.channel_count(), dr.float64_array_t(mi.Float)
        number = dr.arange(mi.UInt32, self.width * self.height * channels * sets)
        value = number // sets
        tile = number - value * sets
        pixel = value // channels
        x, y = pixel % self.width, pixel // self.width
        x, y = x + tile % columns * self.across + self.border, y + tile // columns * self.down + self.border
        index = (y * (columns * self.across) + x) * channels + (value - pixel * channels)
        found = dr.block_sum(double(dr.gather(mi.Float, block.tensor().array, index)), sets)
        self.total = found if self.total is None else self.total + found
        dr.eval(self.total)

    def put(self):
        """Gives the film what was added."""
        shape = self.height, self.width, dr.width(self.total) // (self.width * self.height)
        films.put_tensor(self.film, mi.TensorXf(mi.Float(self.total), shape))


def set_sums(values, part):
    """Sums over the samples of each pixel of a `camera.Part`: over several sets in double precision."""
    sums = dr.block_sum(values, part.spp)
    return sums if part.sets == 1 else dr.block_sum(dr.float64_array_t(mi.Float)(sums), part.sets)


def put_blocks(film, blocks):
    """Gives the film, of a scalar variant, the sum of blocks; a single one as it is."""
    if len(blocks) == 1:
        film.put_block(blocks[0])
        return
    total = sum(np.array(block.tensor(), np.float64) for block in blocks)
    films.put_tensor(film, mi.TensorXf(total.astype(np.float32)))


def can_render(scene, sensor, spp: int) -> bool:
    """Whether `render` can do what the scene's integrator does, with so many samples.

    In JIT variants, where it asks for the radiance along one ray of each sample and adds no channels, as most do.
    """
    integrator, film = scene.integrator(), sensor.film()
    border = 2 * int(film.rfilter().border_size()) if film.sample_border() else 0
    width, height = (int(side) + border for side in film.crop_size())
    if not dr.is_jit_v(mi.Float) or integrator.aov_names() or width * height * spp >= MOST_LANES:
        return False
    from mitsuba.python.ad.integrators.common import ADIntegrator

    if isinstance(integrator, ADIntegrator):
        return type(integrator).render is ADIntegrator.render
    # Classes of others may render in their own way.
    return type(integrator) in (mi.SamplingIntegrator, mi.MonteCarloIntegrator)


def render(scene, sensor, spp: int, seed: int):
    """What `mitsuba.render` makes of the same samples, which it has in one kernel, added up in sets."""
    from mitsuba.python.ad.integrators.common import ADIntegrator

    film, integrator = sensor.film(), scene.integrator()
    with dr.suspend_grad():
        sampler, spp = ADIntegrator.prepare(integrator, sensor, seed, spp, [])
        ray, weight, position = ADIntegrator.sample_rays(integrator, scene, sensor, sampler)
        if isinstance(integrator, ADIntegrator):
            radiance, valid, *_ = integrator.sample(
                mode=dr.ADMode.Primal, scene=scene, sampler=sampler, ray=ray, depth=mi.UInt32(0), δL=None, δaovs=None,
                state_in=None, active=mi.Bool(True),
            )  # fmt: skip
        else:
            radiance, valid, _ = integrator.sample(scene, sampler, ray, sensor.get_medium(), mi.Bool(True))
        sets = Sets(film)
        each = max(most_summed(film, integrator), -(-spp // sets.most))
        count = -(-spp // each)
        number = dr.arange(mi.UInt32, dr.width(position)) % spp // each
        block = sets.block(count)
        ADIntegrator._splat_to_block(
            block, film, sets.position(position, number, count), radiance * weight, mi.Float(1),
            dr.select(valid, mi.Float(1), mi.Float(0)), [], ray.wavelengths,
        )  # fmt: skip
        sets.add(block, count)
        sets.put()
        return film.develop()
