"""From which side a surface is seen, where its shading normal is not its geometric one.

Mitsuba's BSDFs are black where the viewer is below the shading normal's horizon. On a coarse mesh
with interpolated normals that blackens whole triangles near silhouettes. The lecture's formulas ask
for n.l, n.h and r.v, never for n.v: in the course convention a surface is seen from behind only where
both its normals face away.

So there BSDFs are told only from which side the surface is seen: `si.wi` is the normal of that side,
which leaves adapters (`twosided`, `normalmap`, ...) nothing to flip or to hide. The BSDFs of this
package take the true direction toward the viewer from fields that no other BSDF reads: `si.dn_du` is that
direction, `si.dn_dv` the surface's shading normal.
"""

import drjit as dr
import mitsuba as mi

from .needs import COURSE, TILTED

# Shapes whose two normals are one.
FLAT = ("Sphere", "Rectangle", "Disk", "Cylinder", "Cube")

# BSDFs of Mitsuba that pass a question on to what they hold, and those that have the lecture's diffuse part.
ADAPTERS = ("TwoSidedBRDF", "MaskBSDF", "BlendBSDF", "NormalMap", "BumpMap")
TILTING = ("NormalMap", "BumpMap")
DIFFUSE = ("SmoothDiffuse", "Null")


def toward_viewer(ctx, si):
    """The direction toward the viewer, in the local frame: what the BSDFs of this package use instead of `si.wi`."""
    if not ctx.type_mask & COURSE:
        return si.wi
    wi = si.to_local(mi.Vector3f(si.dn_du))
    if not ctx.type_mask & TILTED:
        return wi
    # Seen from behind, `wi` is mirrored about the surface's normal, as by a `twosided` around what tilts it. One inside
    # of that mirrors about the tilted normal: then the side's normal leans the other way.
    normal = si.to_local(mi.Vector3f(si.dn_dv))
    inside = dr.fma(si.wi.x, normal.x, si.wi.y * normal.y) < 0
    tilted = wi - normal * (2 * dr.dot(wi, normal))
    return dr.select(inside, mi.Vector3f(tilted.x, tilted.y, -tilted.z), wi)


def interpolates(scene) -> bool:
    """Whether some shape's shading normal may face elsewhere than its geometric one."""
    return any(map(_interpolates, scene.shapes()))


def is_front(si, view):
    """Whether a surface is seen from the front: one of its normals faces the unit vector `view`, in world space."""
    return (dr.dot(si.n, view) > 0) | (dr.dot(si.sh_frame.n, view) > 0)


class Told:
    """What `bsdfs`, those of a scene, are told; one with a part foreign to the lecture sees what Mitsuba shows."""

    def __init__(self, bsdfs):
        trees = [(bsdf, list(_tree(bsdf))) for bsdf in bsdfs]
        self.foreign = [bsdf for bsdf, tree in trees if not all(map(_is_lectures, tree))]
        self.all_foreign = len(self.foreign) == len(bsdfs)
        self.tilts = any(found.class_name() in TILTING for _, tree in trees for found in tree)

    def about(self, si, bsdf, front, view):
        """The interaction `si` as `bsdf` is to see it; `front` and `view` as in `is_front`."""
        told = mi.SurfaceInteraction3f(si)
        along = mi.Vector3f(0, 0, dr.select(front, mi.Float(1), mi.Float(-1)))
        if dr.is_jit_v(mi.Float):
            lecture = mi.Mask(True)
            for other in self.foreign:
                lecture = lecture & (bsdf != mi.BSDFPtr(other))
        else:
            lecture = bsdf not in self.foreign
        told.wi = dr.select(lecture, along, si.wi)
        # Below the horizon `twosided` mirrors directions, so there they are mirrored beforehand.
        below = mi.Frame3f.cos_theta(told.wi) < 0
        n = mi.Vector3f(si.sh_frame.n)
        told.dn_du, told.dn_dv = dr.select(below, view - n * (2 * dr.dot(view, n)), view), n
        return told


def _interpolates(shape) -> bool:
    if shape.class_name() in FLAT:
        return False
    return not shape.is_mesh() or (shape.has_vertex_normals() and not shape.has_face_normals())


def _is_lectures(bsdf) -> bool:
    return hasattr(bsdf, "serial") or bsdf.class_name() in ADAPTERS + DIFFUSE


def _tree(bsdf):
    """`bsdf` and all that it holds."""
    yield bsdf
    # With a number, all that it holds are this package's.
    for child in [] if getattr(bsdf, "serial", None) is not None else children(bsdf):
        yield from _tree(child)


def children(bsdf) -> list:
    """The BSDFs that `bsdf` holds, which only its traversal tells."""
    found = []

    class Callback(mi.TraversalCallback):
        def put(self, name, value, *_):
            found.extend([value] * isinstance(value, mi.BSDF))

    bsdf.traverse(Callback())
    # A class lives until garbage is collected, and what it refers to with it: these shall not.
    taken = list(found)
    found.clear()
    return taken
