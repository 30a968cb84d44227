"""Methods of rendering: which ones a scene supports, what they change in it, and what they are measured against."""

import os
import subprocess
import sys

import mitsuba as mi
import numpy as np
import pytest

from phong_bsdf.convergence import methods
from phong_bsdf.scene import rendering

SCENE = """\
<scene version="3.0.0">
    {integrator}
    <sensor type="perspective">
        {sampler}
        <film type="hdrfilm"><rfilter type="box"/>
            <integer name="width" value="16"/> <integer name="height" value="12"/>
        </film>
    </sensor>
    {light}
    <shape type="sphere"><point name="center" x="0" y="0" z="4"/>{bsdf}</shape>
    <shape type="sphere"><point name="center" x="2" y="0" z="5"/>{bsdf}</shape>
</scene>
"""
SAMPLER = '<sampler type="multijitter"><integer name="sample_count" value="9"/></sampler>'
PATH = '<integrator type="path"><integer name="max_depth" value="3"/></integrator>'
COURSE = '<integrator type="whitted"/>'
PHYSICAL = '<integrator type="whitted"><string name="convention" value="physical"/></integrator>'
POINT = '<emitter type="point"><point name="position" x="1" y="2" z="0"/></emitter>'
SKY = '<emitter type="constant"/>'
PHONG = '<bsdf type="phong"><float name="ks" value="0.3"/></bsdf>'
DIFFUSE = '<bsdf type="diffuse"/>'


@pytest.fixture
def scene(tmp_path):
    """A function that writes a scene and reads it."""

    def read(integrator=PATH, light=POINT, bsdf=PHONG, sampler=SAMPLER):
        path = tmp_path / "a.xml"
        path.write_text(SCENE.format(integrator=integrator, light=light, bsdf=bsdf, sampler=sampler))
        return methods.read(path)

    return read


def names(scene):
    return [method.name for method in methods.defaults(scene)]


SAMPLERS = ["path-stratified", "path-multijitter", "path-ldsampler"]
SAMPLINGS = ["path-cosine", "path-lobe"]


def test_methods_that_a_scene_supports(scene):
    """`whitted` where all lights are delta lights, sampling of lobes and other BSDFs where there are lobes."""
    assert names(scene()) == ["whitted", "path", "direct", *SAMPLINGS, *SAMPLERS, "path-roughplastic"]
    assert names(scene(light=SKY)) == ["path", "direct", *SAMPLINGS, *SAMPLERS, "path-roughplastic"]
    assert names(scene(bsdf=DIFFUSE)) == ["whitted", "path", "direct", *SAMPLERS]
    # A `whitted` scene may have a background.
    assert names(scene(COURSE, SKY, DIFFUSE)) == ["whitted", "path", "direct", *SAMPLERS]
    assert names(scene('<integrator type="volpath"/>', SKY, DIFFUSE))[:3] == ["volpath", "path", "direct"]


def test_lobes_that_cannot_be_matched_can_still_be_sampled(scene):
    """A texture without a mean takes away the physical BSDF, not the rest."""
    textured = (
        '<bsdf type="phong"><texture type="mesh_attribute" name="kd"><string name="name" value="face_c"/></texture>'
    )
    found = names(scene(bsdf=f"{textured}</bsdf>"))
    assert "path-lobe" in found and "path-roughplastic" not in found


def loaded(scene, method):
    return rendering.load_parsed(scene.path, rendering.merged(methods.applied(scene, method))).scene


@pytest.mark.parametrize("sampler", (SAMPLER, ""))
def test_method_changes_integrator_and_sampler(scene, sampler):
    """The file's own sampler is replaced, one that it lacks is added."""
    made = loaded(scene(sampler=sampler), methods.Method("m", "direct", sampler="stratified"))
    assert str(made.integrator()).startswith("DirectIntegrator")
    assert made.sensors()[0].sampler().class_name() == "StratifiedSampler"


def test_integrators_hand_on_their_depth(scene):
    """What the scene limits stays limited, whichever integrator takes over."""
    whitted = loaded(scene(PATH), methods.Method("m", "whitted")).integrator()
    assert (whitted.depth, whitted.convention) == (3, "physical")
    assert "max_depth = 3" in str(loaded(scene(PATH), methods.Method("m", "path")).integrator())
    # The default of `whitted`.
    assert "max_depth = 10" in str(loaded(scene(COURSE), methods.Method("m", "path")).integrator())
    given = methods.Method("m", "path", parameters={"max_depth": 5})
    assert "max_depth = 5" in str(loaded(scene(PATH), given).integrator())


@pytest.mark.parametrize("sampling", ("cosine", "lobe"))
def test_method_changes_how_lobes_are_sampled(scene, sampling):
    """Of every lobe BSDF; the picture's limit stays as it is."""
    made = loaded(scene(), methods.Method("m", sampling=sampling))
    assert all(sampling == shape.bsdf().sampling for shape in made.shapes())


def test_method_changes_bsdfs(scene):
    """All lobe BSDFs become the matched physical one."""
    made = loaded(scene(), methods.Method("m", bsdf="roughplastic"))
    assert [shape.bsdf().class_name() for shape in made.shapes()] == ["RoughPlastic"] * 2


def test_scene_itself_stays_as_it_was(scene):
    """Methods change copies."""
    read = scene()
    before = mi.parser.write_string(read.state)
    for method in methods.defaults(read):
        methods.applied(read, method)
    assert mi.parser.write_string(read.state) == before


@pytest.mark.parametrize(
    ("integrator", "method", "name", "plugin"),
    (
        (PATH, methods.Method("m", "direct", sampling="lobe"), "path", "path"),
        (PATH, methods.Method("m", "whitted"), "path", "path"),
        (PATH, methods.Method("m", bsdf="roughplastic"), "path-roughplastic", "path"),
        (PATH, methods.Method("m", "direct", reference="own"), "m.own", "direct"),
        (COURSE, methods.Method("m", "whitted"), "whitted", "whitted"),
        (COURSE, methods.Method("m", "path"), "path", "path"),
        (COURSE, methods.Method("m", "whitted", {"convention": "physical"}), "path", "path"),
        (PHYSICAL, methods.Method("m", "path"), "whitted", "whitted"),
    ),
)
def test_limit(scene, integrator, method, name, plugin):
    """The scene's own integrator says what is true, where the method can mean that; else the method's own kind."""
    read = scene(integrator)
    found = methods.limit(read, method)
    assert (found.name, methods.integrator_of(read, found)) == (name, plugin)
    assert (found.sampler, found.bsdf) == ("independent", method.bsdf)
    assert found.sampling == (method.sampling if name == "m.own" else "mixture")


def test_specifications(scene):
    """Names alone choose, specifications make, and a known name with a specification changes that method."""
    read = scene()
    given = [("path", {}), ("fast", {"integrator": "direct", "sampler": "ldsampler", "emitter_samples": 2}),
             ("whitted", {"spp": "16 4"})]  # fmt: skip
    path, fast, whitted = methods.chosen(read, given)
    assert path == methods.Method("path", "path")
    assert fast == methods.Method("fast", "direct", {"emitter_samples": 2}, sampler="ldsampler")
    assert whitted == methods.Method("whitted", "whitted", levels=(4, 16))
    # How finely it is measured is not part of what a pass shows.
    assert "levels" not in whitted.spec() and whitted.spec() == methods.Method("x", "whitted").spec()


@pytest.mark.parametrize(
    ("given", "said"),
    (
        ([("pth", {})], "there is no method 'pth' for this scene, only whitted, path"),
        ([("path", {}), ("path", {})], "two methods 'path'"),
        ([("a/b", {})], "'a/b' is no name"),
        ([("m", {"sampling": "both"})], "'sampling' must be one of mixture, cosine, lobe, got 'both'"),
        ([("m", {"reference": "best"})], "'reference' must be one of scene, own, got 'best'"),
        ([("m", {"bsdf": "plastic"})], "'bsdf' must be one of roughplastic"),
        ([("m", {"bsdf": "diffuse", "sampling": "lobe"})], "give one"),
        ([("m", {"integrator": "paht"})], "method 'm'.*paht"),
        ([("m", {"integrator": "diffuse"})], "'m'.*is of type .bsdf."),
        ([("m", {"sampler": "halton"})], "method 'm'.*halton"),
        ([("m", {"integrator": "path", "max_dept": 3})], "method 'm'.*max_dept"),
        ([("m", {"integrator": "whitted", "max_depth": 0})], "method 'm'.*'max_depth' must be"),
        ([("m", {"spp": "4,x"})], "'spp' must be numbers of samples"),
    ),
)
def test_mistakes_are_named(scene, given, said):
    """The method, what is wrong with it, and what would be right."""
    with pytest.raises(ValueError, match=said):
        methods.chosen(scene(), given)


def test_no_lobes_to_change(scene):
    """Said, not ignored."""
    with pytest.raises(ValueError, match="no phong or blinnphong"):
        methods.chosen(scene(bsdf=DIFFUSE), [("m", {"sampling": "lobe"})])


def test_scene_without_integrator(scene):
    """One sentence, with the remedy."""
    with pytest.raises(rendering.SceneError, match="no integrator; add"):
        scene(integrator="")


def test_merged_as_mitsuba_merges(scene):
    """Equal BSDFs become one again after the change, as when the file is loaded."""
    read = scene()
    made = loaded(read, methods.Method("m", sampling="lobe"))
    assert len({shape.bsdf().ptr for shape in made.shapes()}) == 1
    assert np.array(mi.render(made, spp=1)).max() > 0


BARE = """
<scene version="3.0.0"><integrator type="path"/><sensor type="perspective"><film type="hdrfilm"/></sensor>
<emitter type="constant"/><shape type="sphere"><bsdf type="phong"/></shape></scene>
"""
FREED = """
import sys, phong_bsdf, mitsuba as mi
mi.set_variant("llvm_ad_rgb")
from phong_bsdf.convergence import methods
read = methods.read(sys.argv[1])
for method in methods.chosen(read, []):
    nodes = methods.applied(read, method).nodes
    assert [node.type for node in nodes].count(mi.ObjectType.Sampler) == 1
"""


def test_camera_without_a_sampler(tmp_path):
    """It gets one: the parsed scene grows, and moves in memory, where what is freed is overwritten here."""
    (tmp_path / "a.xml").write_text(BARE)
    environment = {**os.environ, "MALLOC_PERTURB_": "165"}
    subprocess.run([sys.executable, "-c", FREED, tmp_path / "a.xml"], env=environment, check=True)
