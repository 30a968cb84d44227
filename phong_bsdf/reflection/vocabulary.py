"""What the parameters of `phong` and `blinnphong` are called, and what they are where the scene is silent."""

# Names of the diffuse scale, of the lobe's scale, of the exponent: the lecture's, and those of 0.6. A BSDF has one set.
COEFFICIENTS = ("kd", "ks", "p")
REFLECTANCES = ("diffuse_reflectance", "specular_reflectance", "exponent")
VOCABULARIES = {"coefficients": COEFFICIENTS, "reflectances": REFLECTANCES}
DEFAULTS = (0.5, 0.2, 30.0)

# With reflectances: whether the energy rule holds.
ENERGY = "ensure_energy_conservation"

# How directions are drawn: by the lobe or the cosine, as much light as each reflects; by one of them alone.
SAMPLINGS = MIXTURE, COSINE, LOBE = "mixture", "cosine", "lobe"
