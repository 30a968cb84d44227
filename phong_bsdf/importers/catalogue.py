"""The plugins of Mitsuba 3.9 and of this package that old scenes can end in, and the parameters that each reads.

Mitsuba refuses a parameter that nothing reads, so what is not listed here is left out of the new scene, and noted.
"""

from ..reflection.vocabulary import COEFFICIENTS, ENERGY, REFLECTANCES
from .context import Context

_TRANSFORM = "to_world"
_TEXTURE = "filename wrap_mode filter_type raw to_uv format accel"
_INTEGRATOR = "block_size samples_per_pass timeout hide_emitters"
_PATH = f"max_depth rr_depth {_INTEGRATOR}"
_CAMERA = f"{_TRANSFORM} near_clip far_clip shutter_open shutter_close srf"
_VIEW = "fov focal_length fov_axis"
_PERSPECTIVE = f"{_CAMERA} {_VIEW} principal_point_offset_x principal_point_offset_y"
_GLASS = "int_ior ext_ior specular_reflectance specular_transmittance"
_ROUGH = "distribution alpha alpha_u alpha_v sample_visible"
_LOBE = " ".join([*COEFFICIENTS, *REFLECTANCES, ENERGY, "sampling"])
_SHAPE = f"{_TRANSFORM} flip_normals silhouette_sampling_weight"
_MESH = f"{_SHAPE} filename face_normals flip_tex_coords"
_GRID = f"{_TRANSFORM} filename grid use_grid_bbox max_value filter_type wrap_mode raw accel"

# tag -> plugin -> parameters
PLUGINS = {
    "integrator": {
        "path": _PATH, "volpath": _PATH, "volpathmis": f"{_PATH} use_spectral_mis",
        "ptracer": "max_depth rr_depth samples_per_pass timeout hide_emitters",
        "direct": f"shading_samples emitter_samples bsdf_samples {_INTEGRATOR}",
        "aov": f"aovs {_INTEGRATOR}", "moment": _INTEGRATOR,
        "whitted": "convention max_depth shadows ambient hide_emitters specialize",
    },
    "sampler": {
        "independent": "sample_count seed", "ldsampler": "sample_count seed",
        "stratified": "sample_count seed jitter", "multijitter": "sample_count seed jitter",
        "orthogonal": "sample_count seed jitter strength",
    },
    "film": {
        "hdrfilm": "width height crop_width crop_height crop_offset_x crop_offset_y sample_border file_format "
                   "pixel_format component_format compensate",
    },
    "rfilter": {
        "box": "", "tent": "radius", "gaussian": "stddev", "mitchell": "B C", "catmullrom": "", "lanczos": "lobes",
    },
    "sensor": {
        "perspective": _PERSPECTIVE, "thinlens": f"{_CAMERA} {_VIEW} aperture_radius focus_distance",
        "orthographic": _CAMERA, "radiancemeter": f"{_TRANSFORM} origin direction srf shutter_open shutter_close",
        "irradiancemeter": "srf shutter_open shutter_close",
    },
    "emitter": {
        "area": "radiance sampling_weight", "constant": "radiance sampling_weight",
        "point": f"position intensity sampling_weight {_TRANSFORM}",
        "spot": f"intensity cutoff_angle beam_width texture sampling_weight {_TRANSFORM}",
        "directional": f"direction irradiance sampling_weight {_TRANSFORM}",
        "envmap": f"filename scale sampling_weight mis_compensation {_TRANSFORM}",
        "projector": f"irradiance scale fov fov_axis sampling_weight {_TRANSFORM}",
        "sunsky": "turbidity albedo latitude longitude timezone year month day hour minute second sun_direction "
                  f"sun_scale sky_scale sun_aperture complex_sun sampling_weight {_TRANSFORM}",
    },
    "shape": {
        "sphere": f"{_SHAPE} center radius", "cylinder": f"{_SHAPE} p0 p1 radius", "rectangle": _SHAPE, "disk": _SHAPE,
        "cube": _SHAPE, "obj": _MESH, "ply": _MESH, "serialized": f"{_MESH} shape_index",
        "shapegroup": "", "instance": _TRANSFORM, "bsplinecurve": f"{_TRANSFORM} filename",
        "linearcurve": f"{_TRANSFORM} filename",
    },
    "bsdf": {
        "diffuse": "reflectance", "dielectric": _GLASS, "thindielectric": _GLASS,
        "roughdielectric": f"{_GLASS} {_ROUGH}",
        "conductor": "material eta k specular_reflectance",
        "roughconductor": f"material eta k specular_reflectance {_ROUGH}",
        "plastic": "int_ior ext_ior diffuse_reflectance specular_reflectance nonlinear",
        "roughplastic": "int_ior ext_ior diffuse_reflectance specular_reflectance nonlinear distribution alpha "
                        "sample_visible",
        "bumpmap": "scale", "normalmap": "normalmap", "blendbsdf": "weight", "mask": "opacity", "twosided": "",
        "null": "",
        "phong": _LOBE, "blinnphong": _LOBE, "mirrorblend": "km",
    },
    "texture": {
        "bitmap": _TEXTURE, "checkerboard": "color0 color1 to_uv", "mesh_attribute": "name scale", "srgb": "color",
        "volume": "",
    },
    "medium": {
        "homogeneous": "albedo sigma_t scale sample_emitters", "heterogeneous": "albedo sigma_t scale sample_emitters",
    },
    "volume": {"constvolume": "value", "gridvolume": _GRID},
    "phase": {"isotropic": "", "hg": "g", "rayleigh": "", "blendphase": "weight", "sggx": "S"},
}  # fmt: skip

# Parameters of old that no picture depends on.
WITHOUT_EFFECT = (
    "banner", "attach_log", "high_quality_edges", "cache", "max_anisotropy", "specular_sampling_weight",
    "granularity", "method", "collapse", "render_time_limit",
)  # fmt: skip

# What an unknown plugin becomes; None: it is left out.
FALLBACKS = {
    "bsdf": "diffuse", "integrator": "path", "sampler": "independent", "film": "hdrfilm", "rfilter": "gaussian",
    "sensor": "perspective", "phase": "isotropic", "texture": None, "emitter": None, "shape": None, "medium": None,
    "volume": None,
}  # fmt: skip

# Children without a parameter's name: they may be called anything.
OBJECTS = ("bsdf", "texture", "emitter", "sensor", "shape", "medium", "film", "sampler", "rfilter", "integrator",
           "phase", "volume", "ref")  # fmt: skip
VALUES = ("boolean", "integer", "float", "string", "point", "vector", "rgb", "spectrum", "transform")
TAGS = {*OBJECTS, *VALUES, "default", "alias", "path", *["translate", "rotate", "scale", "matrix", "lookat"]}

# In these, an object's name is that of a parameter.
NAMED = ("texture", "volume")


def sift(context: Context) -> None:
    """Leave out what Mitsuba 3 would refuse: plugins and parameters that it does not have."""
    for parent in reversed(context.root.all()):
        for node in parent.nodes:
            if node.tag not in TAGS:
                parent.remove(node)
                context.journal.loss(node.place, f"<{node.tag}>", "left out: Mitsuba 3 has no such element")
            elif node.tag in PLUGINS and node.type not in PLUGINS[node.tag]:
                _replace(node, parent, context)
        _parameters(parent, context)


def _replace(node, parent, context: Context) -> None:
    other = FALLBACKS[node.tag]
    what = f"{node.tag} '{node.type}'"
    if other is None:
        parent.remove(node)
        context.journal.loss(node.place, what, "left out: neither Mitsuba 3 nor this package has it")
        return
    node.set("type", other)
    context.journal.loss(node.place, what, f"neither Mitsuba 3 nor this package has it; now '{other}'")
    _parameters(node, context)


def _parameters(node, context: Context) -> None:
    known = PLUGINS.get(node.tag, {}).get(node.type)
    if known is None:
        return
    for child in node.nodes:
        if _is_parameter(child, context) and not _belongs(child, node, known.split()):
            node.remove(child)
            without_effect = child.name in WITHOUT_EFFECT or child.name.startswith("label") or node.tag == "sampler"
            note = context.journal.change if without_effect or _is_of_method(node) else context.journal.loss
            note(child.place, f"'{child.name}' of '{node.type}'", "left out: the plugin has no such parameter")


def _is_of_method(node) -> bool:
    """Whether parameters only say how the same picture is found."""
    return node.tag == "integrator" and node.type in ("path", "volpath")


def _is_parameter(child, context: Context) -> bool:
    what = context.target(child) if child.tag == "ref" else child
    return what is not None and (child.tag in VALUES or what.tag in NAMED)


def _belongs(child, node, known: list[str]) -> bool:
    if child.name in known:
        return True
    # An image of bumps has any name, or none.
    return child.tag not in VALUES and (node.type in ("bumpmap", "volume") or not child.name)
