"""Passes on disk: whole or not there, one writer at a time, readable years later."""

import dataclasses
import errno

import numpy as np
import pytest

from phong_bsdf.pictures import images
from phong_bsdf.pictures import store as passes
from phong_bsdf.pictures.store import Pass, Store

MADE = Pass(16, 5, 3, 0.25, 1.5, "llvm_ad_rgb", "phong_bsdf 1", "a machine", "now")
IMAGE = np.random.default_rng(0).normal(0, 1, (6, 8, 3)).astype(np.float32)


@pytest.fixture
def store(tmp_path):
    with Store(tmp_path / "a folder").opened() as store:
        yield store


def test_pass_comes_back(store):
    """Record and picture, to the last bit; and the file is a picture that anything can open."""
    assert not store.has("m-1", 16, 3)
    store.add("m-1", MADE, IMAGE)
    assert store.has("m-1", 16, 3) and not store.has("m-1", 16, 2) and not store.has("m-2", 16, 3)
    assert store.list("m-1") == [MADE] and np.array_equal(store.image("m-1", MADE), IMAGE)
    (path,) = (store.passes / "m-1").iterdir()
    assert np.array_equal(images.read_exr(path), IMAGE)


def test_passes_in_order(store):
    """By samples, then repeats, whatever the order in which they were made."""
    for spp, repeat in ((64, 0), (4, 1), (1024, 0), (4, 0)):
        store.add("m", dataclasses.replace(MADE, spp=spp, repeat=repeat), IMAGE)
    assert [(p.spp, p.repeat) for p in store.list("m")] == [(4, 0), (4, 1), (64, 0), (1024, 0)]
    assert store.list("nothing") == []


def test_failed_write_leaves_nothing(store, monkeypatch):
    """No file under its name, and none under another."""

    def fail(path, image, metadata):
        raise OSError("no space")

    monkeypatch.setattr(images, "_write_exr", fail)
    with pytest.raises(OSError, match="no space"):
        store.add("m", MADE, IMAGE)
    assert list((store.passes / "m").iterdir()) == []


def test_leftovers_are_removed(tmp_path):
    """What a killed process was writing is gone when the next one begins; passes stay."""
    with Store(tmp_path).opened() as store:
        store.add("m", MADE, IMAGE)
        (store.passes / "m" / ".000016-spp-x.exr").write_bytes(b"half")
    with Store(tmp_path).opened():
        assert [path.name for path in (store.passes / "m").iterdir()] == ["000016-spp-repeat-003.exr"]


def test_one_writer(store):
    """A second run into the same folder is refused; after the first it is not."""
    with pytest.raises(ValueError, match="another run is writing there"), Store(store.folder).opened():
        pass


def test_file_systems_without_locks(tmp_path, monkeypatch):
    """Work all the same; some of clusters are mounted so."""
    fcntl = pytest.importorskip("fcntl", reason="no such locks on this system")

    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with Store(tmp_path).opened() as store:
        store.add("m", MADE, IMAGE)
    assert store.has("m", 16, 3)


def test_reasons_of_failures(store):
    """Kept for the report until the method works."""
    assert store.failure("m") is None
    store.set_failure("m", "no area lights")
    assert store.failure("m") == "no area lights"
    store.set_failure("m", None)
    store.set_failure("m", None)
    assert store.failure("m") is None


def test_foreign_file_is_named(store):
    """A picture without a record is not taken for a pass."""
    (store.passes / "m").mkdir()
    images.write(store.passes / "m" / "000001-spp-repeat-000.exr", IMAGE)
    with pytest.raises(ValueError, match=r"000001-spp-repeat-000\.exr' is no pass"):
        store.list("m")


def test_broken_file_is_named(store):
    """With what to do: by its record, or by its picture."""
    store.add("m", MADE, IMAGE)
    (path,) = (store.passes / "m").iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-40])
    assert store.list("m") == [MADE]
    with pytest.raises(ValueError, match=r"000016-spp-repeat-003\.exr' is broken; delete it"):
        store.image("m", MADE)
    path.write_bytes(b"")
    with pytest.raises(ValueError, match=r"000016-spp-repeat-003\.exr' is no pass"):
        store.list("m")


def test_folder_holds_one_kind(store):
    """Scenes and lobes do not mix."""
    store.claim(passes.RUN)
    (store.folder / passes.LOBES).write_text("{}")
    store.claim(passes.LOBES)
    with pytest.raises(ValueError, match="choose another folder"):
        store.claim(passes.RUN)
