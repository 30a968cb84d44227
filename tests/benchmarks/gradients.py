"""What derivatives cost: a reverse pass beside its picture, a step of an optimisation, and the same step frozen."""

import drjit as dr
import mitsuba as mi

from phong_bsdf.optimization import Unknown

from . import scenes
from .measure import Plan, compared, fresh_process, interleaved, seconds

NAMES = ("kd", "ks", "p", "km", "intensity")


def records(plan: Plan):
    """The lecture scene, with respect to all its materials and lights."""
    found = []
    size = plan.of(512, 64)
    with fresh_process(plan.variant) as run:
        found += compared("gradients", "lecture", run(_reverse, size, plan.of(21, 2)), "picture", size)
    size = plan.of(64, 16)
    with fresh_process(plan.variant) as run:
        found += compared("gradients", "lecture", run(_steps, size, plan.of(31, 2)), "step", size)
    return found


def _keys(params):
    return [key for key in params.keys() if key.endswith(tuple(f".{name}.value" for name in NAMES))]  # noqa: SIM118


def _reverse(size, rounds):
    """The reverse pass alone: the picture that it starts from is there."""
    scene = scenes.lecture(size)
    params = mi.traverse(scene)
    for key in _keys(params):
        dr.enable_grad(params[key])
    params.update()
    times = {"picture": [], "reverse pass": []}
    for i in range(rounds + 2):
        picture = seconds(lambda: mi.render(scene))
        loss = dr.mean(mi.render(scene, params), axis=None)
        dr.eval(loss)
        reverse = seconds(lambda loss=loss: dr.backward(loss))
        if i >= 2:
            times["picture"].append(picture)
            times["reverse pass"].append(reverse)
    return times


def _steps(size, rounds):
    scene = scenes.lecture(size)
    target = dr.detach(mi.render(scene))
    dr.eval(target)
    params = mi.traverse(scene)
    opt = mi.ad.Adam(lr=1e-3)
    unknown = Unknown(opt, params, _keys(params))

    def step(scene, opt, target):
        difference = mi.render(scene, unknown.apply(scene)) - target
        dr.backward(dr.mean(dr.square(difference), axis=None))
        opt.step()

    frozen = dr.freeze(step)
    tasks = {"step": step, "frozen step": frozen}
    return interleaved({name: lambda f=f: _run(f, scene, opt, target) for name, f in tasks.items()}, rounds, warmup=4)


def _run(step, scene, opt, target):
    step(scene, opt, target)
    dr.eval(opt)
