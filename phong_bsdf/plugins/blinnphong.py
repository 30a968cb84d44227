"""BSDF `blinnphong`: Lambertian base plus Blinn's half-vector highlight."""

import mitsuba as mi

from . import lobe_bsdf


class BlinnPhong(lobe_bsdf.LobeBSDF):
    r"""The lecture's Blinn-Phong model: a highlight where the half vector meets the normal.

    For a light of intensity I in direction l, seen from direction v,

        L = k_d I max(0, n.l) + k_s I max(0, n.h)^p,    h = (v + l) / |v + l|,

    which as a BSDF is f cos(theta_o) = (k_d cos(theta_o) + k_s (n.h)^p) / pi. It is not
    energy conserving, by design, and one-sided: black from behind (wrap it in `twosided`).
    For a highlight of the size of `phong`'s, p has to be about four times larger.

    ==========================  ==============================  ======  =======  =====================================
    name                        type                            range   default  meaning
    ==========================  ==============================  ======  =======  =====================================
    kd                          number, RGB, spectrum, texture  >= 0    0.5      diffuse coefficient
    ks                          number, RGB, spectrum, texture  >= 0    0.2      height of the highlight
    p                           number or texture               >= 0    30       exponent; of a colour texture its mean
    ==========================  ==============================  ======  =======  =====================================

    or, normalised and energy conserving, after Mitsuba 0.6's `phong`:

    ==========================  ==============================  ======  =======  =====================================
    name                        type                            range   default  meaning
    ==========================  ==============================  ======  =======  =====================================
    diffuse_reflectance         number, RGB, spectrum, texture  >= 0    0.5      rho_d, albedo of the diffuse base
    specular_reflectance        number, RGB, spectrum, texture  >= 0    0.2      rho_s, albedo at normal incidence
    exponent                    number or texture               >= 0    30       p
    ensure_energy_conservation  boolean                                 true     scale both where their sum exceeds 1
    ==========================  ==============================  ======  =======  =====================================

    Then f = rho_d / pi + rho_s c(p) (n.h)^p, c(p) = (p + 2) (p + 4) / (8 pi (2^(-p/2) + p)).

    All are differentiable. Values of textures outside the range are clamped to it.

    Either takes `sampling`, which says how directions are drawn where an integrator asks for samples:
    `mixture` (default, by cosine or lobe, each as often as it reflects light), `cosine` or `lobe` alone. It is there to
    be compared (`phong-bsdf converge`): where the lobe alone never samples, `path` misses light.

    Source: Blinn, "Models of light reflection for computer synthesized pictures", 1977.

    XML::

        <bsdf type="blinnphong">
            <rgb name="kd" value="0.9, 0.3, 0.2"/>
            <float name="ks" value="0.6"/>
            <float name="p" value="200"/>
        </bsdf>

    Python::

        {"type": "blinnphong", "kd": {"type": "rgb", "value": [0.9, 0.3, 0.2]}, "ks": 0.6, "p": 200}
    """

    NAME = "blinnphong"


mi.register_bsdf("blinnphong", BlinnPhong)
