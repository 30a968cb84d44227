"""Scenes of Mitsuba 0.6 with `phong` load as they are, and show the values of 0.6's formula.

The camera is orthographic and the light directional, so the whole of a flat surface has one pair of directions, and
a pixel is one number. Divided by the picture of a white diffuse surface it is pi f, here computed in NumPy from the
formula: rho_d + rho_s (p + 2) / 2 (r.v)^p.
"""

import mitsuba as mi
import numpy as np
import pytest

import phong_bsdf  # noqa: F401
from phong_bsdf.pictures import images

VARIANTS = (
    "llvm_ad_rgb",
    pytest.param("scalar_rgb", marks=pytest.mark.slow),
    pytest.param("llvm_ad_spectral", marks=pytest.mark.slow),
)

# Where the light comes from, and from where the camera looks.
LIGHT, VIEW = np.array([0.3, 0.2, 1.0]), np.array([-0.2, 0.1, 1.0])

SCENE = """\
<scene version="0.6.0">
    <integrator type="direct"/>
    <sensor type="orthographic">
        <transform name="toWorld">
            <scale x="0.5" y="0.5"/>
            <lookat origin="{eye}" target="0, 0, 0" up="0, 1, 0"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="8"/> <integer name="height" value="8"/>
            <string name="pixelFormat" value="rgb"/> <string name="componentFormat" value="float32"/>
            <rfilter type="box"/>
        </film>
        <sampler type="independent"><integer name="sampleCount" value="4"/></sampler>
    </sensor>
    <emitter type="directional">
        <vector name="direction" x="{x}" y="{y}" z="{z}"/>
        <spectrum name="irradiance" value="2"/>
    </emitter>
    {objects}
    <shape type="rectangle">{transform}{surface}</shape>
</scene>
"""
WHITE = '<bsdf type="twosided"><bsdf type="diffuse"><spectrum name="reflectance" value="1"/></bsdf></bsdf>'
BLACK = '<bsdf type="diffuse"><spectrum name="reflectance" value="0"/></bsdf>'


@pytest.fixture(params=VARIANTS)
def variant(request):
    mi.set_variant(request.param)
    mi.set_log_level(mi.LogLevel.Error)
    return request.param


def unit(v):
    return v / np.linalg.norm(v)


def formula(diffuse, specular, p, n=(0.0, 0.0, 1.0), v=VIEW, light=LIGHT):
    """pi f cos / cos of the flat surface."""
    n, v, light = unit(np.array(n)), unit(v), unit(light)
    r = 2 * (n @ light) * n - light
    lobe = max(r @ v, 0.0) ** p * (p + 2) / 2
    return (np.array(diffuse) + np.array(specular) * lobe) * (n @ light) / light[2]


def render(folder, surface, *, objects="", transform="", view=VIEW):
    path = folder / "scene.xml"
    x, y, z = -LIGHT
    eye = ", ".join(map(str, 5 * unit(view)))
    path.write_text(SCENE.format(eye=eye, x=x, y=y, z=z, objects=objects, transform=transform, surface=surface))
    return np.array(mi.render(mi.load_file(str(path)), seed=0))


def ratio(folder, surface, **options):
    """The picture over that of a white surface under the same light, in the same random wavelengths."""
    white = {**options, "objects": ""}
    return render(folder, surface, **options) / render(folder, WHITE, **white)


def phong(inside, name=""):
    return f'<bsdf type="phong" {name}>{inside}</bsdf>'


GREY = (
    '<spectrum name="diffuseReflectance" value="0.4"/><spectrum name="specularReflectance" value="0.3"/>'
    '<float name="exponent" value="20"/>'
)
EXPECTED = formula(0.4, 0.3, 20)

# Float32, and the sums over wavelengths with which Mitsuba makes colours of spectra.
TOLERANCE = {"rel": 1e-3}


@pytest.mark.parametrize(
    "inside",
    [
        GREY,
        GREY.replace("spectrum", "float"),
        GREY.replace('value="0.4"', 'value="300:0.4, 900:0.4"'),
        GREY.replace('<spectrum name="specularReflectance"', '<rgb name="specularReflectance"'),
    ],
    ids=["spectra", "numbers", "wavelengths", "rgb"],
)
def test_numbers_and_spectra(variant, tmp_path, inside):
    """A grey value gives the same picture in each of the ways to write it."""
    assert ratio(tmp_path, phong(inside)) == pytest.approx(np.full((8, 8, 3), EXPECTED), **TOLERANCE)


def test_defaults(variant, tmp_path):
    """0.6's are 0.5, 0.2 and 30, once one of its names is there."""
    image = ratio(tmp_path, phong('<float name="exponent" value="30"/>'))
    assert image == pytest.approx(np.full((8, 8, 3), formula(0.5, 0.2, 30)), **TOLERANCE)


def test_rgb(variant, tmp_path):
    """Colours. In spectral variants they are spectra of the same colour, whose products have nearly that colour."""
    inside = GREY.replace(
        'spectrum name="diffuseReflectance" value="0.4"', 'rgb name="diffuseReflectance" value="0.5, 0.4, 0.3"'
    )
    expected = formula([0.5, 0.4, 0.3], [0.3] * 3, 20)
    rel = 0.15 if variant == "llvm_ad_spectral" else 2e-4
    assert ratio(tmp_path, phong(inside)).mean((0, 1)) == pytest.approx(expected, rel=rel)


@pytest.mark.parametrize("conserve", [True, False])
def test_energy_rule(variant, tmp_path, conserve):
    """Where 0.8 + 0.6 exceeds 1, both are scaled by 0.99/1.4; not where the scene says so."""
    inside = (
        '<spectrum name="diffuseReflectance" value="0.8"/><spectrum name="specularReflectance" value="0.6"/>'
        '<float name="exponent" value="20"/>'
        f'<boolean name="ensureEnergyConservation" value="{"true" if conserve else "false"}"/>'
    )
    scale = 0.99 / 1.4 if conserve else 1
    expected = scale * formula(0.8, 0.6, 20)
    assert ratio(tmp_path, phong(inside)) == pytest.approx(np.full((8, 8, 3), expected), **TOLERANCE)


def test_references(variant, tmp_path):
    """A BSDF with an id, referred to from the shape."""
    image = ratio(tmp_path, '<ref id="shiny"/>', objects=phong(GREY, 'id="shiny"'))
    assert image == pytest.approx(np.full((8, 8, 3), EXPECTED), **TOLERANCE)


def test_textures(variant, tmp_path):
    """Images for all three parameters, one of them a reference: each texel its own value.

    The camera looks straight at the middle of the square, of which a texel fills two by two pixels.
    """
    rng = np.random.default_rng(3)
    maps = {name: rng.uniform(low, high, (8, 8, 1)) for name, low, high in
            (("diffuse", 0.1, 0.6), ("specular", 0.1, 0.3), ("exponent", 5, 40))}  # fmt: skip
    for name, array in maps.items():
        images.write(tmp_path / f"{name}.exr", array)

    def bitmap(name, attributes):
        raw = '<boolean name="raw" value="true"/>'
        nearest = '<string name="filterType" value="nearest"/>'
        return (
            f'<texture type="bitmap" {attributes}><string name="filename" value="{name}.exr"/>{nearest}{raw}</texture>'
        )

    inside = (
        '<ref name="diffuseReflectance" id="map"/>'
        + bitmap("specular", 'name="specularReflectance"')
        + bitmap("exponent", 'name="exponent"')
    )
    image = ratio(tmp_path, phong(inside), objects=bitmap("diffuse", 'id="map"'), view=np.array([0.0, 0.0, 1.0]))
    # The middle half of the square. The image's first row is at v = 0, the square's lower edge.
    middle = {name: np.repeat(np.repeat(array[2:6, 2:6, 0], 2, 0), 2, 1) for name, array in maps.items()}
    expected = np.vectorize(lambda d, s, p: formula(d, s, p, v=np.array([0.0, 0.0, 1.0])))(*middle.values())
    assert image[..., 1] == pytest.approx(expected[::-1], rel=2e-3)


def test_an_8_bit_image(variant, tmp_path):
    """An image of 8 bits is decoded before the energy rule looks at it: it reflects what it shows."""
    pixels = np.full((4, 4, 3), 188, np.uint8)
    mi.Bitmap(pixels).write(str(tmp_path / "grey.png"))
    value = ((188 / 255 + 0.055) / 1.055) ** 2.4
    inside = (
        '<texture type="bitmap" name="diffuseReflectance"><string name="filename" value="grey.png"/></texture>'
        '<spectrum name="specularReflectance" value="0.3"/><float name="exponent" value="20"/>'
    )
    assert ratio(tmp_path, phong(inside)).mean() == pytest.approx(formula(value, 0.3, 20), rel=2e-3)


def test_twosided(variant, tmp_path):
    """From behind, `twosided` shows the same; alone, `phong` is black there."""
    back = '<transform name="toWorld"><rotate y="1" angle="180"/></transform>'
    image = ratio(tmp_path, f'<bsdf type="twosided">{phong(GREY)}</bsdf>', transform=back)
    assert image == pytest.approx(np.full((8, 8, 3), EXPECTED), **TOLERANCE)
    assert render(tmp_path, phong(GREY), transform=back).max() == 0


def test_mask(variant, tmp_path):
    """Opacity scales what the surface reflects."""
    surface = f'<bsdf type="mask"><spectrum name="opacity" value="0.4"/>{phong(GREY)}</bsdf>'
    assert ratio(tmp_path, surface) == pytest.approx(np.full((8, 8, 3), 0.4 * EXPECTED), **TOLERANCE)


def test_blendbsdf(variant, tmp_path):
    """The weight is that of the second BSDF."""
    surface = f'<bsdf type="blendbsdf"><float name="weight" value="0.3"/>{BLACK}{phong(GREY)}</bsdf>'
    assert ratio(tmp_path, surface) == pytest.approx(np.full((8, 8, 3), 0.3 * EXPECTED), **TOLERANCE)


def test_bumpmap(variant, tmp_path):
    """A slope in u turns the normal: the surface rises by 0.5 while x goes from -1 to 1."""
    ramp = np.broadcast_to((np.arange(64) + 0.5)[None, :, None] / 64 * 0.5, (64, 64, 1))
    images.write(tmp_path / "ramp.exr", ramp)
    texture = (
        '<texture type="bitmap"><string name="filename" value="ramp.exr"/><boolean name="raw" value="true"/></texture>'
    )
    image = ratio(tmp_path, f'<bsdf type="bumpmap">{texture}{phong(GREY)}</bsdf>')
    expected = formula(0.4, 0.3, 20, n=(-0.25, 0.0, 1.0))
    assert expected != pytest.approx(EXPECTED, rel=0.05)
    assert image == pytest.approx(np.full((8, 8, 3), expected), **TOLERANCE)
