"""What speed is asked of the package, and whether the records show it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from phong_bsdf.report.tables import number, text_table

from . import growth
from .measure import Record


@dataclass(frozen=True)
class Target:
    """A limit for the worst of the records that `select` chooses."""

    what: str
    sign: str
    """`<=` or `>=`."""
    limit: float
    unit: str
    select: Callable[[Record], bool]


@dataclass(frozen=True)
class Outcome:
    """A target, and what was measured; None where nothing was."""

    what: str
    sign: str
    limit: float
    unit: str
    measured: float | None
    met: bool | None


def _is(benchmark, quantity, task=None, scene=None, least=0):
    return lambda r: (
        (r.benchmark, r.quantity) == (benchmark, quantity)
        and task in (None, r.task)
        and scene in (None, r.scene)
        and (r.x or 0) >= least
    )


def _peer(program, kind, scene=None, at=None, least=0):
    chosen = _is("peers", f"{kind} time / phong_bsdf", program, scene, least)
    return lambda r: chosen(r) and at in (None, r.x)


TARGETS = (
    *(
        Target(f"warm time / ray floor, {scene}", "<=", 1.15, "x", _is("floor", "time / ray floor", "whitted", scene))
        for scene in ("lecture", "course 6", "mesh", "100 spheres", "textured")
    ),
    Target("Tachyon / ours, warm, lecture scene, 2048 x 2048", ">=", 1.7, "x",
           _peer("tachyon", "warm", "lecture", 2048)),
    Target("POV-Ray / ours, warm, lecture scene, 2048 x 2048", ">=", 10, "x", _peer("povray", "warm", "lecture", 2048)),
    Target("Tachyon / ours, warm, least of all scenes and sizes", ">=", 1, "x", _peer("tachyon", "warm")),
    Target("POV-Ray / ours, warm, least of all scenes and sizes", ">=", 1, "x", _peer("povray", "warm")),
    Target("POV-Ray / ours, cold, lecture scene, from 2048 x 2048 on", ">=", 1, "x",
           _peer("povray", "cold", "lecture", least=2048)),
    Target("Tachyon / ours, cold, lecture scene, from 4096 x 4096 on", ">=", 1, "x",
           _peer("tachyon", "cold", "lecture", least=4096)),
    # Not on the mesh: which triangle a ray near an edge meets, and whether it shades itself, each program decides.
    *(
        Target(f"largest difference to a peer's picture away from edges, {scene}", "<=", 2e-5, "",
               _is("peers", "largest difference away from edges", scene=scene))
        for scene in ("lecture", "100 spheres", "8 lights")
    ),
    Target("first picture / plain Mitsuba, empty cache, 512 x 512", "<=", 1.3, "x",
           _is("cold", "first picture / plain Mitsuba", "empty cache")),
    Target("phong / roughplastic under direct", "<=", 1.05, "x",
           _is("native", "time / direct, roughplastic", "direct, phong")),
    Target("blinnphong / roughplastic under direct", "<=", 1.05, "x",
           _is("native", "time / direct, roughplastic", "direct, blinnphong")),
    Target("a light more / its rays on the floor", "<=", 1.05, "x", _is("growth", growth.COST)),
    Target("operations with most lights / with the fewest in a loop", "<=", 1, "x", _is("growth", growth.SAME_KERNEL)),
    Target("time with 1000 materials / with 1", "<=", 1.2, "x", _is("growth", "time, most / least", scene="materials")),
    Target("recorded frame, 64 x 64", "<=", 2e-3, "s", _is("memory", "time", "recorded frame")),
    Target("reverse pass / picture, lecture scene, 512 x 512", "<=", 4, "x",
           _is("gradients", "time / picture", "reverse pass")),
    Target("recorded step of an optimisation, 64 x 64", "<=", 10e-3, "s", _is("gradients", "time", "frozen step")),
    Target("compile time / general kernel, lecture scene", "<=", 0.6, "x",
           _is("cold", "compile time / whitted, general")),
    Target("arrays beside the picture, a pixel", "<=", 64, "bytes",
           _is("memory", "arrays beside the picture, a pixel")),
    Target("growth of arrays over all renderings", "<=", 0, "bytes", _is("memory", "growth of arrays")),
    # The allocator of the C library may keep some.
    Target("growth of the process over all renderings", "<=", 2**20, "bytes", _is("memory", "growth of the process")),
)  # fmt: skip


def outcomes(records: Sequence[Record]) -> list[Outcome]:
    """Each target with the worst record that it is about."""
    found = []
    for target in TARGETS:
        values = [row.median for row in records if target.select(row)]
        worst = (max if target.sign == "<=" else min)(values, default=None)
        met = None if worst is None else worst <= target.limit if target.sign == "<=" else worst >= target.limit
        found.append(Outcome(target.what, target.sign, target.limit, target.unit, worst, met))
    return found


def table(found: Sequence[Outcome]) -> str:
    """One line a target."""
    words = {True: "met", False: "MISSED", None: "not measured"}
    rows = [
        (o.what, f"{o.sign} {number(o.limit)} {o.unit}".rstrip(), number(o.measured), words[o.met]) for o in found
    ]  # fmt: skip
    return text_table(("target", "limit", "measured", ""), rows)
