"""Pictures and films: which are no more than their pixels, and how samples become them."""

import drjit as dr
import mitsuba as mi


def is_plain(film) -> bool:
    """Whether a picture of this film is its pixels: RGB or RGBA, the box filter, no film with channels of its own."""
    special = mi.has_flag(film.flags(), mi.FilmFlags.Special) or mi.is_spectral or mi.is_monochromatic
    return not special and film.rfilter().is_box_filter() and "pixel_format = rgb" in str(film)


def channels(film, integrator) -> tuple[str, ...]:
    """Names of the channels of pictures that `integrator` makes with this film, as Mitsuba names them in files.

    ValueError where nobody can tell.
    """
    added = list(integrator.aov_names())
    if integrator.class_name() != "AOVIntegrator":
        return (*_film_channels(film), *added)
    if mi.has_flag(film.flags(), mi.FilmFlags.Special):
        raise ValueError("Mitsuba mixes up the channels of an integrator 'aov' with the bands of this film; use a "
                         "'hdrfilm'")  # fmt: skip
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


def put_tensor(film, tensor):
    """Gives the film a block of these values, (height, width, channels and weight)."""
    film.put_block(mi.ImageBlock(tensor, mi.ScalarPoint2i(film.crop_offset())))
