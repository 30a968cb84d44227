"""Every block of code in the pages works, every link and picture is there, every figure is made by a command."""

import glob
import itertools
import os
import re
import shlex
import subprocess
import sys
import webbrowser

import mitsuba as mi
import numpy as np
import pytest
from click.testing import CliRunner

from helpers import ROOT
from helpers.documents import PAGES, Block, blocks, headings, links
from phong_bsdf import stability
from phong_bsdf.cli import main
from phong_bsdf.convergence import lobe_errors
from phong_bsdf.pictures import images

# Blocks in these languages are no code.
PROSE = ("text", "math", "{toctree}")

# Their examples are run by tests/test_gallery.py and tests/test_optimization.py.
ELSEWHERE = ("gallery.md", "inverse-rendering.md")

# Pages whose commands take more than a few seconds.
LONG = ("README.md", "clusters.md", "compare.md", "error-vs-time.md", "python.md", "quickstart.md", "test-authors.md")

# The files that the pages speak of.
SCENE = """\
<scene version="3.0.0">
    <default name="max_depth" value="4"/>
    <default name="ks" value="0.6"/>
    <default name="p" value="20"/>
    <default name="km" value="0.3"/>
    <integrator type="whitted"><integer name="max_depth" value="$max_depth"/></integrator>
    <sensor type="perspective">
        <transform name="to_world"><lookat origin="0, 1, 6" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="hdrfilm"><integer name="width" value="40"/><integer name="height" value="30"/>
            <rfilter type="box"/></film>
        <sampler type="independent"><integer name="sample_count" value="1"/></sampler>
    </sensor>
    <emitter type="point"><point name="position" x="2" y="4" z="3"/></emitter>
    <shape type="sphere" id="one"><bsdf type="phong" id="ball">
        <float name="ks" value="$ks"/><float name="p" value="$p"/></bsdf></shape>
    <shape type="sphere"><point name="center" x="0" y="-51" z="0"/><float name="radius" value="50"/>
        <bsdf type="mirrorblend"><float name="km" value="$km"/><bsdf type="blinnphong" id="floor"/></bsdf></shape>
</scene>
"""
OLD = """\
<scene version="0.6.0">
    <integrator type="bdpt"/>
    <sensor type="perspective">
        <transform name="toWorld"><lookAt origin="0, 1, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
        <film type="ldrfilm"><integer name="width" value="40"/><integer name="height" value="30"/></film>
    </sensor>
    <emitter type="point"><point name="position" x="2" y="4" z="4"/><spectrum name="intensity" value="60"/></emitter>
    <shape type="sphere"><bsdf type="phong"><float name="exponent" value="40"/></bsdf></shape>
</scene>
"""
OBJ = "mtllib pyramid.mtl\nv -1 0 1\nv 1 0 1\nv 1 0 -1\nv 0 1 0\nusemtl stone\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
MTL = "newmtl stone\nKd 0.7 0.6 0.4\nKs 0.3 0.3 0.3\nNs 30\n"
FILES = {"SCENE.xml": SCENE, "scene.xml": SCENE, "OLD.xml": OLD, "pyramid.obj": OBJ, "pyramid.mtl": MTL}
# On this page, `scene.xml` is an old one.
OTHER_FILES = {"old-scenes.md": {"scene.xml": OLD}}

# Pictures of students, and the height of the highlights in them; 0.6 is right.
PICTURES = {"hand-in.png": 0.6, "hand-ins/ada.png": 0.6, "hand-ins/bert.png": 0, "submission/picture.png": 0.6}

# What makes a command of the pages a short one.
SHORT = {
    "compare": ["--size", "24x18", "--spp", "4"],
    "converge": ["--size", "12x9", "--spp", "4", "--repeats", "1"],
    "explain": ["--size", "24x18"],
    "stability": [],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The current folder, with the files that the pages speak of; measurements are short."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda address: True)
    monkeypatch.setattr(stability, "QUICK_CASES", 2**12)
    monkeypatch.setattr(lobe_errors, "EXPONENTS", (10.0, 1e6))
    for name, text in FILES.items():
        (tmp_path / name).write_text(text)
    (tmp_path / "scenes").symlink_to(ROOT / "scenes")
    for name, ks in PICTURES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        phong_bsdf("render", "scene.xml", "-o", name, "--linear", "-D", f"ks={ks}")
    for seed in "12":
        phong_bsdf("render", "scene.xml", "-o", f"part_{seed}.exr", "--spp", "2", "--seed", seed)
    return tmp_path


# Commands ---------------------------------------------------------------------------------------------------


def phong_bsdf(*words):
    """Run it in this process; what it is to write is there."""
    arguments = [name for word in words for name in (sorted(glob.glob(word)) if "*" in word else [word])]
    command = arguments[0]
    if "--lobes" in arguments:
        arguments += ["--repeats", "1"]
    elif "--from" not in arguments:
        arguments += SHORT.get(command, [])
    if command == "converge" and not {"--lobes", "--from", "--method"} & set(arguments):
        arguments += ["--method", "path"]
    result = CliRunner().invoke(main, arguments)
    # A check that finds something wrong ends with 1.
    assert result.exit_code in ((0, 1) if command == "check" else (0,)), result.output + repr(result.exception)
    for option, name in itertools.pairwise(arguments):
        assert option not in ("-o", "--html", "--gradescope") or os.path.exists(name), f"there is no {name}"


def make(*words):
    """The Makefile has the target; what it does is run elsewhere."""
    result = subprocess.run(["make", "-n", "-C", ROOT, *words], capture_output=True, text=True)
    assert result.returncode == 0 and words[0] in declared("Makefile", r"^\.PHONY: (.*)$"), result.stderr


def pip(*words):
    """Installs this project; tests/test_packaging.py does it."""
    assert words[0] == "install" and any(re.match(r"phong-bsdf\b|\.(\[|$)", word) for word in words[1:])


def run_pytest(*words):
    """In a process of its own, on the tests that the page has shown."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    result = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stdout


def nothing(*words):
    """Makes a virtual environment: tests/test_packaging.py makes one."""
    assert words[:2] == ("-m", "venv")


def make_folder(*words):
    os.makedirs(words[-1], exist_ok=True)


RUN = {
    "phong-bsdf": phong_bsdf,
    "make": make,
    "pip": pip,
    "pytest": run_pytest,
    "python3": nothing,
    "mkdir": make_folder,
}


def declared(file, pattern):
    """Names that a file of the project lists."""
    return {name for names in re.findall(pattern, (ROOT / file).read_text(), re.M) for name in names.split()}


def run_shell(text):
    """Each command by what it calls; programs of the virtual environment like others, in the first job of an array."""
    text = re.sub(r"\$\{\w+:-(\w+)\}", r"\1", text.replace("\\\n", " "))
    for line in re.sub(r"\$\w+", "1", text).splitlines():
        for command in line.split("&&"):
            words = shlex.split(command.replace(".venv/bin/python -m ", "").replace(".venv/bin/", ""), comments=True)
            if words:
                assert words[0] in RUN, f"no test runs '{words[0]}'"
                RUN[words[0]](*words[1:])


# Blocks -----------------------------------------------------------------------------------------------------


def run_python(text, place, names):
    """As it stands, after the page's earlier blocks; tests become the file that the page calls test_it.py, and run."""
    code = compile(text, place, "exec")
    if "def test_" in text:
        with open("test_it.py", "w") as file:
            file.write(text)
        run_pytest("--phong-update-references", "test_it.py")
        return
    exec(code, names)
    if "image" in names:
        assert np.array(names["image"]).max() > 0.1


def run_block(block: Block, names):
    if block.language == "python":
        run_python(block.text, block.place, names)
    elif block.language == "xml":
        assert np.array(mi.render(mi.load_string(block.text), spp=1)).max() > 0.1
    elif block.language == "bash":
        run_shell(block.text)
    else:
        assert block.language in PROSE, f"nobody runs a block in '{block.language}'"


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(p, id=p.name, marks=[pytest.mark.slow] * (p.name in LONG))
        for p in PAGES
        if blocks(p) and p.name not in ELSEWHERE
    ],
)
def test_blocks_work(page, folder):
    """From the top of the page to its end, in a folder with the files that it names."""
    for name, text in OTHER_FILES.get(page.name, {}).items():
        (folder / name).write_text(text)
    names = {}
    for block in blocks(page):
        mi.set_variant("llvm_ad_rgb")
        try:
            run_block(block, names)
        except Exception as error:
            raise AssertionError(f"{block.place}: {error}") from error


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_extras_exist(page):
    """What the page asks to install with `phong-bsdf[NAME]` is declared."""
    asked = set(re.findall(r"(?:phong-bsdf|'\.)\[(\w+)\]", page.read_text()))
    section = re.search(r"\[project.optional-dependencies\]\n(.*?)\n\[", (ROOT / "pyproject.toml").read_text(), re.S)[1]
    assert asked <= set(re.findall(r"^(\w+) = ", section, re.M))


def test_the_readme_lists_every_command():
    """A new user finds all of them on the first page."""
    listed = re.findall(r"^phong-bsdf (\w+)", (ROOT / "README.md").read_text(), re.M)
    assert set(listed) == set(main.commands)


def test_the_readmes_figures_are_those_of_the_speed_page():
    """Its table says what docs/speed.md and docs/stability.md have measured."""
    readme, speed, stability_page = (
        (ROOT / p).read_text() for p in ("README.md", "docs/speed.md", "docs/stability.md")
    )
    warm, cold = re.findall(r"^lecture +2048 +(\S+) +(\S+) +(\S+) ", speed, re.M)[1:3]
    for times in (warm, cold):
        ours, povray, tachyon = times
        assert f"| {ours} ms | - | {povray} ms | {tachyon} ms | - |" in readme
    glossy = [re.search(rf"^direct, {bsdf} +1024 +(\S+)", speed, re.M)[1] for bsdf in ("phong", "roughplastic")]
    assert "| {} ms (`phong`) | {} ms (`roughplastic`) |".format(*glossy) in readme
    errors = re.findall(r"^value +\w+ +1e\+06 +(\S+)", stability_page, re.M)
    assert f"| {max(errors, key=float)} | 1 (" in readme


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.name)
def test_measured_tables_are_filled_in(page):
    """Between the marks of each table, and so of each benchmark, there is one."""
    for name, table in re.findall(r"^<!-- (?!end of)([\w -]+) -->\n(.*?)^<!-- end of ", page.read_text(), re.M | re.S):
        assert table.startswith("```text\n") and len(table.splitlines()) > 4, name


# Links and figures --------------------------------------------------------------------------------------------


def test_tests_that_are_named_are_there():
    """In pages, scenes and source."""
    folders = [ROOT / name for name in ("docs", "scenes", "phong_bsdf", "tests")]
    files = [ROOT / "README.md", *(p for f in folders for p in f.rglob("*") if p.suffix in (".md", ".xml", ".py"))]
    named = {(path.name, name) for path in files for name in re.findall(r"\btests/[\w/]+\.py", path.read_text())}
    assert len(named) > 30
    assert [pair for pair in sorted(named) if not (ROOT / pair[1]).is_file()] == []


@pytest.mark.parametrize("page", [*PAGES, ROOT / "scenes/README.md", ROOT / "CHANGELOG.md"], ids=lambda p: p.name)
def test_links_lead_somewhere(page):
    """Files and headings of this project exist; addresses elsewhere are https."""
    for address, heading in links(page):
        if "://" in address:
            assert re.fullmatch(r"https://[\w.-]+(/[\w./?=&%-]*)?", address), address
            continue
        target = (page.parent / address).resolve() if address else page
        assert target.exists() and ROOT in (target, *target.parents), f"{page.name}: there is no {address}"
        assert not heading or heading in headings(target), f"{page.name}: {address} has no heading #{heading}"


def test_every_picture_is_shown_and_made_by_a_command(monkeypatch):
    """Those in docs/images are what the commands of docs/developing.md write, and no others."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    import figures
    import study

    from benchmarks import plots

    made = {*figures.FIGURES, "stability-value.svg", "explorer.png"}
    made |= {f"study-{name}.{kind}" for name in study.SHOWN for kind in ("png", "svg")}
    made |= {f"speed-{name}.svg" for name in plots.PLOTS}
    made |= declared("docs/inverse.py", r'write\(IMAGES / "(\S+)"')
    there = {path.name for path in (ROOT / "docs/images").iterdir() if path.is_file()}
    addresses = [address for page in PAGES if page.name != "gallery.md" for address, _ in links(page)]
    shown = {address.rsplit("/", 1)[-1] for address in addresses if "images/" in address}
    assert there == made == shown


@pytest.mark.parametrize(
    "name",
    ["mirror-floor.png", "model-terms.png", "model-exponents.png", "model-vocabularies.png", "highlights.png"],
)
def test_pictures_are_what_the_package_renders_now(name, monkeypatch):
    """Those in the repository are not older than what they show: `make figures` would draw the same."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    import figures

    drawn = images.to_8bit(images.srgb(figures.FIGURES[name]()))
    kept = np.array(mi.Bitmap(str(ROOT / "docs/images" / name)))
    # Where rounding decides, a sample at an edge may see another surface.
    assert drawn.shape == kept.shape and np.mean(drawn != kept) < 1e-3
