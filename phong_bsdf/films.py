"""Pictures and films: which are no more than their pixels, and how samples become them."""

import drjit as dr
import mitsuba as mi
import numpy as np

# Tiles of a block lie this far from its corner at most, in pixels: where a sample lies in its pixel stays exact enough.
TILES_SIDE = 1024


def is_plain(film) -> bool:
    """Whether a picture of this film is its pixels: RGB or RGBA, the box filter, no film with channels of its own."""
    special = mi.has_flag(film.flags(), mi.FilmFlags.Special) or mi.is_spectral or mi.is_monochromatic
    return not special and film.rfilter().is_box_filter() and "pixel_format = rgb" in str(film)


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


def channels(film, integrator) -> tuple[str, ...]:
    """Names of the channels of pictures that `integrator` makes with this film, as Mitsuba names them in files.

    ValueError where nobody can tell.
    """
    added = list(integrator.aov_names())
    if integrator.class_name() != "AOVIntegrator":
        return (*_film_channels(film), *added)
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError("Mitsuba mixes up the channels of an integrator 'aov' with the bands of this film; use a 'hdrfilm'")
    # The pictures of the integrators inside come first, as the film has colours, but are announced as R, G, B, A.
    inside = [name[:-2] for name in added if name.endswith(".A")]
    if any("." in name for name in inside):
        raise ValueError("an integrator 'aov' inside of another one gives channels that have no names; use one")
    announced = {f"{name}.{channel}" for name in inside for channel in "RGBA"}
    base = _film_channels(film)
    pictures = [name if i == 0 else f"{inside[i]}.{name}" for i in range(len(inside)) for name in base]
    return (*pictures, *(name for name in added if name not in announced))


def _film_channels(film) -> list[str]:
    formats = [name for name in ("y", "ya", "rgb", "rgba", "xyz", "xyza") if f"pixel_format = {name}," in str(film)]
    if formats:
        return list(formats[0].upper())
    # Bands, or whatever else the film says when it is asked for a picture.
    film.prepare([])
    return [field.name for field in film.bitmap().struct_()]


def channel_count(film) -> int:
    """How many channels the picture of a plain film has."""
    return 4 if mi.has_flag(film.flags(), mi.FilmFlags.Alpha) else 3


def gradient_of_samples(gradient, channels, part, spp):
    """The gradient of each sample of a `camera.Part`, of `spp` in all, given those of the picture's values."""
    pixel = dr.opaque(mi.UInt32, part.first) + dr.arange(mi.UInt32, part.lanes) // (part.spp * part.sets)
    return mi.Color3f(*(dr.gather(mi.Float, gradient, channels * pixel + i) for i in range(3))) / spp


def set_sums(values, part):
    """Sums over the samples of each pixel of a `camera.Part`: over several sets in double precision."""
    sums = dr.block_sum(values, part.spp)
    return sums if part.sets == 1 else dr.block_sum(dr.float64_array_t(mi.Float)(sums), part.sets)


def picture(film, channels):
    """The tensor of a plain film's size whose channels are these, one value for each pixel."""
    width, height = (int(side) for side in film.crop_size())
    n = len(channels)
    return mi.TensorXf(dr.ravel((mi.Vector4f if n == 4 else mi.Vector3f)(*channels)), (height, width, n))


def store(film, channels):
    """The picture of one value for each pixel and channel. The film gets it, too, but in a form that costs nothing
    until somebody develops the film."""
    width, height = (int(side) for side in film.crop_size())
    n = len(channels)
    channels[0] = channels[0] + dr.zeros(mi.Float, width * height)
    image = picture(film, channels)
    index = dr.arange(mi.UInt32, width * height * (n + 1))
    pixel = index // (n + 1)
    channel = index - pixel * (n + 1)
    weighted = dr.select(channel < n, dr.gather(mi.Float, image.array, pixel * n + channel, channel < n), 1)
    put_tensor(film, mi.TensorXf(weighted, (height, width, n + 1)))
    return image


def splat(block, film, position, value, wavelengths, valid):
    """Adds one sample of a scalar variant to `block`."""
    value = mi.unpolarized_spectrum(value)
    alpha = float(valid)
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        block.put(position, film.prepare_sample(value, wavelengths, block.channel_count(), weight=1, alpha=alpha))
        return
    rgb = mi.spectrum_to_srgb(value, wavelengths) if mi.is_spectral else mi.Color3f(value)
    channels = [*rgb, alpha] if mi.has_flag(film.flags(), mi.FilmFlags.Alpha) else [*rgb]
    block.put(position, [*channels, 1.0])


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
        put_tensor(self.film, mi.TensorXf(mi.Float(self.total), shape))


def put_tensor(film, tensor):
    """Gives the film a block of these values, (height, width, channels and weight)."""
    film.put_block(mi.ImageBlock(tensor, mi.ScalarPoint2i(film.crop_offset())))


def put_blocks(film, blocks):
    """Gives the film, of a scalar variant, the sum of blocks; a single one as it is."""
    if len(blocks) == 1:
        film.put_block(blocks[0])
        return
    total = sum(np.array(block.tensor(), np.float64) for block in blocks)
    put_tensor(film, mi.TensorXf(total.astype(np.float32)))
