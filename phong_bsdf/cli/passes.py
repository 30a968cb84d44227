"""What `phong-bsdf render --passes` does beside rendering: passes that are there, pictures in between, Ctrl-C."""

import contextlib
import functools
import sys
import time
from pathlib import Path

# Pictures in between are written so often at most, in seconds, and so many times as long apart as writing takes.
LEAST_SECONDS, TIMES_WRITING = 5, 40


def in_passes(picture, path: Path, *, spp, seed, pass_spp, target, resume, show, elsewhere=None) -> str:
    """Render and write a picture in passes; a line to say about it."""
    from ..pictures import images
    from ..pictures.store import Store
    from ..progressive import folder as folders
    from ..progressive import planning

    with Store(path).opened() as store, contextlib.ExitStack() as stack:
        for output in picture.outputs:
            images.remove_leftovers(output)
        held = folders.stored(store)
        if held and not resume:
            count = len(folders.Folder(store, held).finished())
            raise ValueError(f"'{path}' holds {count} of {held.count} passes already; go on with them: --resume, "
                             "or choose another folder")  # fmt: skip
        # Where an option is not given, as before.
        spp, pass_spp = spp or (held.total if held else 0), pass_spp or (held.asked if held else None)
        if elsewhere:
            stack.enter_context(elsewhere)
            pass_spp = pass_spp or elsewhere.pass_spp(picture, spp)
        plan = planning.plan(picture.loaded, picture.subject, spp=spp, seed=seed, pass_spp=pass_spp)
        folder = folders.claim(store, plan)
        try:
            return _Run(picture, folder, target, show, elsewhere).render()
        except KeyboardInterrupt:
            _say(f"Stopped: {_kept(folder)}")
            raise
        except (OSError, ValueError) as error:
            raise type(error)(f"{error}; {_kept(folder)}") from None


def _kept(folder) -> str:
    return (f"{len(folder.finished())} of {folder.plan.count} passes are in '{folder.store.folder}', "
            "and the same command with --resume goes on from there")  # fmt: skip


class _Run:
    """One rendering of the passes that a folder lacks."""

    def __init__(self, picture, folder, target, show, elsewhere):
        self.picture, self.folder, self.target, self.show, self.elsewhere = picture, folder, target, show, elsewhere
        self.plan = folder.plan
        self.there, self.said = len(folder.finished()), "rendering"
        self.written, self.pause = time.perf_counter(), LEAST_SECONDS

    def render(self) -> str:
        """Render, and write the pictures; a line to say about it."""
        from ..progressive import running

        rendered = self.elsewhere.render if self.elsewhere else functools.partial(running.render, self.picture.loaded)
        start = time.perf_counter()
        for mean in rendered(self.folder, on_broken=self._broken, on_progress=self._at):
            error = mean.relative_error()
            self.said = f"pass {mean.count} of {self.plan.count}" + (f", error {percent(error)}" if error else "")
            if self._is_enough(mean, error):
                break
            if time.perf_counter() - self.written > self.pause:
                self._write(mean)
        self._write(mean)
        return self._summary(mean, error, time.perf_counter() - start)

    def _is_enough(self, mean, error) -> bool:
        from ..progressive import planning

        if self.target is not None and error is not None and mean.count >= planning.LEAST_PASSES:
            return mean.count == self.plan.count or 100 * error <= self.target
        return mean.count == self.plan.count

    def _summary(self, mean, error, seconds) -> str:
        from ..scene import rendering

        loaded, there = self.picture.loaded, min(self.there, mean.count)
        return (f"{self.picture.summary(mean.samples, rendering.count_lights(loaded))}; "
                f"{mean.count} pass{'' if mean.count == 1 else 'es'} of {self.plan.spp} spp"
                f"{f', {there} of them from before' if there else ''}, error {percent(error)}; "
                f"loading {loaded.seconds:.2f} s, passes {seconds:.2f} s")  # fmt: skip

    def _broken(self, text: str) -> None:
        self.there -= 1
        _say(f"Warning: {text}; it is rendered again")

    def _at(self, share: float) -> None:
        self.show(self.said, share)

    def _write(self, mean) -> None:
        start = time.perf_counter()
        self.picture.write(mean.image(), [self.plan.samples(index) for index in range(mean.count)])
        self.written = time.perf_counter()
        self.pause = max(LEAST_SECONDS, TIMES_WRITING * (self.written - start))


def _say(text: str) -> None:
    # Not `click.echo`, which writes into the progress bar: rich puts what is printed above it.
    print(text, file=sys.stderr)


def percent(error: float | None) -> str:
    """`0.83 %`, or that it is not known."""
    return "unknown" if error is None else f"{100 * error:.2g} %"


class Elsewhere:
    """Renders passes on a cluster. Inside `with` it is connected."""

    def __init__(self, choice, scene, defines, size, verbose, show):
        from ..scene import bundle

        self.choice, self.size, self.verbose, self.show = choice, size, verbose, show
        self.scene, self.wait = bundle.pack(scene, defines, choice.root), choice.waiting(show)

    def __enter__(self):
        self.show("connecting", 0)
        self.connection = self.choice.connected(self.verbose)
        self.cluster = self.connection.__enter__()

    def __exit__(self, *error):
        return self.connection.__exit__(*error)

    def pass_spp(self, picture, spp: int | None) -> int:
        """What suits this scene and cluster."""
        from ..cluster import passes

        self.show("measuring", 0)
        spp = spp or picture.loaded.sensor(picture.subject.camera).sampler().sample_count()
        return passes.suitable_spp(self.cluster, self.scene, picture.subject, self.size, spp,
                                   seconds=self.choice.seconds, on_wait=self.wait)  # fmt: skip

    def render(self, folder, **heard):
        """As `progressive.running.render`."""
        from ..cluster import passes

        return passes.render(self.cluster, self.scene, folder, size=self.size, seconds=self.choice.seconds,
                             on_wait=self.wait, **heard)  # fmt: skip
